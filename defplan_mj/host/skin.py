"""The deforming skin: surface triangles on one bone, whose vertices the plugin writes when a scene is drawn."""

from __future__ import annotations

import mujoco
import numpy as np

from defplan_mj import registry
from defplan_mj.base.errors import DefplanError
from defplan_mj.body.model import Body

BACK = (0.16, 0.30, 0.42)
BELLY = (0.85, 0.87, 0.82)


def shaded_texture(
    back: tuple[float, float, float] = BACK, belly: tuple[float, float, float] = BELLY
) -> np.ndarray:
    """Return a (64, 8, 3) uint8 picture, dark above and light below: the default skin."""
    blend = np.linspace(1, 0, 64)[:, None, None] ** 1.5
    column = blend * np.asarray(back) + (1 - blend) * np.asarray(belly)
    return np.round(255 * np.broadcast_to(column, (64, 8, 3))).astype(np.uint8)


def texture_of(task: str) -> np.ndarray | None:
    """Return the skin picture of a task by its name, or None."""
    try:
        return registry.get_task(task).texture()
    except DefplanError:  # of somewhere else, or broken: that costs the picture, not the video
        return None


def add_skin(
    spec: mujoco.MjSpec, body: Body, bone: str, material: str, texture: np.ndarray | None = None
) -> None:
    """Add the skin of `body`, carried by the body named `bone`, to `spec`.

    Args:
        material: made here: white, with `texture`.
        texture: (h, w, 3) uint8 picture of the left side of the body (head to the right, back up),
            projected along y; None: dark back, light belly.
    """
    picture = np.ascontiguousarray(shaded_texture() if texture is None else texture)
    height, width, _ = picture.shape
    spec.add_texture(
        name=material, type=mujoco.mjtTexture.mjTEXTURE_2D, height=height, width=width, nchannel=3
    ).data = picture.tobytes()
    textures = [""] * mujoco.mjtTextureRole.mjNTEXROLE.value
    textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = material
    spec.add_material(name=material, textures=textures, specular=0.35, shininess=0.6)

    points = body.vertices[body.surface]
    low, high = points.min(0), points.max(0)
    place = (points - low) / np.maximum(high - low, 1e-12)
    texcoord = np.column_stack([place[:, 0], 1 - place[:, 2]])
    count = len(points)
    spec.add_skin(
        name=material,
        material=material,
        vert=points.ravel(),
        texcoord=texcoord.ravel(),
        face=body.surface_faces.ravel(),
        bodyname=[bone],
        bindpos=[0.0, 0.0, 0.0],
        bindquat=[1.0, 0.0, 0.0, 0.0],
        vertid=[list(range(count))],
        vertweight=[[1.0] * count],
    )
