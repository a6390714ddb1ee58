"""The vectorised surrogate environment against brute force."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from defplan_mj.dynamics.rigid import RigidDynamics
from defplan_mj.planning.frames import attitude_frames, random_attitudes, random_directions
from defplan_mj.planning.outcome import COLLISION, RUNNING, SUCCESS, TIMEOUT
from defplan_mj.planning.scene import SceneBatch
from defplan_mj.planning.scenes import novel_scenes, training_scenes
from defplan_mj.planning.sensors.laser import beam_directions
from defplan_mj.planning.surrogate_env import SurrogateEnv, run_on_surrogate, scan
from defplan_mj.task import Navigation
from tests.samples import planning as samples

NAVIGATION = Navigation()
SPATIAL = Navigation(space="spatial", beams=128, k2=30)
BOTH = pytest.mark.parametrize(
    ("navigation", "surrogate"),
    [(NAVIGATION, samples.surrogate()), (SPATIAL, samples.swimmer())],
    ids=["planar", "spatial"],
)


def ray(position, direction, centres, radii, laser_range):
    """Return the distance to the nearest ball along one ray, by the quadratic formula."""
    nearest = laser_range
    for centre, radius in zip(centres, radii, strict=True):
        offset = position - centre
        b, c = offset @ direction, offset @ offset - radius**2
        if radius > 0 and b * b > c and -b - np.sqrt(b * b - c) > 0:
            nearest = min(nearest, -b - np.sqrt(b * b - c))
    return nearest


@pytest.mark.parametrize("navigation", [NAVIGATION, SPATIAL], ids=["planar", "spatial"])
def test_the_laser_agrees_with_one_ray_at_a_time(navigation):
    generator = np.random.default_rng(0)
    n, m, d = 40, 6, navigation.dimension
    directions = beam_directions(navigation.beams, navigation.space)
    position = generator.uniform(-3, 3, (n, d))
    frames = attitude_frames(random_attitudes(generator, n, d), d)
    radii = generator.uniform(-0.5, 1.5, (n, m)).clip(0)  # a quarter of them is not there
    away = random_directions(generator, n * m, d).reshape(n, m, d)
    centres = position[:, None] + (radii + generator.uniform(0.05, 12, (n, m)))[..., None] * away
    a, b, c, d, e = (a.astype(np.float32) for a in (position, frames, centres, radii, directions))
    measured = scan(a, b, c, d, e, 10.0)
    expected = np.array(
        [
            [ray(position[i], frames[i] @ beam, centres[i], radii[i], 10.0) for beam in directions]
            for i in range(n)
        ]
    )
    # A ray that grazes a ball may be decided either way in float32.
    differ = np.abs(measured - expected) > 1e-3
    assert differ.mean() < 1e-3
    assert (expected < 10).mean() > 0.02


@pytest.mark.parametrize("d", [2, 3])
def test_a_scan_from_inside_an_obstacle_is_zero_and_of_empty_space_is_the_range(d):
    beams = random_directions(np.random.default_rng(0), 8, d)
    here, frames = np.zeros((1, d)), np.eye(d)[None]
    inside = scan(here, frames, np.full((1, 1, d), 0.1), np.ones((1, 1)), beams, 10.0)
    empty = scan(here, frames, np.zeros((1, 0, d)), np.zeros((1, 0)), beams, 10.0)
    assert not inside.any() and np.all(empty == 10)


@BOTH
def test_a_turned_world_gives_the_same_episode(navigation, surrogate):
    d = navigation.dimension
    batch = training_scenes(navigation, 30, 3)
    batch.centres[:] = 0.4 * batch.centres  # close to the start
    angle = np.random.default_rng(4).uniform(-2, 2, d * (d - 1) // 2)
    turn = Rotation.from_rotvec(angle if d == 3 else [0, 0, angle[0]])
    world = turn.as_matrix()[:d, :d]
    attitudes = turn * Rotation.from_quat(batch.orientations, scalar_first=True)
    turned = replace(
        batch,
        targets=batch.targets @ world.T,
        centres=batch.centres @ world.T,
        orientations=attitudes.as_quat(scalar_first=True),
    )
    first, second = (
        SurrogateEnv(surrogate, navigation, b, generator=np.random.default_rng(5), noise=1.0)
        for b in (batch, turned)
    )
    gaits = np.random.default_rng(6).integers(0, len(surrogate.task_names), (15, 30))
    for chosen in gaits:
        one, other = first.step(chosen), second.step(chosen)
        assert np.allclose(one.target, other.target, atol=1e-4)
        assert (np.abs(one.laser - other.laser) > 1e-3).mean() < 2e-3  # grazing beams
        assert (one.outcome == other.outcome).mean() > 0.95  # so may a touch be
    assert np.allclose(first.position @ world.T, second.position, atol=1e-4)
    assert np.allclose(world @ first.frames, second.frames, atol=1e-4)
    assert (one.laser < 10).mean() > 0.02


@BOTH
def test_a_thousand_turns_leave_the_frames_orthonormal_and_where_rotations_lead(
    navigation, surrogate
):
    d = navigation.dimension
    batch = training_scenes(navigation, 20, 0)
    env = SurrogateEnv(surrogate, navigation, batch)
    truth = attitude_frames(batch.orientations, d)
    exact = surrogate.motions(navigation.space).rotations
    gaits = np.random.default_rng(7).integers(0, len(surrogate.task_names), (1000, 20))
    for chosen in gaits:
        env.step(chosen)
        truth = truth @ exact[chosen]
    gram = env.frames.swapaxes(1, 2) @ env.frames
    assert np.abs(gram - np.eye(d)).max() < 1e-5
    assert np.all(np.linalg.det(env.frames) > 0)
    assert np.abs(env.frames - truth).max() < 1e-3  # float32, 1000 times


@BOTH
@pytest.mark.parametrize("speed", [0.0, 2.0])
def test_collisions_agree_with_the_motion_sampled_finely(navigation, surrogate, speed):
    batch = training_scenes(navigation, 300, 1)
    generator = np.random.default_rng(2)
    if speed:
        batch.velocities[:] = generator.normal(0, speed, batch.velocities.shape)
    # Scenes as they are seen close to the obstacles: move them towards the start.
    batch.centres[:] = 0.35 * batch.centres
    env = SurrogateEnv(surrogate, navigation, batch)
    start, frames = env.position.astype(float), env.frames.astype(float)
    gaits = generator.integers(0, len(surrogate.task_names), env.n)
    collided = env.step(gaits).outcome == COLLISION
    motion = np.einsum(
        "nij,nj->ni", frames, surrogate.motions(navigation.space).translations[gaits]
    )
    margin = np.full(env.n, np.inf)
    for share in np.linspace(0, 1, 201):
        centres = batch.centres + share * surrogate.cycle_seconds * batch.velocities
        gap = np.linalg.norm(centres - (start + share * motion)[:, None], axis=2)
        gap[batch.radii == 0] = np.inf
        margin = np.minimum(margin, (gap - batch.radii).min(1) - surrogate.radius)
    sure = np.abs(margin) > 1e-3
    assert np.array_equal(collided[sure], margin[sure] < 0)
    assert 0.1 < collided.mean() < 0.9 and sure.mean() > 0.95


@BOTH
def test_a_cycle_ends_where_the_rigid_dynamics_says(navigation, surrogate):
    d = navigation.dimension
    scenes = novel_scenes(navigation, 5, 0, obstacles=0)
    env = SurrogateEnv(surrogate, navigation, SceneBatch.of(scenes))
    dynamics = RigidDynamics(surrogate)
    gaits = np.random.default_rng(0).integers(0, len(surrogate.task_names), (12, 5))
    for chosen in gaits:
        env.step(chosen)
    for i, scene in enumerate(scenes):
        state = dynamics.rollout(np.append(np.zeros(3), scene.orientation), gaits[:, i])[-1]
        assert np.allclose(env.position[i], state[:d], atol=1e-4)
        assert np.allclose(env.frames[i], attitude_frames(state[None, 3:], d)[0], atol=1e-5)


def test_a_cycle_cannot_jump_over_a_thin_obstacle():
    surrogate = samples.surrogate(motions=((3.0, 0, 0),) * 3, radius=0.1)
    env = SurrogateEnv(surrogate, NAVIGATION, samples.batch(samples.scene([(1.5, 0.05, 0.05)])))
    assert env.step(np.zeros(1, int)).outcome[0] == COLLISION


def test_an_episode_ends_at_the_target_and_rewards_are_equation_2():
    scenes = samples.batch(samples.scene(target=(3.0, 0.0)))
    runs = run_on_surrogate(
        samples.surrogate(), NAVIGATION, scenes, lambda laser, target, robots: np.zeros(1, int)
    )
    # 4 cycles of 0.65 m: the first point within 1 m of the target at 3 m is at 2.6 m.
    assert runs.outcome[0] == SUCCESS and runs.cycles[0] == 4
    assert np.isclose(runs.reward[0], 3**2 - 0.4**2, rtol=1e-5)


def test_a_collision_costs_1000_and_a_time_out_ends_the_episode():
    scenes = samples.batch(
        samples.scene([(2.0, 0.0, 0.5)], max_cycles=5),
        samples.scene([(0.0, 50.0, 0.5)], max_cycles=5),
    )
    runs = run_on_surrogate(
        samples.surrogate(), NAVIGATION, scenes, lambda laser, target, robots: 0 * robots
    )
    assert list(runs.outcome) == [COLLISION, TIMEOUT] and list(runs.cycles) == [2, 5]
    assert runs.reward[0] < -900 < 0 < runs.reward[1]


def test_the_target_is_seen_from_the_body():
    scene = samples.scene(target=(0.0, 5.0), yaw=np.pi / 2)
    target = SurrogateEnv(samples.surrogate(), NAVIGATION, samples.batch(scene)).observe().target
    assert np.allclose(target, [[5, 0]], atol=1e-5)
    pitched = Rotation.from_euler("y", 90, degrees=True).as_quat(scalar_first=True)
    scene = samples.spheres(target=(5.0, 0.0, 2.0), orientation=pitched)  # its z is the world's x
    target = SurrogateEnv(samples.swimmer(), SPATIAL, samples.batch(scene)).observe().target
    assert np.allclose(target, [[-2, 0, 5]], atol=1e-5)


@BOTH
def test_endless_robots_start_anew_and_report_where_the_episode_ended(navigation, surrogate):
    batch = training_scenes(navigation, 50, 0)
    # All face their target, so that going forward ends episodes.
    ahead = surrogate.translations[np.linalg.norm(surrogate.translations, axis=1).argmax()]
    towards = np.zeros((50, 3))
    towards[:, : navigation.dimension] = batch.targets
    for i in range(50):
        facing, _ = Rotation.align_vectors(towards[i : i + 1], ahead[None])
        batch.orientations[i] = facing.as_quat(scalar_first=True)
    env = SurrogateEnv(surrogate, navigation, batch, 30, np.random.default_rng(0))
    gait = surrogate.task_names.index("forward")
    ended = 0
    for _ in range(60):
        step = env.step(np.full(30, gait))
        done = step.outcome != RUNNING
        ended += done.sum()
        assert np.array_equal(step.laser[~done], step.final.laser[~done])
        assert np.all(env.cycles[done] == 0) and np.all(env.position[done] == 0)
        assert np.allclose(
            np.linalg.norm(step.target[done], axis=1),
            np.linalg.norm(batch.targets[env.scene[done]], axis=1),
            rtol=1e-5,
        )
    assert ended > 10


@BOTH
def test_the_same_seed_gives_the_same_transitions_to_the_bit(navigation, surrogate):
    def play(seed):
        env = SurrogateEnv(
            surrogate,
            navigation,
            training_scenes(navigation, 50, 0),
            16,
            np.random.default_rng(seed),
            noise=1.0,
        )
        gaits = np.arange(16) % len(surrogate.task_names)
        return np.concatenate([env.step(gaits).laser for _ in range(20)])

    assert np.array_equal(play(1), play(1))
    assert not np.array_equal(play(1), play(2))


@BOTH
def test_noise_scatters_the_cycles_by_the_surrogates_deviations(navigation, surrogate):
    surrogate = replace(surrogate, rotation_sd=0 * surrogate.rotation_sd + 0.04)
    d, batch = navigation.dimension, training_scenes(navigation, 1, 0)
    env = SurrogateEnv(surrogate, navigation, batch, 5000, np.random.default_rng(0), noise=2.0)
    before = env.frames.copy()
    env.step(np.ones(5000, int))
    moved = np.einsum("nij,ni->nj", before, env.position)
    rotations, translations = surrogate.motions(navigation.space)
    assert np.allclose(moved.mean(0), translations[1], atol=0.01)
    assert np.allclose(moved.std(0), 0.06, atol=0.005)
    # What is left of the turn: about no axis in particular, each part with the deviation.
    rest = np.tile(np.eye(3), (5000, 1, 1))
    rest[:, :d, :d] = rotations[1].T @ before.swapaxes(1, 2) @ env.frames
    parts = Rotation.from_matrix(rest).as_rotvec()[:, -(d * (d - 1) // 2) :]
    assert np.allclose(parts.mean(0), 0, atol=0.01)
    assert np.allclose(parts.std(0), 0.08, atol=0.005)


def test_a_policy_that_steers_at_the_target_reaches_it_where_nothing_is_in_the_way():
    def steer(laser, target, robots):
        bearing = np.arctan2(target[:, 1], target[:, 0])
        return np.select([bearing > 0.3, bearing < -0.3], [1, 2], 0)

    scenes = SceneBatch.of(novel_scenes(NAVIGATION, 20, 0, obstacles=0))
    assert run_on_surrogate(samples.surrogate(), NAVIGATION, scenes, steer).rate() == 1
