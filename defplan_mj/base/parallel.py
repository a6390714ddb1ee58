"""Where independent work of one command goes: processes of this machine, or the workers of a Dask cluster."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Any, TypeVar

from defplan_mj.base import threads

if TYPE_CHECKING:
    from distributed import Client

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

_client: Client | None = None


@contextlib.contextmanager
def on_cluster(client: Client) -> Iterator[None]:
    """Let the work of this process go to the workers of a Dask cluster, in the `with` block."""
    global _client
    before, _client = _client, client
    try:
        yield
    finally:
        _client = before


def places() -> int:
    """Return how many pieces of work are done at a time."""
    if _client is None:
        return threads.available_processes()
    return max(sum(_client.ncores().values()), 1)


def each(
    work: Callable[[_Item], _Result],
    items: Iterable[_Item],
    workers: int | None = None,
    ordered: bool = True,
) -> Iterator[_Result]:
    """Yield work(item) of each item as it is done.

    Args:
        work: a picklable function that needs nothing but the item.
        workers: processes (None: `places()`); 1: this one, one item after the other.
        ordered: in the order of the items; else whatever is done first.
    """
    if (places() if workers is None else workers) == 1:
        yield from map(work, items)
        return
    from joblib import Parallel, delayed, parallel_config

    how = "generator" if ordered else "generator_unordered"
    with parallel_config(**_backend(workers)):
        yield from Parallel(return_as=how)(delayed(work)(item) for item in items)


def _backend(workers: int | None) -> dict[str, Any]:
    if _client is not None:
        return {"backend": "dask", "client": _client}
    return {"backend": "loky", "n_jobs": workers or places(), "inner_max_num_threads": 1}
