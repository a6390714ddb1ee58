"""MuJoCo's flex in the benchmark is the same body: its mass, mesh and elastic forces."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from defplan_mj.host.flex_peer import PARAMETRISATIONS, flex_model, flex_step_ms
from tests.samples import host as samples


@pytest.mark.parametrize(("kind", "dofs"), [("full", 3 * 300), ("trilinear", 24)])
def test_flex_has_the_bodys_mesh_and_mass(kind, dofs):
    body = samples.fish()
    model = flex_model(body, kind, 0.04)
    assert model.nflexelem == len(body.tetrahedra)
    assert model.nflexvert == len(body.vertices)
    assert abs(model.nv - dofs) <= 6  # the vertex count is met within 2
    assert model.body_mass.sum() == pytest.approx(body.mass, rel=1e-6)
    assert model.opt.timestep == 0.04


STRAINS = {
    "dilation": np.eye(3),
    "shear": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]),
    "stretch": np.diag([1.0, 0.0, 0.0]),
}


@pytest.mark.parametrize("kind", PARAMETRISATIONS)
@pytest.mark.parametrize("strain", STRAINS)
def test_elastic_energy_is_the_materials(kind, strain):
    body, strain = samples.fish(), 1e-5 * STRAINS[strain]
    model = flex_model(body, kind, 0.04)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    places, at_rest = data.xpos[model.jnt_bodyid].copy(), data.qfrc_passive.copy()
    data.qpos[:] = np.einsum("ji,ji->j", places @ strain, model.jnt_axis)
    mujoco.mj_forward(model, data)
    energy = -0.5 * (data.qfrc_passive - at_rest) @ data.qpos
    young, poisson = body.mesh_material.youngs_modulus, body.material.poissons_ratio
    lame, shear = young * poisson / ((1 + poisson) * (1 - 2 * poisson)), young / 2 / (1 + poisson)
    density = 0.5 * lame * np.trace(strain) ** 2 + shear * (strain**2).sum()
    volume = body.mass / body.material.density
    assert energy == pytest.approx(density * volume, rel=1e-4)


def test_steps_are_timed_without_a_solve_that_fails():
    milliseconds = flex_step_ms(samples.fish(), steps=3)
    assert set(milliseconds) == set(PARAMETRISATIONS)
    assert all(value > 0 for value in milliseconds.values())
