"""Task files that are damaged or mean harm: one sentence with the file, or a task."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from defplan_mj import registry
from defplan_mj.base.errors import DefplanError
from defplan_mj.taskfile.read import read_task
from defplan_mj.taskfile.write import task_text

VALUES = (
    *("-1", "0", "nan", "inf", "1e400", "9" * 400, "true", '""', '"\\u001b[2J"', '"' + "x" * 5000 + '"'),
    *("[]", "{}", "[" * 500 + "]" * 500, "{a = {b = {c = 1}}}", "1979-05-27", "0x7fffffffffffffffff", ""),
)  # fmt: skip


@pytest.fixture(scope="module")
def text(tmp_path_factory) -> str:
    folder = tmp_path_factory.mktemp("task")
    return task_text(registry.get_task("fish-swim"), folder / "fish.toml")


@settings(
    max_examples=150, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True
)
@given(data=st.data())
def test_a_damaged_task_file_is_a_task_or_a_sentence(text, data):
    content = bytearray(text.encode())
    at = data.draw(st.integers(0, len(content) - 1))
    kind = data.draw(st.sampled_from(["cut", "flip", "drop", "double", "value", "value", "value"]))
    size = data.draw(st.integers(1, 200))
    if kind == "cut":
        del content[at:]
    elif kind == "flip":
        content[at] ^= data.draw(st.integers(1, 255))
    elif kind == "drop":
        del content[at : at + size]
    elif kind == "double":
        content[at:at] = content[at : at + size]
    else:
        lines = text.splitlines()
        given = [i for i, line in enumerate(lines) if "=" in line and not line.startswith("#")]
        line = given[at % len(given)]
        name = lines[line].split("=")[0]
        lines[line] = f"{name}= {data.draw(st.sampled_from(VALUES))}"
        content = bytearray("\n".join(lines).encode())
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bad.toml"
        path.write_bytes(content)
        try:
            read_task(path)
        except DefplanError as error:
            assert "bad.toml" in str(error) and "\n" not in str(error), str(error)
