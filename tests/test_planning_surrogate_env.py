"""The vectorised surrogate environment against brute force."""

import numpy as np
import planning_samples as samples
import pytest

from defplan_mj.planning.scenes import SceneBatch, novel_scenes, training_scenes
from defplan_mj.planning.surrogate_env import (
    COLLISION,
    RUNNING,
    SUCCESS,
    TIMEOUT,
    SurrogateEnv,
    run_on_surrogate,
    scan,
)
from defplan_mj.task import Navigation

NAVIGATION = Navigation()


def ray(position, angle, centres, radii, laser_range):
    """Return the distance to the nearest circle along one ray, by the quadratic formula."""
    nearest = laser_range
    direction = np.array([np.cos(angle), np.sin(angle)])
    for centre, radius in zip(centres, radii, strict=True):
        offset = position - centre
        b, c = offset @ direction, offset @ offset - radius**2
        if radius > 0 and b * b > c and -b - np.sqrt(b * b - c) > 0:
            nearest = min(nearest, -b - np.sqrt(b * b - c))
    return nearest


def test_the_laser_agrees_with_one_ray_at_a_time():
    generator = np.random.default_rng(0)
    n, m, beams = 40, 6, 64
    position, yaw = generator.uniform(-3, 3, (n, 2)), generator.uniform(-4, 4, n)
    radii = generator.uniform(-0.5, 1.5, (n, m)).clip(0)  # a quarter of them is not there
    bearing, gap = generator.uniform(0, 7, (n, m)), generator.uniform(0.05, 12, (n, m))
    away = (radii + gap)[..., None] * np.stack([np.cos(bearing), np.sin(bearing)], 2)
    centres = position[:, None] + away
    measured = scan(*(a.astype(np.float32) for a in (position, yaw, centres, radii)), beams, 10.0)
    expected = np.array(
        [
            [
                ray(position[i], yaw[i] + 2 * np.pi * k / beams, centres[i], radii[i], 10.0)
                for k in range(beams)
            ]
            for i in range(n)
        ]
    )
    # A ray that grazes a circle may be decided either way in float32.
    differ = np.abs(measured - expected) > 1e-3
    assert differ.mean() < 1e-3
    assert (expected < 10).mean() > 0.1


def test_a_scan_from_inside_an_obstacle_is_zero_and_of_empty_space_is_the_range():
    inside = scan(np.zeros((1, 2)), np.zeros(1), np.full((1, 1, 2), 0.1), np.ones((1, 1)), 8, 10.0)
    empty = scan(np.zeros((1, 2)), np.zeros(1), np.zeros((1, 0, 2)), np.zeros((1, 0)), 8, 10.0)
    assert not inside.any() and np.all(empty == 10)


@pytest.mark.parametrize("speed", [0.0, 2.0])
def test_collisions_agree_with_the_motion_sampled_finely(speed):
    surrogate = samples.surrogate()
    batch = training_scenes(NAVIGATION, 300, 1)
    generator = np.random.default_rng(2)
    if speed:
        batch.velocities[:] = generator.normal(0, speed, batch.velocities.shape)
    # Scenes as they are seen close to the obstacles: move them towards the start.
    batch.centres[:] = 0.35 * batch.centres
    env = SurrogateEnv(surrogate, NAVIGATION, batch)
    start, yaw = env.position.astype(float), env.yaw.astype(float)
    gaits = generator.integers(0, 3, env.n)
    collided = env.step(gaits).outcome == COLLISION
    x, y, _ = surrogate.planar()[gaits].T
    motion = np.column_stack([np.cos(yaw) * x - np.sin(yaw) * y, np.sin(yaw) * x + np.cos(yaw) * y])
    margin = np.full(env.n, np.inf)
    for share in np.linspace(0, 1, 201):
        centres = batch.centres + share * surrogate.cycle_seconds * batch.velocities
        gap = np.linalg.norm(centres - (start + share * motion)[:, None], axis=2)
        gap[batch.radii == 0] = np.inf
        margin = np.minimum(margin, (gap - batch.radii).min(1) - surrogate.radius)
    sure = np.abs(margin) > 1e-3
    assert np.array_equal(collided[sure], margin[sure] < 0)
    assert 0.1 < collided.mean() < 0.9 and sure.mean() > 0.95


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
    _, target = SurrogateEnv(samples.surrogate(), NAVIGATION, samples.batch(scene)).observe()
    assert np.allclose(target, [[5, 0]], atol=1e-5)


def test_endless_robots_start_anew_and_report_where_the_episode_ended():
    batch = training_scenes(NAVIGATION, 50, 0)
    env = SurrogateEnv(samples.surrogate(), NAVIGATION, batch, 30, np.random.default_rng(0))
    ended = 0
    for _ in range(60):
        step = env.step(np.zeros(30, int))
        done = step.outcome != RUNNING
        ended += done.sum()
        assert np.array_equal(step.laser[~done], step.final_laser[~done])
        assert np.all(env.cycles[done] == 0) and np.all(env.position[done] == 0)
        assert np.allclose(
            np.linalg.norm(step.target[done], axis=1),
            np.linalg.norm(batch.targets[env.scene[done]], axis=1),
            rtol=1e-5,
        )
    assert ended > 10


def test_the_same_seed_gives_the_same_transitions_to_the_bit():
    def play(seed):
        env = SurrogateEnv(
            samples.surrogate(),
            NAVIGATION,
            training_scenes(NAVIGATION, 50, 0),
            16,
            np.random.default_rng(seed),
            noise=1.0,
        )
        return np.concatenate([env.step(np.arange(16) % 3).laser for _ in range(20)])

    assert np.array_equal(play(1), play(1))
    assert not np.array_equal(play(1), play(2))


def test_noise_scatters_the_cycles_by_the_surrogates_deviations():
    surrogate = samples.surrogate(scatter=0.05)
    batch = samples.batch(samples.scene())
    env = SurrogateEnv(surrogate, NAVIGATION, batch, 5000, np.random.default_rng(0), noise=2.0)
    env.step(np.ones(5000, int))
    moved = np.column_stack([env.position, env.yaw])
    assert np.allclose(moved.mean(0), surrogate.planar()[1], atol=0.01)
    assert np.allclose(moved.std(0), 0.1, atol=0.01)


def test_a_policy_that_steers_at_the_target_reaches_it_where_nothing_is_in_the_way():
    def steer(laser, target, robots):
        bearing = np.arctan2(target[:, 1], target[:, 0])
        return np.select([bearing > 0.3, bearing < -0.3], [1, 2], 0)

    scenes = SceneBatch.of(novel_scenes(NAVIGATION, 20, 0, obstacles=0))
    assert run_on_surrogate(samples.surrogate(), NAVIGATION, scenes, steer).rate() == 1
