"""Choose the points of a body's surface that can touch the terrain."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from defplan_mj.body.model import Body
from defplan_mj.body.rotation_strain import shape_coordinates
from defplan_mj.body.sphere import sphere_directions

COUNT = 192  # at most
EXTREMAL = 160  # of them corners of the deformed body's convex hull
_SHAPES, _DIRECTIONS = 24, 256
_SEED = 0


@lru_cache(maxsize=8)
def contact_points(body: Body) -> np.ndarray:
    """Return indices (n,) into `body.surface` of at most 192 points; the same every time.

    What a flat ground touches first is a corner of the convex hull, whatever the attitude. For many
    shapes up to the amplitude and many directions it is known how far the surface reaches; points
    are added where the chosen ones fall shortest of it, so that the least of the body sinks into
    the ground. The last 32 are spread over the surface, for ground that is not flat.
    """
    surface = body.vertices[body.surface]
    if len(surface) <= COUNT:
        return np.arange(len(surface))
    basis, generator = body.basis[body.surface], np.random.default_rng(_SEED)
    shapes = np.tile(surface, (_SHAPES, 1, 1))
    for shape in shapes[1:]:
        q = generator.uniform(-1.0, 1.0, body.n_modes) * generator.uniform() * body.amplitude
        shape += basis @ shape_coordinates(body, q[None])[0]
    directions = sphere_directions(_DIRECTIONS)
    heights = [shape @ directions.T for shape in shapes]
    extreme = np.array([height.argmax(0) for height in heights])  # (shapes, directions)
    reach = np.array([height.max(0) for height in heights])
    chosen: list[int] = []
    covered = np.full_like(reach, -np.inf)
    while len(chosen) < EXTREMAL:
        short = reach - covered
        if not short.max() > 0.0:
            break
        chosen.append(int(extreme.flat[np.argmax(short)]))
        covered = np.maximum(covered, shapes[:, chosen[-1]] @ directions.T)
    nearest = np.min([((surface - surface[i]) ** 2).sum(1) for i in chosen], axis=0)
    while len(chosen) < COUNT:
        chosen.append(int(np.argmax(nearest)))
        nearest = np.minimum(nearest, ((surface - surface[chosen[-1]]) ** 2).sum(1))
    return np.sort(np.array(chosen))
