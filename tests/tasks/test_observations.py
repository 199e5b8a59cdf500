"""Observation blocks, number by number."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bulletuav
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.spaces import widest_action_space
from bulletuav.sensors.base import Image, Label
from bulletuav.sensors.suite import known_sensors, reading_labels
from bulletuav.tasks.ingredients import block
from bulletuav.tasks.observations.motion import goal_ahead
from bulletuav.tasks.observations.observer import known_observations

CALM = {"dynamics": "point_mass", "randomization": {}}


def seen(task="crossing", **options):
    aviary = bulletuav.Aviary(task, **CALM | options)
    aviary.reset(seeds=0)
    return aviary, aviary.step(np.full((1, aviary.num_drones, 3), 0.1)).observations[0]


def test_identity_and_all_neighbours_by_hand():
    aviary, rows = seen(num_drones=3, observation=("identity", "all_neighbours"))
    position, velocity = aviary.swarm.position[0], aviary.swarm.velocity[0]
    for i in range(3):
        np.testing.assert_array_equal(rows[i, :3], np.eye(3)[i])
        others = [j for j in range(3) if j != i]
        expected = np.concatenate(
            [[*(position[j] - position[i]), *(velocity[j] - velocity[i])] for j in others]
        )
        np.testing.assert_allclose(rows[i, 3:], expected, rtol=1e-5)
    aviary.close()


def test_gone_neighbours_leave_zeros():
    options = {"num_drones": 2, "lanes": 1, "jitter": 0.0, "altitude_spread": 0.0, "margin": 1.0}
    aviary = bulletuav.Aviary(
        "crossing", observation=("neighbours", "all_neighbours"), **options, **CALM
    )
    aviary.reset(seeds=0)
    while aviary.alive[0, 1]:
        rows = aviary.step(np.array([[(0, 0, 0), (-1.0, 0, 0)]])).observations[0]
    assert aviary.alive[0, 0]
    assert not rows[0].any()
    aviary.close()


def test_how_many_neighbours_is_an_option():
    for count in (1, 5):
        aviary, rows = seen(num_drones=4, observation="neighbours", num_neighbours=count)
        assert rows.shape == (4, 7 * count)
        assert (rows[:, ::7] > 0).sum(axis=1).tolist() == [min(3, count)] * 4
        aviary.close()


def test_intruders_are_told_as_neighbours_are():
    """Of two others both are among the two nearest, now and later."""
    aviary, rows = seen(num_drones=3, observation=("neighbours", "intruders"), num_neighbours=2)
    near, later = rows.reshape(3, 2, 2, 7).swapaxes(0, 1)
    for i in range(3):
        np.testing.assert_array_equal(
            near[i][near[i, :, 0].argsort()], later[i][later[i, :, 0].argsort()]
        )
    aviary.close()


def test_obstacles_are_the_nearest_by_surface():
    ten = {"num_obstacles": 10, "num_moving": 5, "num_neighbours": 12}
    aviary, rows = seen("obstacles", num_drones=2, observation="obstacles", **ten)
    radius = np.array([obstacle.radius for obstacle in aviary.task.obstacles()])
    offset = aviary.scene.obstacle[0] - aviary.swarm.position[0, :, None]
    gap = np.linalg.norm(offset, axis=-1) - radius
    for i in range(2):
        table = rows[i].reshape(12, 8)
        order = np.argsort(gap[i])
        np.testing.assert_allclose(table[:10, 0], gap[i][order], rtol=1e-5)
        np.testing.assert_allclose(table[:10, 1:4], offset[i][order], rtol=1e-4, atol=1e-4)
        speed = aviary.scene.obstacle_velocity[0] - aviary.swarm.velocity[0, i]
        np.testing.assert_allclose(table[:10, 4:7], speed[order], rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(table[:10, 7], radius[order], rtol=1e-6)
        assert not table[10:].any()
    aviary.close()


def test_a_task_without_obstacles_observes_none():
    aviary, rows = seen(observation="obstacles", num_drones=2)
    assert rows.shape == (2, 24)
    assert not rows.any()
    aviary.close()


def test_the_last_action_is_zero_first_and_then_what_was_told():
    aviary = bulletuav.Aviary(
        "hover", observation="last_action", action="rpm", dynamics="rigid_body"
    )
    assert not aviary.reset(seeds=0).any()
    np.testing.assert_allclose(aviary.step(np.full((1, 1, 4), 14000.0)).observations, 14000)
    assert aviary.observer.space().high[0] == pytest.approx(aviary.action.high[0, 0])
    aviary.close()


@pytest.mark.parametrize("task", ["crossing", "hover", "obstacles"])
def test_normalised_observations_are_the_raw_ones_scaled_from_their_bounds(task):
    rows = {}
    for normalise in (False, True):
        aviary = bulletuav.Aviary(task, normalise=normalise, num_drones=2, seed=0)
        rows[normalise] = aviary.reset()
        space = aviary.observer.space()
        assert space.contains(rows[normalise][0, 0])
        if not normalise:
            low, high = space.low, space.high
        aviary.close()
    assert space.low.max() == -1
    assert space.high.min() == 1
    np.testing.assert_allclose(rows[True], 2 * (rows[False] - low) / (high - low) - 1, atol=1e-6)


@pytest.mark.parametrize("normalise", [False, True])
def test_a_feature_with_equal_bounds_is_constant(normalise):
    @block([Label("payload", "kg", 2.0, 2.0), Label("height", "m", 0.0, 10.0)])
    def payload(position):
        return 2.0, position[2]

    aviary, rows = seen(observation=(payload,), normalise=normalise)
    assert (rows[:, 0] == (0.0 if normalise else 2.0)).all()
    assert np.isfinite(rows).all()
    aviary.close()


SENSORS, SETUP = known_sensors(), EnvSpec("los", 1, {}).setup
VECTORS = [
    name
    for name in known_observations(SENSORS)
    if not isinstance(reading_labels(SENSORS, name, SETUP), Image)
]
"""Names of all blocks but pictures"""
SHOWN_MEMORY = {
    "dwell_time": "dwell_time",
    "server": "queue",
    "link_rates": "received",
    "next_gates": "gate_axis",
    "gate_aim": "gate_axis",
    "rank": "rank",
    "idleness": "idleness",
    "pads": "pad_drone",
    "pad_clue": "clue",
    "claimed_pads": "claimed",
    "runway": "runway_free",
    "clue_offset": "clue",
    "sighting": "sighting",
    "victims_found": "known_found",
    "searched_cells": "known_cells",
    "target_track": "track",
    "load": "load_position",
    "cable": "load_position",
    "load_goal_offset": "load_position",
}
"""Blocks that show what some tasks alone remember, and the name of that"""
SHOWN_TARGETS = (
    "centroids",
    "contribution_ahead",
    "seen_share",
    "sight",
    "sight_ahead",
    "detection",
)
"""Blocks that show targets"""


def blocks_of(task):
    """Names of all blocks that a task can show."""
    made = EnvSpec(task, 1, {}).task
    memory = made.memory()
    return tuple(
        name
        for name in VECTORS
        if (name not in SHOWN_MEMORY or SHOWN_MEMORY[name] in memory)
        and (name not in SHOWN_TARGETS or made.num_targets)
    )


@pytest.mark.parametrize("task", bulletuav.list_tasks())
def test_every_block_can_be_asked_for_in_every_task_that_has_what_it_shows(task):
    blocks, uncertain = blocks_of(task), {"radio_loss": 0.1}
    aviary = bulletuav.Aviary(task, observation=blocks, num_drones=2, randomization=uncertain)
    rows = aviary.reset(seeds=0)
    assert rows.shape[-1] == len(aviary.observer.labels)
    assert aviary.observer.space().contains(rows[0, 0])
    aviary.close()


def flown_rows(aviary, rows, world, decisions=5):
    """Observations of a world: `rows` of its start, and those of the decisions that follow."""
    size, seen = (aviary.num_drones, *widest_action_space(aviary.action).shape), [rows[world]]
    for decision in range(decisions):
        action = np.random.default_rng(decision).uniform(-0.5, 0.5, size)
        step = aviary.step(np.broadcast_to(action, (aviary.num_worlds, *size)))
        seen.append(step.observations[world])
    return np.array(seen)


@pytest.mark.parametrize("task", bulletuav.list_tasks())
def test_blocks_do_not_depend_on_other_worlds_or_earlier_flights(task):
    options = {
        "observation": blocks_of(task),
        "dynamics": "rigid_body",
        "difficulty": "medium",
        "randomization": {"radio_loss": 0.1},
    }
    batch, alone = (bulletuav.Aviary(task, count, **options) for count in (3, 1))
    first = flown_rows(batch, batch.reset(seeds=7), 1)
    again = flown_rows(batch, batch.reset(seeds=7), 1)
    restarted = batch.reset(np.array([False, True, False]), [0, 8, 0])
    for rows in (
        again,
        flown_rows(batch, restarted, 1),
        flown_rows(alone, alone.reset(seeds=8), 0),
    ):
        different = sorted({batch.observer.labels[k].name for k in np.nonzero(rows != first)[-1]})
        assert not different
    batch.close()
    alone.close()


def test_a_block_that_adds_to_its_numbers_adds_once():
    @block([Label("drones", "1", 0.0, 10.0)])
    def count(all_present, out):
        for k in range(len(all_present)):
            if all_present[k]:
                out[0] += 1.0

    aviary = bulletuav.Aviary("crossing", 2, num_drones=3, observation=count, **CALM)
    first = aviary.reset(seeds=0)
    then = aviary.step(np.zeros((2, 3, 3))).observations
    for rows in (first, then, aviary.reset(seeds=0)):
        np.testing.assert_array_equal(rows, 3.0)
    aviary.close()


@pytest.mark.parametrize("block", [*SHOWN_MEMORY, "centroids", "contribution_ahead", "seen_share"])
def test_a_block_of_what_a_task_does_not_have_is_refused(block):
    with pytest.raises(ValueError, match=f"'{block}' shows what task 'hover' does not have"):
        bulletuav.Aviary("hover", observation=block)


def test_a_reset_of_another_world_leaves_the_last_action_alone():
    aviary = bulletuav.Aviary("crossing", 2, observation="last_action", num_drones=2, **CALM)
    aviary.reset(seeds=0)
    aviary.step(np.full((2, 2, 3), 0.25))
    rows = aviary.reset(np.array([False, True]))
    np.testing.assert_allclose(rows[0], 0.25)
    assert not rows[1].any()
    aviary.close()


def test_goal_and_upward_direction_in_body_axes():
    blocks = ("body_goal_offset", "body_up", "goal_offset", "attitude")
    aviary = bulletuav.Aviary("hover", difficulty="hard", observation=blocks, randomization={})
    row = aviary.reset(seeds=0)[0, 0]
    to_world = Rotation.from_quat(row[9:])
    assert abs(row[5]) < 0.99  # it is tilted
    np.testing.assert_allclose(to_world.apply(row[:3]), row[6:9], atol=1e-5)
    np.testing.assert_allclose(to_world.apply(row[3:6]), (0, 0, 1), atol=1e-5)
    aviary.close()


def test_the_goal_ahead_is_in_level_axes_of_the_heading():
    blocks = ("goal_ahead", "goal_offset", "attitude")
    aviary = bulletuav.Aviary("hover", difficulty="hard", observation=blocks, randomization={})
    row = aviary.reset(seeds=0)[0, 0]
    yaw, pitch, roll = Rotation.from_quat(row[6:]).as_euler("ZYX")
    assert min(abs(yaw), abs(pitch) + abs(roll)) > 0.05  # it is turned and tilted
    expected = Rotation.from_euler("Z", -yaw).apply(row[3:6])
    np.testing.assert_allclose(row[:3], expected, atol=1e-4)
    aviary.close()


def test_the_goal_ahead_by_hand():
    """A goal 3 m to the east, 4 m to the north and 2 m above, of a drone that heads north."""
    north = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))
    found = goal_ahead(north, (4.0, 6.0, 12.0), (1.0, 2.0, 10.0))
    np.testing.assert_allclose(found, (4.0, -3.0, 2.0), atol=1e-12)
