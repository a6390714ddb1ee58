"""`make hashes`: write requirements.hashes, the lock with the SHA-256 of each wheel, from pip's own report.

For CPython 3.11 and 3.12 on this kind of machine. Without torch: its wheels for the CPU, which are what is
meant, come from an index of their own, and the one that a plain index has under the same version is another.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
VERSIONS = ("3.11", "3.12")
LEFT_OUT = ("torch",)
HEAD = """\
# requirements.lock with hashes, for Linux on x86-64, CPython 3.11 and 3.12; written by `make hashes`.
# pip install --require-hashes --no-deps -r requirements.hashes
# torch is left out: install it first, from where you get its wheel for the CPU.
"""


def hashes(lines: list[str], version: str, folder: Path) -> dict[str, str]:
    """Return line -> SHA-256 of the wheel that pip chooses for a version of Python."""
    requirements, report = folder / "wanted.txt", folder / "report.json"
    requirements.write_text("\n".join(lines) + "\n")
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--dry-run", "--ignore-installed"]
    command += ["--no-deps", "--only-binary=:all:", "--implementation=cp", "--target", str(folder)]
    command += [f"--python-version={version}", "--report", str(report), "-r", str(requirements)]
    subprocess.run(command, check=True)
    installed = json.loads(report.read_text())["install"]
    by_name = {
        _plain(one["metadata"]["name"]): one["download_info"]["archive_info"]["hashes"]["sha256"]
        for one in installed
    }
    return {line: by_name[_plain(line.partition("==")[0])] for line in lines}


def _plain(name: str) -> str:
    return name.lower().replace("_", "-").replace(".", "-")


def write(versions: list[dict[str, str]]) -> None:
    """Write the file from what was found for each version of Python."""
    text = HEAD
    for line in versions[0]:
        text += " \\\n    ".join(
            [line, *(f"--hash=sha256:{h}" for h in _different(versions, line))]
        )
        text += "\n"
    (ROOT / "requirements.hashes").write_text(text)


def _different(versions: list[dict[str, str]], line: str) -> list[str]:
    return sorted({one[line] for one in versions})


if __name__ == "__main__":
    locked = (ROOT / "requirements.lock").read_text().splitlines()
    chosen = [
        line
        for line in locked
        if line and not line.startswith("#") and line.partition("==")[0] not in LEFT_OUT
    ]
    with tempfile.TemporaryDirectory() as name:
        write([hashes(chosen, version, Path(name)) for version in VERSIONS])
