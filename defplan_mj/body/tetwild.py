"""Fills any surface with tetrahedra by fTetWild (Hu et al., SIGGRAPH 2020), in a process of its own.

Of its own, so that its time and memory are bounded and a crash is one sentence. fTetWild draws
random numbers that cannot be seeded: two runs give two meshes, equally good. A body keeps its mesh.
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.surface import Surface
from defplan_mj.body.tetmesh import TetMesh, compact, volumes

_WORKER = Path(__file__).with_name("tetwild_worker.py")
CPU_SECONDS = 45  # of all attempts for one mesh
# Of one attempt: a busy machine may give a tenth of a core; what it works is bounded above.
WALL_SECONDS = 600
_MEMORY = 2 << 30  # bytes


def run_tetwild(
    surface: Surface, vertices: float, envelope: float, name: str, seconds: float
) -> TetMesh:
    """Return tetrahedra of what the surface encloses (winding number above a half).

    Args:
        vertices: about how many are wanted; thin parts may need more.
        envelope: how far the boundary may be from the surface, m.
        name: what messages call the mesh.
        seconds: of CPU time.

    Raises:
        DefplanError: it took too long, too much memory, or found nothing inside.
    """
    diagonal = float(np.linalg.norm(np.ptp(surface.vertices, axis=0)))
    edge = 1.7 * (2.0 * max(abs(surface.volume), 1e-12 * diagonal**3) / vertices) ** (1.0 / 3.0)
    with tempfile.TemporaryDirectory() as folder:
        given, made = Path(folder) / "given.npz", Path(folder) / "made.npz"
        try:
            np.savez(
                given,
                vertices=np.ascontiguousarray(surface.vertices, np.float64),
                faces=np.ascontiguousarray(surface.faces, np.uint32),
                edge=np.clip(edge / diagonal, 0.01, 0.15),
                envelope=envelope / diagonal,
            )
        except OSError as error:
            raise DefplanError(f"cannot write {given}: {error.strerror or error}") from error
        command = [sys.executable, str(_WORKER), str(given), str(made), str(int(max(seconds, 1)))]
        start = time.monotonic()
        process = subprocess.Popen(
            [*command, str(_MEMORY)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            cwd=folder,  # fTetWild leaves a file where it runs
        )
        try:
            _, output = process.communicate(timeout=WALL_SECONDS)
        except subprocess.TimeoutExpired:
            output = b""
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()
        if not made.is_file():
            used = time.monotonic() - start
            raise DefplanError(_failure(name, process.returncode, output, used))
        with np.load(made) as data:
            points, tetrahedra = data["vertices"], data["tetrahedra"].astype(np.int64)
    if len(tetrahedra) == 0:
        raise DefplanError(f"{name} encloses no volume that could be filled: give it a thickness")
    size = volumes(points, tetrahedra)
    tetrahedra[size < 0.0] = tetrahedra[size < 0.0][:, [0, 2, 1, 3]]
    return compact(points, tetrahedra[np.abs(size) > 0.0])


def mesh_hash(mesh: TetMesh) -> str:
    """Return the SHA-256 of a mesh."""
    return hashlib.sha256(mesh.vertices.tobytes() + mesh.tetrahedra.tobytes()).hexdigest()


def _failure(name: str, code: int, output: bytes, seconds: float) -> str:
    lines = output.decode(errors="replace").strip().splitlines()
    if lines and lines[-1].startswith("no "):
        return f"{name} needs repair, but {lines[-1][3:]}"
    if seconds >= WALL_SECONDS:
        return (
            f"{name} could not be filled within {seconds:.0f} s: the machine is busy; try it again"
        )
    if code in (-24, -9):
        return (
            f"{name} could not be filled within {seconds:.0f} s: its parts are too thin or too many"
            " for this; simplify it, thicken it or give a tetrahedral mesh"
        )
    why = "too much memory" if lines and "MemoryError" in lines[-1] else "its mesher failed"
    return f"{name} could not be filled ({why}): simplify it or give a tetrahedral mesh"


def decimate(surface: Surface, count: int) -> Surface:
    """Return the surface with about `count` triangles, by quadrics; it stays closed."""
    if len(surface.faces) <= count:
        return surface
    import fast_simplification

    points, faces = fast_simplification.simplify(
        np.ascontiguousarray(surface.vertices, np.float64),
        np.ascontiguousarray(surface.faces, np.int32),
        target_count=count,
    )
    faces = faces.astype(np.int64)
    a, b, c = faces.T
    return Surface(np.asarray(points, float), faces[(a != b) & (b != c) & (c != a)])
