"""Compile the two C libraries of defplan; everything else about the package is in pyproject.toml.

`libdefplan_kernel.so` is the reduced step, `libdefplan_plugin.so` its MuJoCo engine plugin. They are
plain shared libraries (no Python API), so a small build_ext calls the C compiler itself.

Environment: CC is the compiler (default: the first of gcc, clang, cc); DEFPLAN_MARCH is the value of
-march (default: native; an empty value leaves the option out).
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from setuptools import Extension, find_packages, setup
from setuptools.command.build_ext import build_ext

ROOT = Path(__file__).resolve().parent
KERNEL = Path("defplan_mj/kernel")
HOST = Path("defplan_mj/host")
# Reassociation lets the compiler vectorise sums; NaN and infinity keep their meaning.
FLAGS = ["-O3", "-std=c11", "-fPIC", "-shared", "-fvisibility=hidden", "-fno-math-errno"]
FLAGS += ["-fno-trapping-math", "-fassociative-math", "-fno-signed-zeros"]
NO_COMPILER = (
    "defplan needs a C compiler to build its kernel: install gcc or clang, or name one in CC"
)


@dataclass(frozen=True)
class Library:
    """One shared library: where it goes, what it is made of, further compiler arguments."""

    path: Path
    sources: list[Path]
    headers: list[Path]
    arguments: list[str]


def find_compiler() -> list[str]:
    """Return the command of a C compiler that is there, or stop with one sentence."""
    wanted = os.environ.get("CC", "").strip()
    for command in [wanted] if wanted else ["gcc", "clang", "cc"]:
        words = shlex.split(command)
        if shutil.which(words[0]):
            return words
    sys.exit(f"{NO_COMPILER} (CC={wanted} is not there)" if wanted else NO_COMPILER)


def mujoco_folder() -> Path:
    """Return the folder of the installed mujoco wheel: its headers and its library lie there."""
    spec = importlib.util.find_spec("mujoco")
    if spec is None or spec.origin is None:
        sys.exit("defplan builds against the mujoco package: install requirements.lock first")
    return Path(spec.origin).parent


def libraries() -> list[Library]:
    """Return what is to be built, in order: the plugin links to the kernel."""
    headers = sorted(KERNEL.glob("*.h"))
    found = []
    if sources := sorted(KERNEL.glob("*.c")):
        found.append(Library(KERNEL / "libdefplan_kernel.so", sources, headers, ["-lm"]))
    if (HOST / "plugin.c").is_file():
        mujoco = mujoco_folder()
        binaries = sorted(mujoco.glob("libmujoco.so.*"))
        if not binaries:
            sys.exit(f"no libmujoco.so in {mujoco}: reinstall the mujoco package")
        arguments = [
            f"-I{mujoco / 'include'}",
            f"-I{KERNEL}",
            "-Wl,-rpath,$ORIGIN/../kernel",
            # beside defplan_mj when both are installed as wheels; else it is loaded already
            "-Wl,-rpath,$ORIGIN/../../mujoco",
            str(binaries[-1]),
            "-lm",
        ]
        headers = headers + sorted(HOST.glob("*.h"))
        found.append(
            Library(HOST / "libdefplan_plugin.so", [HOST / "plugin.c"], headers, arguments)
        )
    return found


def march() -> list[str]:
    """Return the -march option."""
    value = os.environ.get("DEFPLAN_MARCH", "native").strip()
    return [f"-march={value}"] if value else []


def target(compiler: list[str]) -> str:
    """Return what the compiler makes of -march on this machine: `native` differs between them."""
    probe = [*compiler, *march(), "-E", "-v", "-x", "c", os.devnull]
    return subprocess.run(probe, capture_output=True, text=True, check=False).stderr


class BuildLibraries(build_ext):
    """Compile the libraries: into the source tree for an editable install, else into build_lib."""

    def run(self) -> None:
        os.chdir(ROOT)
        compiler = find_compiler()
        machine = target(compiler)
        folder = Path() if self.inplace or self.editable_mode else Path(self.build_lib)
        for library in libraries():
            self.compile(compiler, machine, library, folder)

    def compile(self, compiler: list[str], machine: str, library: Library, folder: Path) -> None:
        """Build `library` unless what lies there was made by the same command of the same files."""
        output = folder / library.path
        arguments = list(library.arguments)
        if library.path.parent == HOST:
            arguments.insert(0, str(folder / KERNEL / "libdefplan_kernel.so"))
        sources = [str(source) for source in library.sources]
        name = f"-Wl,-soname,{library.path.name}"
        command = [*compiler, *FLAGS, *march(), name, *sources, *arguments]
        recipe = hashlib.sha256((machine + shlex.join(command)).encode())
        for source in [*library.sources, *library.headers]:
            recipe.update(source.read_bytes())
        stamp = library.path.with_suffix(".built")  # in the source tree, not in a wheel
        in_place = output == library.path
        made = stamp.read_text() if stamp.exists() else ""
        if in_place and output.exists() and made == recipe.hexdigest():
            return
        output.parent.mkdir(parents=True, exist_ok=True)
        # Written aside and moved: a running process keeps the library it has loaded.
        temporary = output.with_name(f".{output.name}.{os.getpid()}")
        try:
            done = subprocess.run(
                [*command, "-o", str(temporary)], capture_output=True, text=True, check=False
            )
            if done.returncode:
                sys.exit(f"{done.stderr}\n{compiler[0]} could not build {library.path}: see above")
            os.replace(temporary, output)
        finally:
            temporary.unlink(missing_ok=True)
        if in_place:
            stamp.write_text(recipe.hexdigest())
        print(f"built {output}")

    def get_outputs(self) -> list[str]:
        return [str(Path(self.build_lib) / library.path) for library in libraries()]

    def get_output_mapping(self) -> dict[str, str]:
        return {}

    def get_source_files(self) -> list[str]:
        return [str(p) for library in libraries() for p in library.sources + library.headers]


def packages() -> list[str]:
    """Return all packages; tasks/ and solvers/ are installed under names of their own."""
    found = find_packages(str(ROOT), include=["defplan_mj", "defplan_mj.*"])
    for folder, name in PLUGINS.items():
        found.append(name)
        found += [f"{name}.{child}" for child in find_packages(str(ROOT / folder))]
    return found


PLUGINS = {"tasks": "defplan_tasks", "solvers": "defplan_solvers"}

setup(
    packages=packages(),
    package_dir={name: folder for folder, name in PLUGINS.items()},
    package_data={"": ["*.c", "*.h", "*.html", "*.xml", "assets/*", "templates/*"]},
    include_package_data=False,
    # The sources are listed in `libraries`; the entry makes setuptools run build_ext.
    ext_modules=[Extension("defplan_mj.kernel.libdefplan_kernel", sources=[])],
    cmdclass={"build_ext": BuildLibraries},
)
