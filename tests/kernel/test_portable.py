"""The libraries run on the machines that they are built for, and say so elsewhere."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path

import pytest

from defplan_mj.base.errors import DefplanError
from defplan_mj.kernel import library

SOURCE = Path(library.__file__).with_name("machine.c")

needs_compiler = pytest.mark.skipif(
    not SOURCE.is_file() or shutil.which("gcc") is None, reason="needs the sources and gcc"
)


def flags() -> set[str]:
    """Return what the processor says it has."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    return set(next((line for line in lines if line.startswith("flags")), "").split())


def compiled(folder: Path, march: str) -> Path:
    """Return machine.c as a library of its own, for another machine."""
    path = folder / f"{march}.so"
    command = ["gcc", "-O2", "-std=c11", "-fPIC", "-shared", f"-march={march}", str(SOURCE)]
    subprocess.run([*command, "-o", str(path)], check=True)
    return path


def test_this_machine_runs_the_library():
    library.check_machine(library.kernel())


@needs_compiler
@pytest.mark.skipif("avx2" not in flags(), reason="not an x86-64-v3 machine")
def test_a_machine_without_the_instructions_is_told_so_in_one_sentence(tmp_path):
    library.check_machine(ctypes.CDLL(str(compiled(tmp_path, "x86-64-v3"))))
    if "avx512f" in flags():
        pytest.skip("this machine has AVX-512 too")
    with pytest.raises(DefplanError, match="has no AVX512F instructions") as error:
        library.check_machine(ctypes.CDLL(str(compiled(tmp_path, "x86-64-v4"))))
    assert "\n" not in str(error.value)


@needs_compiler
@pytest.mark.skipif("avx2" not in flags(), reason="not an x86-64 machine")
def test_the_question_itself_uses_no_newer_instruction(tmp_path):
    if shutil.which("objdump") is None:
        pytest.skip("needs objdump")
    for march in ("x86-64-v3", "x86-64-v4"):
        command = ["objdump", "-d", str(compiled(tmp_path, march))]
        code = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        assert "dp_missing_instructions" in code
        for newer in (
            "%ymm",
            "%zmm",
            "%xmm",
            "andn ",
            "shlx ",
            "shrx ",
            "rorx ",
            "bextr ",
            "tzcnt ",
        ):
            assert newer not in code
