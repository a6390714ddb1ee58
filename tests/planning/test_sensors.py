"""Sensors: a task has one by its name, everything that senses takes it, and a new one is one file."""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points

import numpy as np
import pytest

from defplan_mj import registry
from defplan_mj.base.errors import DefplanError
from defplan_mj.log import channels
from defplan_mj.log.messages import reading_message
from defplan_mj.planning.observation import Senses
from defplan_mj.planning.scene import SceneBatch
from defplan_mj.planning.sensors.laser import laser_of
from defplan_mj.planning.sensors.sensor import reading_size, seen_points, sensor_of
from defplan_mj.planning.shield import Shield
from defplan_mj.planning.surrogate_env import SurrogateEnv
from defplan_mj.task import Navigation
from tests.samples import host as host_samples
from tests.samples import planning as samples
from tests.samples.paths import EXAMPLES

MINE = "nearest-obstacle"


@pytest.fixture
def plugin(monkeypatch):
    """Install the sensor of docs/examples/sensor.py beside ours, as a package would."""
    monkeypatch.syspath_prepend(EXAMPLES)
    mine = EntryPoint(MINE, "sensor:SENSOR", registry.SENSORS)

    def installed(group):
        found = list(entry_points(group=group))
        return [*found, mine] if group == registry.SENSORS else found

    monkeypatch.setattr(registry, "entry_points", installed)
    sensor_of.cache_clear()
    yield
    sensor_of.cache_clear()


@pytest.mark.parametrize(
    ("space", "name"), [("planar", "planar-laser"), ("spatial", "spherical-laser")]
)
def test_a_task_that_names_no_sensor_has_the_laser_of_its_space(space, name):
    assert sensor_of(Navigation(space=space)).name == name
    assert sensor_of(Navigation(space=space, sensor=name)).name == name
    assert reading_size(Navigation(space=space, beams=7)) == 7


def test_an_unknown_sensor_is_one_sentence_with_those_there_are():
    with pytest.raises(DefplanError, match="no sensor planar-lazer, did you mean planar-laser"):
        sensor_of(Navigation(sensor="planar-lazer"))


def test_a_sensor_of_another_space_is_refused():
    with pytest.raises(
        DefplanError, match="is for spatial navigation, not for planar: take planar-laser"
    ):
        sensor_of(Navigation(sensor="spherical-laser"))


def test_every_sensor_s_features_and_points_have_the_size_of_its_readings():
    for entry in registry.sensors():
        for space in entry.value.spaces:
            there = Navigation(space=space, sensor=entry.name, beams=5)
            reading = np.full((2, reading_size(there)), 3.0)
            assert entry.value.features(reading, there).shape == reading.shape
            points, hit = entry.value.points(reading, there)
            assert points.shape == (*hit.shape, there.dimension) and hit.all()


@pytest.mark.parametrize("space", ["planar", "spatial"])
def test_a_sensor_of_a_plugin_reads_the_same_in_mujoco_and_on_the_surrogate(plugin, space):
    there = Navigation(space=space, sensor=MINE)
    scene = _scene(space)
    physics = host_samples.physics(space=space, sensor=MINE, max_obstacles=2)
    with physics.reset_context():
        physics.set_scene(scene)
    reading = physics.laser()
    env = SurrogateEnv(samples.swimmer(), there, SceneBatch.of([scene]))
    assert reading == pytest.approx(env.observe()[0][0], abs=1e-5)
    assert reading[-1] == pytest.approx(np.hypot(3, 1) - 0.5)


def test_shield_and_network_take_a_plugin_s_sensor(plugin):
    there, robot = Navigation(sensor=MINE), samples.swimmer()
    reading = SurrogateEnv(robot, there, SceneBatch.of([_scene("planar")])).observe()[0][0]
    assert seen_points(reading, there) == pytest.approx((reading[:2] * reading[2])[None])
    senses = Senses(robot, there)
    assert len(senses(reading, np.array([5.0, 0.0]))) == senses.size == 3 + 1 + 2 + 3 + 6 + 4 * 5
    touching = np.array([1.0, 0.0, 0.6])
    assert not Shield(_Ahead(), robot, there).safe(seen_points(touching, there)).all()


def test_a_log_shows_what_another_sensor_than_a_laser_sees_as_points(plugin):
    x = np.array([0, 0, 0, 1.0, 0, 0, 0])
    topic, _ = reading_message(x, np.array([1.0, 0.0, 2.0]), Navigation(sensor=MINE), 0)
    assert topic == channels.LASER_POINTS


def test_a_planner_that_needs_beams_says_so(plugin):
    with pytest.raises(
        DefplanError, match="looks at a laser's beams, and the sensor nearest-obstacle"
    ):
        laser_of(Navigation(sensor=MINE))


class _Ahead:
    def reset(self):
        pass

    def values(self, observation):
        return np.eye(5)[0]


def _scene(space):
    if space == "planar":
        return samples.scene([(3.0, 1.0, 0.5), (6.0, -2.0, 1.0)])
    return samples.spheres([(3.0, 1.0, 0.0, 0.5), (6.0, -2.0, 3.0, 1.0)])
