"""Shapes of least elastic energy: against the full FEM's own rest, and what a reduction makes of them."""

import numpy as np
import pytest
import scipy.optimize as so
import trimesh

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.build import build_body
from defplan_mj.body.check import reconstruction_error
from defplan_mj.body.elastic_shapes import ElasticShapes
from defplan_mj.body.features import fitted_features
from defplan_mj.body.model import Body
from defplan_mj.body.options import BodyOptions
from defplan_mj.body.reduction import exact_shapes, exact_shapes_of, reach, sample_shapes
from defplan_mj.body.rotation_strain import RotationStrain, deformation
from defplan_mj.body.tetmesh import TetMesh
from defplan_mj.dynamics.full_fem import FemState, FullFem


@pytest.fixture(scope="module")
def bar(tmp_path_factory: pytest.TempPathFactory) -> Body:
    """A bar of 4 modes in elastic shapes."""
    path = tmp_path_factory.mktemp("bar") / "bar.obj"
    trimesh.creation.box((1.0, 0.2, 0.12)).export(path)
    options = BodyOptions(
        vertices=150, modes=4, basis=24, samples=12, drag_points=40, shapes="elastic"
    )
    return build_body(path, options)


def nearest_of(body: Body) -> RotationStrain:
    return RotationStrain(TetMesh(body.vertices, body.tetrahedra), body.vertex_mass, body.modes)


def distance(body: Body, a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sqrt(body.vertex_mass @ ((a - b) ** 2).sum(1)))


def test_a_shape_is_where_the_full_fem_rests_under_its_target(bar):
    control = bar.material.control_stiffness
    target = np.array([1.0, -0.6, 0.5, 0.4])
    fem = FullFem(bar, 5.0, drag=False, integrator="implicit-euler", substeps=1)
    shape = control / (1.0 + control) * target
    state = fem.at(shape, target=target)
    for _ in range(4):
        now = fem.step(state, target).now
        state = FemState(now, now, target, target, now)
    elastic = (
        bar.vertices + ElasticShapes(nearest_of(bar), bar.mesh_material).displacement(shape)[0]
    )
    paper = bar.vertices + nearest_of(bar).displacement(shape)[0]
    size = distance(bar, elastic, bar.vertices)
    assert distance(bar, state.now, elastic) <= 2e-3 * size
    assert distance(bar, state.now, paper) >= 1e-2 * size  # what it is for


def test_a_small_shape_is_its_linear_modes(bar):
    shape = 1e-3 * np.array([0.3, -1.0, 0.5, 0.8])
    u = exact_shapes_of(bar).displacement(shape)[0]
    linear = bar.modes @ shape
    assert np.abs(u - linear).max() <= 2e-3 * np.abs(linear).max()


def test_no_shape_near_it_has_less_energy(bar):
    exact = exact_shapes_of(bar)
    assert isinstance(exact, ElasticShapes)
    rng = np.random.default_rng(0)
    for shape in sample_shapes(3, 0.8 * bar.amplitude, rng):
        u = exact.displacement(shape)[0]
        least = exact.misfit(shape, u)
        assert least < exact.misfit(shape, exact.nearest.displacement(shape)[0])
        for mode in np.moveaxis(bar.modes, 2, 0):
            moved = [exact.misfit(shape, u + by * mode) for by in (-1e-2, 1e-2)]
            assert min(moved) > least


def test_the_reduction_keeps_the_shapes(bar):
    assert bar.source["options"]["shapes"] == "elastic"
    assert reconstruction_error(bar, 40, seed=3)["relative_rms"] <= 0.04


def test_the_reach_is_where_the_largest_target_is_rested_at(bar):
    wide = reach(bar.amplitude, bar.material, "elastic")
    np.testing.assert_allclose(wide, bar.amplitude * 0.8)
    assert reach(bar.amplitude, bar.material, "rotation-strain") is bar.amplitude


def test_the_features_gradient_is_that_of_finite_differences(monkeypatch):
    rng = np.random.default_rng(1)
    features, q, z = rng.normal(size=(2, 9, 3)), rng.normal(size=(40, 3)), rng.normal(size=(40, 4))
    seen = []

    def minimise(loss, start, **options):
        value, gradient = loss(start)
        seen.append(so.check_grad(lambda x: loss(x)[0], lambda x: loss(x)[1], start))
        seen.append(np.linalg.norm(gradient))
        return so.OptimizeResult(x=start, fun=value)

    monkeypatch.setattr("defplan_mj.body.features.so.minimize", minimise)
    fitted_features(features, q, z, 1)
    assert seen[0] <= 1e-3 * seen[1]


def test_fitted_features_give_shapes_that_those_of_tetrahedra_do_not():
    rng = np.random.default_rng(2)
    true, start = 0.3 * rng.normal(size=(2, 3, 9, 4))
    q = rng.normal(size=(300, 4))
    z = deformation(true, q).reshape(300, -1) @ rng.normal(size=(27, 5))

    def lack(maps, weights):
        return np.linalg.norm(deformation(maps, q).reshape(300, -1) @ weights.T - z)

    before = lack(*fitted_features(start, q, z, 0)) / np.linalg.norm(z)
    after = lack(*fitted_features(start, q, z, 300)) / np.linalg.norm(z)
    assert after < 0.5 * before


def test_another_kind_of_shapes_is_refused():
    with pytest.raises(
        DefplanError, match="shapes is 'round': it can be rotation-strain or elastic"
    ):
        build_body("x.obj", BodyOptions(shapes="round"))


def test_the_kind_tells_the_exact_map(bar):
    nearest = nearest_of(bar)
    assert exact_shapes(nearest, bar.material, "rotation-strain") is nearest
    assert isinstance(exact_shapes_of(bar), ElasticShapes)
