"""The soft body as plain data: mesh, modes, rotation-strain reduction, drag points; saved as one file."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from defplan_mj.base import files

FORMAT_VERSION = 2
REMAKE = "build it again from its mesh with `defplan body MESH`"
LIMITS = {"modes": 16, "basis": 64, "samples": 40, "drag points": 512}
"""What the kernel has room for (kernel.h)."""


@dataclass(frozen=True)
class Material:
    """Isotropic elastic material.

    Attributes:
        density: kg/m^3.
        youngs_modulus: Pa.
        poissons_ratio: dimensionless, below 0.5.
        damping: stiffness-proportional damping, s.
        control_stiffness: stiffness of the pull towards the target shape, in units of the elastic one.
    """

    density: float = 1000.0
    youngs_modulus: float = 1e6
    poissons_ratio: float = 0.4
    damping: float = 0.02
    control_stiffness: float = 4.0


@dataclass(frozen=True)
class Medium:
    """What surrounds the body.

    Attributes:
        name: 'water' or 'air'.
        density: of the fluid, kg/m^3.
        drag_normal: drag coefficient of motion along the surface's normal.
        drag_tangential: friction coefficient of the skin.
        gravity: acceleration of the body along z after buoyancy, m/s^2 (0 for a neutrally buoyant body).
        righting_height: metacentric height, m; a moment rights the body's z axis (0: none).
    """

    name: str = "water"
    density: float = 1000.0
    drag_normal: float = 1.0
    drag_tangential: float = 0.01
    gravity: float = 0.0
    righting_height: float = 0.03


@dataclass(frozen=True, eq=False)  # the same object, or not: arrays are not compared
class Body:
    """A reduced soft body in its rest frame: metres, centre of mass at the origin, z up, x forward.

    A shape is q in R^r (modal coordinates, 1 is about 1 rad of rotation or 0.4 of strain); the
    displacement is u(q) = basis z(q), z(q) = C vec(F_S(q) - I) over the sampled tetrahedra S, and
    F_e(q) = exp([skew_e q]) (I + strain_e q) (rotation-strain coordinates, Pan et al. [22]).

    Attributes:
        name: what the body is called.
        vertices: (n, 3) rest positions, m.
        tetrahedra: (t, 4) vertex indices, positive volume.
        faces: (f, 3) surface triangles, outward.
        vertex_mass: (n,) lumped mass, kg.
        modes: (n, 3, r) linear elastic modes, scaled to the unit of q.
        frequencies: (r,) Hz of the linear modes.
        stiffness: (r,) diagonal of K in the elastic energy 1/2 q^T K q, J.
        amplitude: (r,) largest |q| that gaits may ask for; the reduction is sampled up to it.
        basis: (n, 3, k) mass-orthonormal displacement basis, no motion of the centre of mass, kg^-1/2.
        sampled: (s,) sampled tetrahedra; of elastic shapes those whose features the fit began with.
        feature_map: (s, 9, r) maps q to skew vector (3) and strain (e11, e12, e13, e22, e23, e33).
        feature_weights: (k, 9 s) the matrix C; columns run over s, then row-major F - I.
        moments: (k+1, k+1, 3, 3) S_ab = sum_v m_v Phi_a Phi_b^T with Phi = (vertices | basis).
        drag_points: (p, 3, k+1) points of the surface that take drag: rest position | basis.
        drag_tangents: (2, p, 3, k+1) images of two unit rest tangents: t = drag_tangents (1, z).
        drag_areas: (p,) m^2, how much of the surface a point stands for: its area vector is area (t1 x t2),
            outward.
        surface: (n_s,) indices of the vertices on the surface, sorted.
        mesh_softening: factor of Young's modulus in the mesh's elements: linear tetrahedra are too stiff
            in bending, with it the lowest frequencies are those of the body (`convergence`).
    """

    name: str
    material: Material
    medium: Medium
    vertices: np.ndarray
    tetrahedra: np.ndarray
    faces: np.ndarray
    vertex_mass: np.ndarray
    modes: np.ndarray
    frequencies: np.ndarray
    stiffness: np.ndarray
    amplitude: np.ndarray
    basis: np.ndarray
    sampled: np.ndarray
    feature_map: np.ndarray
    feature_weights: np.ndarray
    moments: np.ndarray
    drag_points: np.ndarray
    drag_tangents: np.ndarray
    drag_areas: np.ndarray
    surface: np.ndarray
    mesh_softening: float = 1.0
    source: dict = field(default_factory=dict)  # mesh file, options, quality: what the report shows

    @property
    def mesh_material(self) -> Material:
        """The material that the mesh's elements are given, so that the body is of `material`."""
        young = self.material.youngs_modulus * self.mesh_softening
        return replace(self.material, youngs_modulus=young)

    @property
    def mass(self) -> float:
        """Total mass, kg."""
        return float(self.vertex_mass.sum())

    @property
    def n_modes(self) -> int:
        """r, the number of modal coordinates."""
        return self.modes.shape[2]

    @property
    def n_basis(self) -> int:
        """k, the size of the displacement basis."""
        return self.basis.shape[2]

    @property
    def length(self) -> float:
        """Longest extent of the rest shape, m."""
        return float(np.ptp(self.vertices, axis=0).max())

    @property
    def surface_faces(self) -> np.ndarray:
        """(f, 3) surface triangles as indices into `surface`."""
        return np.searchsorted(self.surface, self.faces)

    @cached_property
    def hash(self) -> str:
        """Content hash (64 hex digits); gaits, policies and logs name the body by it."""
        return files.content_hash(self._arrays(), self._meta())

    def nearly(self, other: Body, tolerance: float = 1e-6) -> bool:
        """Say whether `other` is this body up to rounding: another machine's build of the same mesh.

        Processors add in another order, so that two builds differ by some 1e-10 and have other hashes.

        Args:
            tolerance: of the largest number of an array.
        """
        if (self.material, self.medium) != (other.material, other.medium):
            return False
        pairs = [(mine, other._arrays()[name]) for name, mine in self._arrays().items()]
        pairs.append((np.array(self.mesh_softening), np.array(other.mesh_softening)))
        return all(
            a.shape == b.shape
            and bool(np.all(np.abs(a - b) <= tolerance * np.abs(a).max(initial=0)))
            for a, b in pairs
        )

    def _arrays(self) -> dict[str, np.ndarray]:
        return {f.name: getattr(self, f.name) for f in fields(self) if f.type == "np.ndarray"}

    def _meta(self) -> dict:
        return {
            "name": self.name,
            "material": asdict(self.material),
            "medium": asdict(self.medium),
            "mesh_softening": self.mesh_softening,
            "source": self.source,
        }

    def save(self, path: str | Path) -> None:
        """Write the body to `path` (npz), atomically."""
        files.save_archive(path, "body", FORMAT_VERSION, self._arrays(), self._meta())

    @classmethod
    def load(cls, path: files.Source) -> Body:
        """Read a body of `save`.

        Raises:
            DefplanError: the file is missing, damaged or of another version, or its content is no body.
        """
        # imported here: it looks into bodies
        from defplan_mj.body.validate import validate_body

        arrays, meta, _ = files.load_archive(path, "body", FORMAT_VERSION, REMAKE)
        with files.fields_of(path, "body"):
            body = cls(
                name=meta["name"],
                material=Material(**meta["material"]),
                medium=Medium(**meta["medium"]),
                mesh_softening=meta["mesh_softening"],
                source=meta["source"],
                **arrays,
            )
            validate_body(body, str(path))
        return body
