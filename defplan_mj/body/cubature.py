"""Cubature: few points with areas of their own that take the drag of all surface triangles.

The generalised force is a sum over triangles. Non-negative least squares over random swimming
motions finds some of them, and factors of their areas, whose sum is nearly the same (An, Kim and
James 2008 integrate the elastic force so). Points come in mirror images where the body has them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.drag import DragPoints, Moments, SurfaceFields, forces
from defplan_mj.body.mirror import mirror_axes
from defplan_mj.body.model import Body
from defplan_mj.body.motions import swimming_motions
from defplan_mj.body.sphere import sphere_directions
from defplan_mj.body.tetmesh import TetMesh

AREA_ERROR = 0.02  # bound of the error of all directional areas, or a third of the force's
_TRAINED, _HELD_OUT, _PHASES = 96, 24, 8  # motions, and moments of each
_COARSE = 64  # clusters that carry the body in those motions
_MEANS, _AREAS = 2.0, 20.0  # weights of a cycle's mean forces and of the areas, forces have 1
_LEAST = 0.1  # a component counts at least as if it had this share of its group's rms
_DIRECTIONS, _CHECKED = 500, 2050  # of areas, fitted and checked
_GROWTH, _SWAPS, _INSIST = 1.05, 2, 4
_RIDGE = 1e-12


@dataclass(frozen=True)
class DragError:
    """How far drag points are from all triangles: what a body's file says under source['drag'].

    Attributes:
        points: number of them.
        triangles: of the surface.
        error: relative rms error of the generalised force on held-out motions, components scaled to
            their rms.
        mean_error: of the force and torque averaged over a cycle, over the rms in the cycle.
        area_error: largest relative error of the projected area in any direction and of the whole
            area, and of the closure and second moments of the normals over their size.
        mirrors: planes the points are alike in: 'y', 'x' (normals of the planes).
    """

    points: int
    triangles: int
    error: float
    mean_error: float
    area_error: float
    mirrors: str


def drag_points(body: Body, bound: float, most: int, seed: int = 0) -> tuple[DragPoints, DragError]:
    """Choose as few points as keep the error below `bound`, and the areas' below 2% or a third of it.

    Args:
        body: its own drag points do not count.
        bound: relative, of the generalised force on motions that the choice has not seen.
        most: points; if they are not enough, `most` are taken, and the error says so.
        seed: of the motions.
    """
    shapes = np.concatenate([body.vertices[:, :, None], body.basis], axis=2)
    surface = SurfaceFields(TetMesh(body.vertices, body.tetrahedra), shapes)
    axes = mirror_axes(body.vertices, body.tetrahedra)
    while 2 ** len(axes) > most:
        axes = axes[:-1]
    rng = np.random.default_rng(seed)
    coarse = surface.clusters(surface.alike(_COARSE, rng))
    half = surface.centres[:, axes[0]] >= 0.0 if axes else np.ones(len(surface.areas), bool)
    images = surface.mirrored(np.flatnonzero(half), axes)
    whole = surface.triangles()
    fits = []
    for count in (_TRAINED, _HELD_OUT):
        motion = swimming_motions(body, coarse, count, _PHASES, rng)
        fits.append(_Forces(body, whole, images, motion, count))
    trained, held_out = fits
    areas = _Areas(whole, images, _DIRECTIONS)
    checked = _Areas(whole, images, _CHECKED)
    system = _System([trained.rows(), trained.mean_rows(), areas.rows()], [1.0, _MEANS, _AREAS])
    largest = max(most // len(images), 1)

    def measured(which: list[int], weights: np.ndarray) -> tuple[float, float, float]:
        return (*held_out.errors(which, weights), checked.error(which, weights))

    limit = max(AREA_ERROR, bound / 3.0)
    best: tuple[list[int], np.ndarray] = ([], np.zeros(0))
    while True:  # from few to many, so that the first that are good enough are the fewest
        more = min(largest, max(len(best[0]) + 1, int(_GROWTH * len(best[0]))))
        grown = system.grown(best[0], more)
        if len(grown[0]) <= len(best[0]):
            break  # no other candidate would help
        best = system.swapped(grown[0])
        force_error, _, area = measured(*best)
        for _ in range(_INSIST):  # least squares bounds the mean; the largest is asked for
            if force_error > bound or area <= limit:
                break
            worst = checked.worst(*best, 0.5 * limit)
            system.add(*worst, _AREAS / _INSIST)
            best = system.swapped(best[0])
            force_error, _, area = measured(*best)
        if (force_error <= bound and area <= limit) or len(best[0]) >= largest:
            break
    if not best[0]:
        raise DefplanError(
            "the drag of this body cannot be measured (its motions diverge): it is too thin or too"
            " light for the medium; thicken it, or raise its density"
        )
    order = np.argsort(best[0])
    which, weights = [best[0][i] for i in order], best[1][order]
    error = DragError(
        len(which) * len(images),
        len(whole),
        *measured(which, weights),
        "".join("xyz"[a] for a in axes),
    )
    parts = [image.chosen(np.array(which), weights) for image in images]
    return DragPoints(
        np.concatenate([part.points for part in parts]),
        np.concatenate([part.tangents for part in parts], axis=1),
        np.concatenate([part.areas for part in parts]),
    ), error


class _Forces:
    """Generalised forces of candidates (each a point with its images) and of the whole surface."""

    def __init__(
        self, body: Body, whole: DragPoints, images: list[DragPoints], motion: Moments, count: int
    ) -> None:
        parts = np.sum([forces(image, body.medium, motion) for image in images], axis=0)
        total = forces(whole, body.medium, motion).sum(1)
        self.scale = _scales((total**2).mean(0))
        self.parts, self.total = parts / self.scale, total / self.scale
        # averages of a cycle, in a frame that does not turn: what a gait's advance comes from
        turn = motion.attitude.reshape(-1, count, 3, 3)
        relative = turn[len(turn) // 2].transpose(0, 2, 1) @ turn
        square = (total.reshape(-1, count, total.shape[1]) ** 2).mean(0)
        scale = np.array([_scales(row)[:6] for row in square])
        self.mean_parts = _means(parts, relative) / scale[:, None]
        self.mean_total = _means(total[:, None], relative)[:, 0] / scale

    def rows(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the least-squares rows (m (6 + r), c) and what they should give, (m (6 + r),)."""
        return _rows(self.parts), self.total.ravel()

    def mean_rows(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the least-squares rows of the averages over cycles (6 n, c) and what they should give, (6 n,)."""
        return _rows(self.mean_parts), self.mean_total.ravel()

    def errors(self, which: list[int], weights: np.ndarray) -> tuple[float, float]:
        """Return the relative error of candidates `which` with `weights` (k,), and that of the averages."""
        off = weights @ self.parts[:, which] - self.total
        mean = weights @ self.mean_parts[:, which] - self.mean_total
        size = max(float(np.linalg.norm(self.total)), 1e-300)
        return float(np.linalg.norm(off)) / size, float(np.sqrt((mean**2).mean()))


def _rows(parts: np.ndarray) -> np.ndarray:
    return parts.transpose(0, 2, 1).reshape(-1, parts.shape[1])


def _scales(square: np.ndarray) -> np.ndarray:
    """Return what each component (6 + r,) is divided by, from its mean square."""
    scale = np.sqrt(square)
    for group in (slice(0, 3), slice(3, 6), slice(6, None)):
        if scale[group].size:
            least = _LEAST * np.sqrt((scale[group] ** 2).mean())
            scale[group] = np.maximum(scale[group], max(least, 1e-300))
    return scale


def _means(parts: np.ndarray, relative: np.ndarray) -> np.ndarray:
    """Return the mean force and torque (n, c, 6) of n cycles, turned by `relative` (phases, n, 3, 3)."""
    by_phase = parts[:, :, :6].reshape(*relative.shape[:2], parts.shape[1], 2, 3)
    return np.einsum("pnij,pncgj->ncgi", relative, by_phase, optimize=True).reshape(
        relative.shape[1], parts.shape[1], 6
    ) / len(relative)


class _Areas:
    """Directional areas at rest: |n.e| in many directions, the whole, the closure, n n^T."""

    def __init__(self, whole: DragPoints, images: list[DragPoints], directions: int) -> None:
        axes = sphere_directions(directions)
        axes = axes[axes[:, 2] > 0.0]
        target = _area_values(whole, axes).sum(0)
        projected, area = target[: len(axes)], target[len(axes)]
        scale = np.concatenate(
            [projected, [area], np.full(3, projected.mean()), np.full(6, area / 3)]
        )
        self.parts = np.sum([_area_values(image, axes) for image in images], axis=0) / scale
        self.target = target / scale
        self.weight = np.concatenate([projected.mean() / projected, np.ones(10)])

    def rows(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the least-squares rows (a, c) and what they should give (a,); where the area is least, more so.

        There few triangles make it, and it changes fastest with the direction.
        """
        return (self.parts * self.weight).T, self.target * self.weight

    def error(self, which: list[int], weights: np.ndarray) -> float:
        """Return the largest relative error of the candidates `which` with `weights` (k,)."""
        return float(np.abs(weights @ self.parts[which] - self.target).max())

    def worst(
        self, which: list[int], weights: np.ndarray, least: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the rows of errors larger than `least`."""
        large = np.abs(weights @ self.parts[which] - self.target) > least
        return self.parts[:, large].T, self.target[large]


def _area_values(points: DragPoints, axes: np.ndarray) -> np.ndarray:
    first, second = points.tangents[:, :, :, 0]
    normal = np.cross(first, second)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    pairs = normal[:, [0, 1, 2, 0, 0, 1]] * normal[:, [0, 1, 2, 1, 2, 2]]
    values = [np.abs(normal @ axes.T), np.ones((len(normal), 1)), normal, pairs]
    return np.hstack(values) * points.areas[:, None]


class _System:
    """Non-negative least squares over candidates, in its normal equations."""

    def __init__(self, blocks: list[tuple[np.ndarray, np.ndarray]], shares: list[float]) -> None:
        self.size = len(blocks[0][1])
        candidates = blocks[0][0].shape[1]
        self.gram, self.right = np.zeros((candidates, candidates)), np.zeros(candidates)
        self.square = 0.0
        for (rows, target), share in zip(blocks, shares, strict=True):
            self.add(rows, target, share)
        self.ridge = _RIDGE * np.trace(self.gram) / len(self.gram)

    def add(self, rows: np.ndarray, target: np.ndarray, share: float) -> None:
        """Add rows (m, c) and what they should give (m,), all together with a weight `share`."""
        weight = share * self.size / len(target)
        self.gram += weight * (rows.T @ rows)
        self.right += weight * (target @ rows)
        self.square += weight * float(target @ target)

    def solved(self, which: list[int]) -> tuple[list[int], np.ndarray]:
        """Return the candidates of `which` whose weights are positive, k of them, and the weights (k,)."""
        while which:
            own = self.gram[np.ix_(which, which)] + self.ridge * np.eye(len(which))
            weights = sla.solve(own, self.right[which], assume_a="pos")
            if (weights > 0.0).all():
                return which, weights
            which = [i for i, w in zip(which, weights, strict=True) if w > 0.0]
        return [], np.zeros(0)

    def residual(self, which: list[int], weights: np.ndarray) -> float:
        """Return the squared residual of the candidates `which` with `weights` (k,)."""
        return self.square - float(weights @ self.right[which])

    def gains(self, which: list[int]) -> np.ndarray:
        """Return how much of the squared residual each candidate (c,) would take if it joined."""
        if not which:
            left, size = self.right, np.diag(self.gram)
        else:
            own = self.gram[np.ix_(which, which)] + self.ridge * np.eye(len(which))
            factor = np.linalg.cholesky(own)
            turned = sla.solve_triangular(factor, self.gram[which], lower=True)
            solved = sla.solve_triangular(factor, self.right[which], lower=True)
            left = self.right - solved @ turned
            size = np.diag(self.gram) - (turned**2).sum(0)
        usable = (left > 0.0) & (size > 1e-9 * np.diag(self.gram))
        gain = np.where(usable, left**2 / np.where(usable, size, 1.0), 0.0)
        gain[which] = 0.0
        return gain

    def grown(self, which: list[int], count: int) -> tuple[list[int], np.ndarray]:
        """Return at most `count` candidates, `which` and those that gain most, one by one; weights as `solved`."""
        which, weights = self.solved(which)
        for _ in range(2 * count):  # some leave again
            gain = self.gains(which)
            if len(which) >= count or not gain.max() > 0.0:
                break
            which, weights = self.solved([*which, int(gain.argmax())])
        return which, weights

    def swapped(self, which: list[int]) -> tuple[list[int], np.ndarray]:
        """Return as many candidates, each exchanged for another while that helps; weights as `solved`."""
        which, weights = self.solved(which)
        for _ in range(_SWAPS):
            before = self.residual(which, weights)
            for i in list(which):
                if i not in which:
                    continue
                others = [j for j in which if j != i]
                best = int(self.gains(others).argmax())
                if best == i:
                    continue
                tried = self.solved([*others, best])
                if self.residual(*tried) < self.residual(which, weights):
                    which, weights = tried
            if self.residual(which, weights) > 0.999 * before:
                break
        return which, weights
