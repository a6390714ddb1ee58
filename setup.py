"""Compile the two C libraries of defplan; everything else about the package is in pyproject.toml.

`libdefplan_kernel.so` is the reduced step, `libdefplan_plugin.so` its MuJoCo engine plugin. They are
plain shared libraries (no Python API), so a small build_ext calls the C compiler itself.

Environment: CC is the compiler (default: the first of gcc, clang, cc). DEFPLAN_MARCH is the value of
-march, by default x86-64-v3 on x86-64 and nothing elsewhere; `native` is for this machine alone, and
an empty value leaves the option out. DEFPLAN_SANITIZE=1 builds with the address and undefined-behaviour
sanitizers and makes warnings errors (`make sanitize`); so does DEFPLAN_STRICT=1, without sanitizers.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from setuptools import Extension, find_packages, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_ext import build_ext

ROOT = Path(__file__).resolve().parent
KERNEL = Path("defplan_mj/kernel")
HOST = Path("defplan_mj/host")
# Reassociation lets the compiler vectorise sums, contraction lets it use fused multiply-adds; NaN and
# infinity keep their meaning. What it chooses is in the library: the same bits wherever that runs.
FLAGS = ["-O3", "-std=c11", "-fPIC", "-shared", "-fvisibility=hidden", "-fno-math-errno"]
FLAGS += ["-fno-trapping-math", "-fassociative-math", "-fno-signed-zeros", "-ffp-contract=fast"]
# Vectors that a machine does not have are passed in memory: a matter of the ABI, but of no other library.
FLAGS += ["-Wall", "-Wextra", "-Wno-psabi"]
SANITIZE = ["-O2", "-g", "-fno-omit-frame-pointer", "-fsanitize=address,undefined"]
SANITIZE += ["-fno-sanitize-recover=all"]
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
        if os.environ.get("DEFPLAN_SANITIZE") == "1":  # else its header asks for a sanitized MuJoCo
            arguments.insert(0, "-U__SANITIZE_ADDRESS__")
        headers = headers + sorted(HOST.glob("*.h"))
        found.append(
            Library(HOST / "libdefplan_plugin.so", [HOST / "plugin.c"], headers, arguments)
        )
    return found


def march() -> list[str]:
    """Return the -march option."""
    usual = "x86-64-v3" if platform.machine().lower() in ("x86_64", "amd64") else ""
    value = os.environ.get("DEFPLAN_MARCH", usual).strip()
    return [f"-march={value}"] if value else []


def checks() -> list[str]:
    """Return what the sanitized build and the strict one add to the options."""
    sanitize, strict = (
        os.environ.get(f"DEFPLAN_{name}", "0") == "1" for name in ("SANITIZE", "STRICT")
    )
    return [*(SANITIZE if sanitize else []), *(["-Werror"] if sanitize or strict else [])]


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
        command = [*compiler, *FLAGS, *march(), *checks(), name, *sources, *arguments]
        recipe = hashlib.sha256((machine + shlex.join(command)).encode())
        for source in [*library.sources, *library.headers]:
            recipe.update(source.read_bytes())
        # no path of this machine counts: the same sources have the same name
        content = hashlib.sha256(shlex.join([*FLAGS, *march(), *checks()]).encode())
        for source in [*library.sources, *library.headers]:
            content.update(source.read_bytes())
        told = (
            f"{''.join(march()).removeprefix('-march=') or 'generic'}, {content.hexdigest()[:12]}"
        )
        command.insert(len(compiler), f'-DDP_BUILD="{told}"')
        stamp = output.with_suffix(".built")
        # a wheel, which is made of build_lib, has none
        stamped = output == library.path or "-fsanitize" in shlex.join(command)
        made = stamp.read_text() if stamp.exists() else ""
        if stamped and output.exists() and made == recipe.hexdigest():
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
            sys.stderr.write(done.stderr)  # warnings
            os.replace(temporary, output)
        finally:
            temporary.unlink(missing_ok=True)
        if stamped:
            stamp.write_text(recipe.hexdigest())
        print(f"built {output}")

    def get_outputs(self) -> list[str]:
        return [str(Path(self.build_lib) / library.path) for library in libraries()]

    def get_output_mapping(self) -> dict[str, str]:
        return {}

    def get_source_files(self) -> list[str]:
        return [str(p) for library in libraries() for p in library.sources + library.headers]


class TagByLibraries(bdist_wheel):
    """Name a wheel by what its libraries need: any Python 3, and a C library of some age (PEP 600)."""

    def get_tag(self) -> tuple[str, str, str]:
        python, abi, machine = super().get_tag()
        built = [Path(self.bdist_dir or "") / library.path for library in libraries()]
        built = built if all(map(Path.is_file, built)) else [x.path for x in libraries()]
        if not machine.startswith("linux_") or not all(map(Path.is_file, built)):
            return python, abi, machine
        major, minor = max(glibc(path) for path in built)
        return "py3", "none", f"manylinux_{major}_{minor}_{machine.removeprefix('linux_')}"


OLDEST_GLIBC = (2, 17)
"""Of manylinux2014: MuJoCo's own wheels ask for it."""


def glibc(library: Path) -> tuple[int, int]:
    """Return the version of glibc that a library needs: the newest among the versions of its symbols."""
    found = re.findall(rb"\0GLIBC_(\d+)\.(\d+)(?:\.\d+)?(?=\0)", library.read_bytes())
    return max([OLDEST_GLIBC, *((int(major), int(minor)) for major, minor in found)])


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
    package_data={
        "": ["*.c", "*.h", "*.html", "*.xml", "assets/*", "templates/*", "*-layout.json"]
    },
    include_package_data=False,
    # The sources are listed in `libraries`; the entry makes setuptools run build_ext.
    ext_modules=[Extension("defplan_mj.kernel.libdefplan_kernel", sources=[])],
    cmdclass={"build_ext": BuildLibraries, "bdist_wheel": TagByLibraries},
)
