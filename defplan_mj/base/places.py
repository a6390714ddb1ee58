"""Names of the scenes that are harder than a few obstacles on the way; `planning.places` draws them."""

from __future__ import annotations

from defplan_mj.base.errors import DefplanError

PLACES = {
    "field-20": "20 cylinders, a way through between any two",
    "field-40": "40 cylinders, a way through between any two",
    "pockets": "two pockets that are open to where the robot comes from",
    "gates": "two walls, each with a gate as wide as the robot and a half",
    "maze": "rows of boxes, and lanes between them",
    "tunnel": "a bending tunnel, closed behind the start",
}
"""Named scenes of the plane that are harder (`planning.places`), and what they are."""


def check_place(name: str, dimension: int) -> None:
    """Raise DefplanError: there are no such scenes, or not where positions have `dimension` numbers."""
    if name not in PLACES:
        raise DefplanError(f"there are no scenes {name!r}: take {', '.join(PLACES)}")
    if dimension != 2:
        raise DefplanError(f"the scenes {name} are of the plane, this task navigates in space")
