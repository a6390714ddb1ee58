"""Motions that a body may make before it has a gait: random rhythmic shapes, carried by the water.

The shape is given, q(t); position and attitude follow from the balance of momentum with the drag:

    M (dv/dt + w x v) = F(q, dq/dt, v, w),   dL/dt + w x L = T + righting,   L = I(q) w + h(q, dq/dt).

Inertia and quadratic drag both go with the square of the tempo, so the motion is that at any tempo.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from defplan_mj.body.drag import DragPoints, Moments, forces
from defplan_mj.body.model import Body
from defplan_mj.body.rotation_strain import affine_coordinates, exponential

_STEPS, _CYCLES = 24, 3  # of the integration a cycle; until the last one, which is used
_MOST_STEPS, _FASTEST = 24 * 32, 1e3  # a cycle, if it diverges; lengths a cycle: it has diverged
_DIFFERENCE = 1e-5  # of q, for derivatives
_GRAVITY = 9.81
_STIR, _SPIN = 0.5, 1.0  # rms velocity and spin at the start, lengths and radians a cycle


@dataclass(frozen=True)
class Rhythm:
    """Shapes q(t) of c trajectories: a mean and two harmonics of each modal coordinate.

    Attributes:
        mean: (c, r).
        swing: (2, c, r) amplitudes of the harmonics.
        phase: (2, c, r) rad.
        tempo: 1/s.
    """

    mean: np.ndarray
    swing: np.ndarray
    phase: np.ndarray
    tempo: float

    def at(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Return q and dq/dt (c, r) at `time` (s)."""
        rate = 2.0 * np.pi * self.tempo * np.array([1.0, 2.0])[:, None, None]
        angle = rate * time + self.phase
        q = self.mean + (self.swing * np.sin(angle)).sum(0)
        return q, (rate * self.swing * np.cos(angle)).sum(0)


def random_rhythm(body: Body, count: int, rng: np.random.Generator) -> Rhythm:
    """Draw shapes of `count` trajectories, from small to the amplitude, in one to all modes.

    As `reduction.sample_shapes`, the 2-norm stays below 1.5 times the amplitude.
    """
    r = body.n_modes
    some = rng.uniform(size=(count, r)).argsort(1) < rng.integers(1, r + 1, (count, 1))
    size = rng.uniform(-1.0, 1.0, (count, r)) * some
    size /= np.abs(size).max(1, keepdims=True)
    size *= np.minimum(1.0, 1.5 / np.linalg.norm(size, axis=1, keepdims=True))
    size *= rng.uniform(0.3, 1.0, (count, 1)) ** 0.7 * body.amplitude
    parts = rng.dirichlet([0.6, 2.0, 0.5], (count, r)) * size[:, :, None]
    return Rhythm(
        parts[:, :, 0],
        parts[:, :, 1:].transpose(2, 0, 1),
        rng.uniform(0.0, 2.0 * np.pi, (2, count, r)),
        float(body.frequencies[0]),
    )


def moments_of(
    body: Body,
    q: np.ndarray,
    q_dot: np.ndarray,
    velocity: np.ndarray,
    spin: np.ndarray,
    attitude: np.ndarray,
) -> Moments:
    """Return what a body does at m moments; shapes and rates (m, r), the rest as in `Moments`."""
    r, step = body.n_modes, _DIFFERENCE * np.eye(body.n_modes)
    both = np.concatenate([q[:, None] + step, q[:, None] - step], axis=1).reshape(-1, r)
    zeta = affine_coordinates(body, both).reshape(len(q), 2, r, -1)
    slopes = ((zeta[:, 0] - zeta[:, 1]) / (2.0 * _DIFFERENCE)).transpose(0, 2, 1)
    zeta_dot = np.einsum("mkr,mr->mk", slopes, q_dot)
    return Moments(affine_coordinates(body, q), zeta_dot, slopes[:, 1:], velocity, spin, attitude)


def _moving(
    body: Body, shape: tuple[np.ndarray, np.ndarray], velocity: np.ndarray, attitude: np.ndarray
) -> Moments:
    """Return the same without dz/dq, which the rigid motion does not need, at no spin."""
    q, q_dot = shape
    ahead, behind = q + _DIFFERENCE * q_dot, q - _DIFFERENCE * q_dot
    zeta_dot = (affine_coordinates(body, ahead) - affine_coordinates(body, behind)) / (
        2.0 * _DIFFERENCE
    )
    none = np.zeros((len(q), body.n_basis, 0))
    return Moments(
        affine_coordinates(body, q), zeta_dot, none, velocity, np.zeros_like(velocity), attitude
    )


