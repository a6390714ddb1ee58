"""`defplan body`: build a soft body from a mesh file, or from a task's, and say how good it is."""

from __future__ import annotations

import argparse
import dataclasses
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from defplan_mj.base.errors import DefplanError
from defplan_mj.cli.console import Console
from defplan_mj.cli.new import check_preview, show

SHAPE_ERROR = 0.01  # of the length: what a file's mesh may differ by; a task says it itself

if TYPE_CHECKING:
    from defplan_mj.body.loading import Filled
    from defplan_mj.body.model import Body
    from defplan_mj.task import BodyOptions


def body(arguments: argparse.Namespace, console: Console) -> int:
    """Build the body, write it, print what it is."""
    from defplan_mj.base import files
    from defplan_mj.body.build import build_with_account

    mesh, options, name, task = _what(arguments)
    output = arguments.output or Path(f"{task or name}.npz")
    if output.suffix != ".npz":
        raise DefplanError(f"a body file ends in .npz, not {output.suffix or 'nothing'}: {output}")
    files.check_writable(output)  # now, not after half a minute of work
    if arguments.output is None:
        console.say(f"the body goes into {output}; -o FILE puts it elsewhere")
    check_preview(arguments)
    start = time.perf_counter()
    with console.progress() as progress:
        built, filled = build_with_account(
            mesh, options, lambda m, f: progress(f"body: {m}", f), name
        )
        built.save(output)
        data = _describe(built, output, time.perf_counter() - start)
        data |= _account(filled)
        if arguments.preview is not None:
            show(built.vertices, built.faces, arguments.preview)
        if arguments.check:
            from defplan_mj.body.check import check_body

            data["check"] = check_body(built, lambda m, f: progress(f"check: {m}", f))
    for warning in data["warnings"]:
        console.say(f"warning: {warning}")
    console.result(data, _text(data))
    return 0


def _account(filled: Filled) -> dict[str, Any]:
    """Return how like the file the mesh is, and what was read in another way than it stands there."""
    like = filled.fidelity
    assert like is not None
    return {
        "fidelity": {
            "surface_distance": like.surface_distance,
            "extents_error": like.extents_error,
            "volume_error": like.volume_error,
            "repaired": list(filled.repaired),
        },
        "notes": list(filled.notes),
        "warnings": list(filled.warnings),
    }


def _what(arguments: argparse.Namespace) -> tuple[Path, BodyOptions, str, str]:
    """Return mesh, options and name of the body, and of its task: MESH is a mesh, or a task's file or name."""
    from defplan_mj.task import BodyOptions
    from defplan_mj.taskfile.find import find_task, is_file

    mesh, options = Path(arguments.mesh), BodyOptions()
    name, task = mesh.stem, ""
    changes: dict[str, Any] = {"shape_error": SHAPE_ERROR}
    if is_file(arguments.mesh):
        spec = find_task(arguments.mesh)
        mesh, options, name, task, changes = spec.mesh, spec.body, spec.mesh.stem, spec.name, {}
    elif not mesh.exists() and not mesh.suffix and mesh.parent == Path():
        try:
            spec = find_task(arguments.mesh)
        except DefplanError as error:
            raise DefplanError(f"mesh file {mesh} does not exist, and {error}") from error
        mesh, options, name, task, changes = spec.mesh, spec.body, spec.mesh.stem, spec.name, {}
    material = _given(arguments, density="density", youngs_modulus="youngs_modulus",
                      poissons_ratio="poissons_ratio")  # fmt: skip
    changes |= _given(arguments, vertices="vertices", modes="modes", shapes="shapes", moved="moved",
                      length="length", up="up", forward="forward")  # fmt: skip
    if arguments.strict:
        changes["strict"] = True
    if material:
        changes["material"] = dataclasses.replace(options.material, **material)
    if arguments.medium and arguments.medium != options.medium.name:
        changes["medium"] = _medium(arguments.medium)
    return mesh, dataclasses.replace(options, **changes), name, task


def _given(arguments: argparse.Namespace, **names: str) -> dict[str, Any]:
    """Return those options that the user has given."""
    given = {field: getattr(arguments, option) for field, option in names.items()}
    return {field: value for field, value in given.items() if value is not None}


def _medium(name: str) -> Any:
    """Return the medium called `name`: in water a body floats, in air it falls."""
    from defplan_mj.body.model import Medium

    if name == "water":
        return Medium()
    return Medium(name="air", density=1.2, gravity=-9.81, righting_height=0.0)


def _describe(built: Body, output: Path, seconds: float) -> dict[str, Any]:
    """Return what the command prints as JSON."""
    return {
        "file": output,
        "hash": built.hash,
        "name": built.name,
        "vertices": len(built.vertices),
        "tetrahedra": len(built.tetrahedra),
        "quality": built.source.get("quality", {}),
        "length_m": built.length,
        "mass_kg": built.mass,
        "modes": built.n_modes,
        "frequencies_hz": built.frequencies,
        "basis": built.n_basis,
        "sampled": len(built.sampled),
        "drag": built.source.get("drag", {"points": len(built.drag_areas)}),
        "medium": built.medium.name,
        "seconds": seconds,
    }


def _text(data: dict[str, Any]) -> str:
    """Return the same for people."""
    quality, like = data["quality"], data["fidelity"]
    frequencies = ", ".join(f"{f:.3g}" for f in data["frequencies_hz"])
    lines = [
        f"{data['file']}: {data['name']}, {data['length_m']:.3g} m, {data['mass_kg']:.3g} kg,"
        f" in {data['medium']}",
        f"  mesh       {data['vertices']} vertices, {data['tetrahedra']} tetrahedra,"
        f" quality {quality.get('min', float('nan')):.2f} at least,"
        f" {quality.get('mean', float('nan')):.2f} on average",
        f"  fidelity   surface within {like['surface_distance']:.2%} of the length, extents within"
        f" {like['extents_error']:.2%}, volume {like['volume_error']:+.2%}",
        *(f"  repaired   {sentence}" for sentence in like["repaired"]),
        *(f"  note       {sentence}" for sentence in data["notes"]),
        f"  modes      {data['modes']}: {frequencies} Hz",
        f"  reduction  {data['basis']} basis shapes, {data['sampled']} sampled tetrahedra,"
        f" {data['drag']['points']} drag points",
    ]
    if "check" in data and "error" in data["drag"]:
        drag = data["drag"]
        lines.append(
            f"  drag       {drag['points']} points for {drag['triangles']} triangles, force within"
            f" {drag['error']:.2%} on motions held out, areas within {drag['area_error']:.2%}"
        )
    for name, value in _flat(data.get("check", {})):
        lines.append(f"  check      {name}: {value}")
    return "\n".join([*lines, f"  built in {data['seconds']:.1f} s"])


def _flat(data: dict[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Return nested numbers as (name, text) pairs."""
    pairs = []
    for key, value in data.items():
        name = f"{prefix}{key}".replace("_", " ")
        if isinstance(value, dict):
            pairs += _flat(value, f"{name}, ")
        else:
            pairs.append((name, f"{value:.3g}" if isinstance(value, float) else str(value)))
    return pairs
