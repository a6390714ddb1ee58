"""What a result was made from, as plain data: a plugin's options and source, what a file says."""

from __future__ import annotations

import ast
import dataclasses
import hashlib
import importlib.util
import sys
from collections.abc import Callable, Iterator, Mapping
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Any

import numpy as np

from defplan_mj import registry
from defplan_mj.base import files
from defplan_mj.base.files import file_hash


def content_of(path: Path) -> str:
    """Return the hash of what a file says: of an archive without wall times, else of its bytes."""
    return files.archive_hash(path) or file_hash(path)


def plain_data(value: Any) -> Any:
    """Return what JSON can hold for options of any kind; equal options give equal data.

    A dataclass is its fields, an array its numbers, a function or a class its name; of any other
    object only its kind is told.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(name): plain_data(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain_data(entry) for entry in value]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, Path):
        return str(value)
    named = value if hasattr(value, "__qualname__") else type(value)
    return f"{named.__module__}.{named.__qualname__}"


def plugin_data(solver: Any) -> dict[str, Any]:
    """Return what results of a plugin depend on: its name, its options, the hash of its source."""
    return {
        "name": solver.name,
        "options": plain_data(_options(solver)),
        "source": source_hash(_modules(solver)),
    }


def source_hash(modules: Iterator[str] | list[str]) -> str:
    """Return the hash of the source of modules and of all they import from their own packages."""
    digest = hashlib.sha256()
    for name, path in sorted(source_files(modules).items()):
        digest.update(f"{name}\0{file_hash(path)}\0".encode())
    return digest.hexdigest()


def source_files(modules: Iterator[str] | list[str]) -> dict[str, Path]:
    """Return the files, by module, of modules and of what they import of their own packages.

    Imports inside functions count: what is slow to import is imported there. What a plugin takes from
    other packages is not its own source; their versions are in run.json.
    """
    known: dict[str, Path] = {}
    due = list(modules)
    while due:
        name = due.pop()
        path = None if name in known else _file_of(name)
        if path is not None:
            known[name] = path
            due += [*_parents(name), *_imports(name, path)]
    return known


def _options(solver: Any) -> Any:
    """Return a plugin's options: the fields of a dataclass, else those attributes that are dataclasses."""
    if dataclasses.is_dataclass(solver):
        return solver
    attributes = getattr(solver, "__dict__", {}).items()
    return {name: value for name, value in attributes if dataclasses.is_dataclass(value)}


def _modules(solver: Any) -> list[str]:
    """Return the modules that a plugin comes from: its entry point's, its class', its functions'."""
    parts = [type(solver), *_functions(_options(solver))]
    named = [part.__module__ for part in parts if part.__module__]
    return sorted({*named, *registry.modules_of(solver)})


def _functions(value: Any) -> Iterator[Callable]:
    """Yield the functions among options, at any depth, and the classes of options."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        yield type(value)
        value = {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        for entry in value.values():
            yield from _functions(entry)
    elif isinstance(value, list | tuple):
        for entry in value:
            yield from _functions(entry)
    elif callable(value) and hasattr(value, "__qualname__"):
        yield value


def _file_of(module: str) -> Path | None:
    """Return a module's file; None if it has none or is not there. Nothing is imported for it."""
    loaded = sys.modules.get(module)
    origin = getattr(loaded, "__file__", None) if loaded else _origin(module)
    return Path(origin) if origin and Path(origin).is_file() else None


def _origin(module: str) -> str | None:
    """Return where a module would be imported from."""
    top, *parts = module.split(".")
    try:
        spec = importlib.util.find_spec(top)
    except (ImportError, ValueError):  # of a program that is no module
        return None
    for part in parts:
        if spec is None or spec.submodule_search_locations is None:
            return None
        where = list(spec.submodule_search_locations)
        spec = PathFinder.find_spec(f"{spec.name}.{part}", where)
    return spec.origin if spec else None


def _parents(module: str) -> list[str]:
    """Return the packages that a module lies in; their `__init__` runs, too."""
    parts = module.split(".")
    return [".".join(parts[:i]) for i in range(1, len(parts))]


def _imports(module: str, path: Path) -> list[str]:
    """Return the modules of its own top package that a file imports, or might: names count as modules."""
    if path.suffix != ".py":
        return []
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    names = []
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = _absolute(node, package)
            names += [base, *(f"{base}.{alias.name}" for alias in node.names)]
    top = module.partition(".")[0]
    return [name for name in names if name.partition(".")[0] == top]


def _absolute(node: ast.ImportFrom, package: str) -> str:
    """Return the module that an import takes names from."""
    if not node.level:
        return node.module or ""
    base = package.split(".")[: len(package.split(".")) - node.level + 1]
    return ".".join([*base, *([node.module] if node.module else [])])