def swimming_motions(
    body: Body, points: DragPoints, count: int, phases: int, rng: np.random.Generator
) -> Moments:
    """Swim `count` random rhythms, and return `phases` moments of the last cycle of each.

    Args:
        points: take the drag that carries the body; a few are enough for a plausible motion.

    Returns:
        The moments, phase by phase: entry i * count + j is phase i of trajectory j.
    """
    rhythm = random_rhythm(body, count, rng)
    velocity = _stir(count, rng) * _STIR * body.length * rhythm.tempo
    spin = _stir(count, rng) * _SPIN * rhythm.tempo
    attitude = np.tile(np.eye(3), (count, 1, 1))
    up = np.array([0.0, 0.0, 1.0]) + 0.3 * rng.normal(size=(count, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    steps = _STEPS
    with np.errstate(all="ignore"):  # what diverges is done again
        while True:
            done = _swim(body, points, rhythm, (velocity, spin, attitude, up), steps, phases)
            fast = np.abs(done.velocity).max() / (body.length * rhythm.tempo)
            if fast < _FASTEST or steps >= _MOST_STEPS:
                return done
            steps *= 2


def _swim(
    body: Body,
    points: DragPoints,
    rhythm: Rhythm,
    start: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    steps: int,
    phases: int,
) -> Moments:
    """Integrate with `steps` a cycle; thin, light bodies, which the drag stops fast, want many."""
    velocity, spin, attitude, up = start
    h = 1.0 / (rhythm.tempo * steps)
    now = _moving(body, rhythm.at(0.0), velocity, attitude)
    inertia, inner = _rotation(body, now)
    turning = np.einsum("mij,mj->mi", inertia, spin) + inner
    now = _spun(body, now, turning)
    first = steps * (_CYCLES - 1)
    instants = first + np.arange(phases) * steps // phases
    kept = []
    for i in range(steps * _CYCLES):  # the midpoint rule
        rates = _rates(body, points, now, turning, up)
        shape = rhythm.at((i + 0.5) * h)
        middle = turning + 0.5 * h * rates[1]
        half = _spun(body, _moving(body, shape, velocity + 0.5 * h * rates[0], attitude), middle)
        if i in instants:
            kept.append(moments_of(body, *shape, half.velocity, half.spin, attitude))
        rates = _rates(body, points, half, middle, up + 0.5 * h * rates[2])
        velocity, turning, up = (
            value + h * rate for value, rate in zip((velocity, turning, up), rates, strict=True)
        )
        up /= np.linalg.norm(up, axis=1, keepdims=True)
        attitude = attitude @ exponential(h * half.spin)
        now = _spun(body, _moving(body, rhythm.at((i + 1) * h), velocity, attitude), turning)
    names = ("zeta", "zeta_dot", "slopes", "velocity", "spin", "attitude")
    return Moments(*(np.concatenate([getattr(item, name) for item in kept]) for name in names))


def _stir(count: int, rng: np.random.Generator) -> np.ndarray:
    return rng.normal(size=(count, 3)) * rng.uniform(size=(count, 1))


def _rotation(body: Body, now: Moments) -> tuple[np.ndarray, np.ndarray]:
    """Return the inertia (m, 3, 3), kg m^2, and the angular momentum of the change of shape (m, 3)."""
    flat = body.moments.reshape(len(body.moments), -1)
    half = (now.zeta @ flat).reshape(len(now), -1, 3, 3)
    second = np.einsum("mbij,mb->mij", half, now.zeta)
    mixed = np.einsum("mbij,mb->mij", half, now.zeta_dot)
    trace = np.trace(second, axis1=1, axis2=2)[:, None, None]
    skew = mixed - mixed.transpose(0, 2, 1)
    return trace * np.eye(3) - second, np.stack([skew[:, 1, 2], skew[:, 2, 0], skew[:, 0, 1]], 1)


def _spun(body: Body, now: Moments, turning: np.ndarray) -> Moments:
    """Return the moments with the spin that an angular momentum (m, 3) asks for."""
    inertia, inner = _rotation(body, now)
    return replace(now, spin=np.linalg.solve(inertia, (turning - inner)[..., None])[..., 0])


def _rates(
    body: Body, points: DragPoints, now: Moments, turning: np.ndarray, up: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the changes of velocity, angular momentum and of the world's up in the body's frame."""
    # in a medium too thin to carry it the body moves as it would in water
    drag = forces(points, body.medium, now)[:, :, :6].sum(1)
    drag *= max(1.0, body.material.density / (body.medium.density or 1.0))
    righting = body.mass * _GRAVITY * body.medium.righting_height
    torque = drag[:, 3:] + righting * np.cross(np.array([0.0, 0.0, 1.0]), up)
    return (
        drag[:, :3] / body.mass - np.cross(now.spin, now.velocity),
        torque - np.cross(now.spin, turning),
        -np.cross(now.spin, up),
    )
