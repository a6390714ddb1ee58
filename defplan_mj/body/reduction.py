"""The second reduction: a small displacement basis, and its coordinates from a few tetrahedra.

u(q) = B z(q), z(q) = C vec(F_S(q) - I): B by proper orthogonal decomposition of sampled shapes,
the tetrahedra S by block orthogonal matching pursuit, C by ridge least squares. Shapes of least elastic energy
are no sums of the features of tetrahedra, which are then moved (`features`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from defplan_mj.base.progress import Progress, no_progress
from defplan_mj.body.elastic_shapes import ElasticShapes
from defplan_mj.body.features import fit_weights, fitted_features
from defplan_mj.body.model import Body, Material
from defplan_mj.body.options import SHAPES
from defplan_mj.body.rotation_strain import RotationStrain, deformation
from defplan_mj.body.tetmesh import TetMesh

ExactShapes = RotationStrain | ElasticShapes
"""What the reduction comes near to."""
_SHAPES = 800  # sampled
_FITTED = (200, 100)  # shapes whose features are fitted: at least, and for each mode
_ROUNDS = 200  # of the features' fit
_CANDIDATES = 400  # tetrahedra that the pursuit chooses from


@dataclass(frozen=True)
class Reduction:
    """See `Body` for the shapes."""

    basis: np.ndarray
    sampled: np.ndarray
    feature_map: np.ndarray
    feature_weights: np.ndarray


def exact_shapes(nearest: RotationStrain, material: Material, kind: str) -> ExactShapes:
    """Return the exact map of a kind of `BodyOptions.shapes`."""
    return nearest if kind == SHAPES[0] else ElasticShapes(nearest, material)


def exact_shapes_of(body: Body) -> ExactShapes:
    """Return the exact map that a body is the reduction of."""
    mesh = TetMesh(body.vertices, body.tetrahedra)
    nearest = RotationStrain(mesh, body.vertex_mass, body.modes)
    return exact_shapes(nearest, body.mesh_material, shapes_of(body))


def shapes_of(body: Body) -> str:
    """Return the kind of shapes (`BodyOptions.shapes`) that a body has."""
    return str(body.source.get("options", {}).get("shapes", SHAPES[0]))


def reach(amplitude: np.ndarray, material: Material, kind: str) -> np.ndarray:
    """Return the largest |q| (r,) that a reduction is sampled up to.

    Elastic shapes: where a body rests under the largest target; rotation-strain shapes: the target itself.
    """
    control = material.control_stiffness
    if kind == SHAPES[0] or control == 0.0:
        return amplitude
    return amplitude * control / (1.0 + control)


def sample_shapes(count: int, amplitude: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return shapes q (count, r) as gaits use them, from small to `amplitude` (r,).

    The largest coordinate is spread over (0.05, 1)^0.7 of its bound; the 2-norm stays below 1.5
    times the bound, for several modes at full swing at once are not met.
    """
    r = len(amplitude)
    q = rng.uniform(-1.0, 1.0, (count, r))
    q *= rng.uniform(0.05, 1.0, (count, 1)) ** 0.7 / np.abs(q).max(1, keepdims=True)
    q *= np.minimum(1.0, 1.5 / np.maximum(np.linalg.norm(q, axis=1, keepdims=True), 1e-12))
    return q * amplitude


def pod_basis(shapes: np.ndarray, mass: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the mass-orthonormal basis (n, 3, k) of shapes (m, n, 3), and coordinates (m, k).

    The component of largest size of each basis vector is positive.
    """
    root = np.repeat(np.sqrt(mass), 3)
    rows = shapes.reshape(len(shapes), -1) * root
    values, vectors = np.linalg.eigh(rows @ rows.T)
    order = np.argsort(values)[::-1][:count]
    basis, triangular = np.linalg.qr(rows.T @ vectors[:, order])
    largest = np.take_along_axis(basis, np.abs(basis).argmax(0)[None], axis=0)
    basis = basis * np.sign(largest)
    coordinates = rows @ basis
    return (basis / root[:, None]).reshape(*shapes.shape[1:], count), coordinates


def choose_tetrahedra(features: np.ndarray, targets: np.ndarray, count: int) -> list[int]:
    """Choose the blocks that explain the targets best, one after another (block OMP).

    Args:
        features: (c, m, 9) F - I of c candidates in m shapes.
        targets: (m, k) coordinates to explain.
    """
    blocks = features.copy()
    residual = targets.copy()
    floor = 1e-7 * np.einsum("cmi,cmi->c", blocks, blocks).max() * np.eye(9)
    chosen: list[int] = []
    for _ in range(count):
        turned = blocks.transpose(0, 2, 1)
        gram = turned @ blocks + floor
        share = turned @ residual
        gain = (share * np.linalg.solve(gram, share)).sum((1, 2))
        gain[chosen] = -1.0
        best = int(np.argmax(gain))
        chosen.append(best)
        u, s, _ = np.linalg.svd(blocks[best], full_matrices=False)
        u = u[:, s > 1e-6 * s[0]]
        residual -= u @ (u.T @ residual)
        blocks -= u @ (u.T @ blocks)
    return chosen


def reduce_shapes(
    exact: ExactShapes,
    mass: np.ndarray,
    reach: np.ndarray,
    basis: int,
    samples: int,
    progress: Progress = no_progress,
    seed: int = 0,
) -> Reduction:
    """Build the second reduction from sampled shapes up to `reach` (r,)."""
    rng = np.random.default_rng(seed)
    fitted = isinstance(exact, ElasticShapes)
    count = _FITTED[0] + _FITTED[1] * len(reach) if fitted else _SHAPES
    q = sample_shapes(count, reach, rng)
    displaced = exact.displacement(q, progress)
    vectors, z = pod_basis(displaced, mass, basis)
    candidates = np.sort(
        rng.choice(
            len(exact.volumes),
            min(_CANDIDATES, len(exact.volumes)),
            replace=False,
            p=exact.volumes / exact.volumes.sum(),
        )
    )
    values = deformation(exact.features[candidates], q).reshape(count, len(candidates), 9)
    chosen = choose_tetrahedra(values.transpose(1, 0, 2), z, samples)
    sampled = candidates[np.sort(chosen)]
    maps = exact.features[sampled]
    if fitted:
        maps, weights = fitted_features(maps, q, z, _ROUNDS)
    else:
        weights = fit_weights(deformation(maps, q).reshape(count, -1), z)
    return Reduction(vectors, sampled, maps, weights)
