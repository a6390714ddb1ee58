"""Generates the 4-legged body: `python -m defplan_tasks.quadruped_mesh` writes assets/quadruped.obj.

A torso with a leg down from each corner, splayed outwards: it stands on the ground and, in water,
opens and closes its legs like a jellyfish's bell. x is forward, y left, z up; all four sides are alike.
Its longest extent is 1 m, from foot to foot across the diagonal's projection on x or y.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from defplan_tasks.surfaces import blend, limb, rounded_box, surface_net, write_obj

ASSET = Path(__file__).parent / "assets" / "quadruped.obj"

TORSO_HALF, TORSO_ROUND = (0.29, 0.29, 0.085), 0.06  # m
HIP, FOOT = (0.21, -0.02), (0.405, -0.50)  # |x| = |y| and z of the ends of a leg's axis, m
LEG_RADII = (0.095, 0.062)  # around the z axis and towards it, m: a leg is a paddle too
BLEND = 0.05  # m


def quadruped_mesh(cell: float = 0.03) -> tuple[np.ndarray, np.ndarray]:
    """Return the surface: vertices (n, 3) in metres and outward triangles (t, 3).

    Args:
        cell: of the grid the surface is found on, m.
    """

    def solid(points: np.ndarray) -> np.ndarray:
        value = rounded_box(points, (0, 0, 0), TORSO_HALF, TORSO_ROUND)
        for x in (-1, 1):
            for y in (-1, 1):
                hip, foot = (np.array([x * end[0], y * end[0], end[1]]) for end in (HIP, FOOT))
                value = blend(value, limb(points, hip, foot, LEG_RADII), BLEND)
        return value

    vertices, faces = surface_net(solid, cell, 0.66)
    return vertices / np.ptp(vertices, axis=0).max(), faces


def write_quadruped(path: str | Path = ASSET) -> Path:
    """Write the body as a Wavefront OBJ file; the same bytes every time."""
    return write_obj(
        path, "4-legged body, 1 m; made by defplan_tasks.quadruped_mesh", *quadruped_mesh()
    )


def main() -> None:
    """Write the mesh where it is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=ASSET)
    print(write_quadruped(parser.parse_args().output))


if __name__ == "__main__":
    main()
