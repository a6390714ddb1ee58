"""The peer in the benchmark: MuJoCo's own deformable (flex) on the same mesh, material and time step."""

from __future__ import annotations

import time

import mujoco
import numpy as np

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.model import Body
from defplan_mj.body.tetmesh import volumes

PARAMETRISATIONS = ("full", "trilinear")


def flex_step_ms(
    body: Body, timestep: float = 0.04, steps: int = 20, rate: float = 1.0
) -> dict[str, float]:
    """Return the median wall time of one mj_step, ms, for a full and a trilinear flex of the body.

    The flex has the body's tetrahedra, mass and elasticity, no gravity and no contact; it starts
    with an isochoric strain rate, so that its elastic forces work. Time integration is MuJoCo's
    implicit 'discrete' one with CG, which alone is stable at steps of this size; with the default
    limit of 100 iterations the full flex of the fish does not converge (a relative residual of
    0.7%, a third of the time), so the limit is 1000.

    Args:
        timestep: s.
        steps: timed, after a few untimed ones.
        rate: strain rate at the start, 1/s.

    Raises:
        DefplanError: a step did not converge.
    """
    return {
        kind: 1e3 * _median_step(body, kind, timestep, steps, rate) for kind in PARAMETRISATIONS
    }


def _median_step(body: Body, kind: str, timestep: float, steps: int, rate: float) -> float:
    model = flex_model(body, kind, timestep)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    # every moving body has three slide joints along x, y, z
    places = data.xpos[model.jnt_bodyid]
    strain_rate = rate * np.diag([1.0, -0.5, -0.5])
    data.qvel[:] = np.einsum("ji,ji->j", places @ strain_rate, model.jnt_axis)
    for _ in range(3):
        mujoco.mj_step(model, data)
    seconds = []
    for _ in range(steps):
        start = time.perf_counter()
        mujoco.mj_step(model, data)
        seconds.append(time.perf_counter() - start)
    if sum(data.warning.number) or not np.isfinite(data.qpos).all():
        raise DefplanError(f"MuJoCo's {kind} flex did not converge at a time step of {timestep} s")
    return float(np.median(seconds))


def flex_model(body: Body, kind: str, timestep: float) -> mujoco.MjModel:
    """Return a model of the body as a flex of the given kind of degrees of freedom.

    Its elastic energy is that of the body's material: MuJoCo 3.17 takes twice the lambda of the E
    and nu that a full flex is given, and fills the whole bounding box of a trilinear one.
    """
    young, poisson = body.mesh_material.youngs_modulus, body.material.poissons_ratio
    if kind == "full":
        young, poisson = _half_lambda(young, poisson)
    else:
        box = float(np.ptp(body.vertices, axis=0).prod())
        young *= float(volumes(body.vertices, body.tetrahedra).sum()) / box
    xml = f"""
    <mujoco>
      <option timestep="{timestep}" integrator="discrete" solver="CG" iterations="1000"
        tolerance="1e-6" gravity="0 0 0"/>
      <size memory="200M"/>
      <worldbody>
        <flexcomp name="flex" type="direct" dim="3" dof="{kind}" mass="{body.mass}" radius="0.001"
          point="{_numbers(body.vertices)}" element="{_numbers(body.tetrahedra)}">
          <elasticity young="{young}" poisson="{poisson}" damping="{body.material.damping}"/>
          <contact contype="0" conaffinity="0" selfcollide="none"/>
        </flexcomp>
      </worldbody>
    </mujoco>"""
    return mujoco.MjModel.from_xml_string(xml)


def _half_lambda(young: float, poisson: float) -> tuple[float, float]:
    """Return E and nu of the material with the same mu and half the lambda."""
    lame = young * poisson / ((1 + poisson) * (1 - 2 * poisson)) / 2
    shear = young / (2 * (1 + poisson))
    return shear * (3 * lame + 2 * shear) / (lame + shear), lame / (2 * (lame + shear))


def _numbers(array: np.ndarray) -> str:
    return " ".join(map(str, array.ravel().tolist()))
