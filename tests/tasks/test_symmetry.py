"""Nothing depends on who is who, nor on where north is."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import bulletuav
from bulletuav.tasks import find_task
from bulletuav.tasks.base import Spawn

CALM = {
    "randomization": {},
    "num_drones": 4,
    "weights": {"efficiency": 1.0, "speed_keeping": 0.5, "fairness": -0.1},
}
OBSERVATION = ("position", "velocity", "goal", "goal_offset", "neighbours")
ACTIONS = {"rates": 4, "velocity": 3}
PER_DRONE = ("position", "quaternion", "velocity", "rates", "goal", "goal_velocity")


def changed(name, change):
    """The task with its starts changed."""
    kind = find_task(name)

    class Changed(kind):
        def spawn(self, rng):
            return change(super().spawn(rng))

    return Changed


def flown(task, actions, dynamics, seed, action="velocity"):
    aviary = bulletuav.Aviary(
        task, dynamics=dynamics, action=action, observation=OBSERVATION, **CALM
    )
    rows = [aviary.reset(seeds=seed)[0]]
    rewards = []
    for action in actions:
        step = aviary.step(action[None])
        rows.append(step.observations[0])
        rewards.append(step.rewards[0])
    labels = [label.name for label in aviary.observer.labels]
    aviary.close()
    return np.array(rows), np.array(rewards), labels


def permuted(spawn, order):
    parts = spawn._asdict()
    for name in PER_DRONE:
        if np.ndim(parts[name]) == 2:
            parts[name] = parts[name][order]
    return Spawn(**parts)


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body", "point_mass"])
@pytest.mark.parametrize("task", ["crossing", "converge", "obstacles"])
@settings(max_examples=5, deadline=None)
@given(st.permutations(range(4)), st.integers(0, 10**6))
def test_permuting_drones_permutes_observations_and_rewards(task, dynamics, order, seed):
    order = np.array(order)
    actions = np.random.default_rng(seed).uniform(-0.5, 0.5, (8, 4, 3))
    rows, rewards, _ = flown(task, actions, dynamics, seed)
    other = changed(task, lambda spawn: permuted(spawn, order))
    rows_2, rewards_2, _ = flown(other, actions[:, order], dynamics, seed)
    np.testing.assert_allclose(rows_2, rows[:, order], atol=1e-6, rtol=1e-6)
    np.testing.assert_allclose(rewards_2, rewards[:, order], atol=1e-6)


def turned(vectors, angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(vectors) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])


def turned_spawn(spawn, angle):
    vectors = ("position", "velocity", "goal", "goal_velocity", "obstacle", "obstacle_velocity")
    parts = spawn._asdict()
    for name in vectors:
        if np.ndim(parts[name]) == 2:
            parts[name] = turned(parts[name], angle)
    turn = Rotation.from_euler("z", angle)
    parts["quaternion"] = (turn * Rotation.from_quat(parts["quaternion"])).as_quat()
    return Spawn(**parts)


@pytest.mark.parametrize(
    ("dynamics", "action"),
    [("bullet", "rates"), ("rigid_body", "rates"), ("point_mass", "velocity")],
)
@settings(max_examples=5, deadline=None)
@given(st.floats(0, 6.28), st.integers(0, 10**6))
def test_turning_the_scene_about_the_vertical_turns_vectors_and_changes_nothing_else(
    dynamics, action, angle, seed
):
    """Drones are turned with the scene; `rates` are those of the body, and a point has no nose."""
    actions = np.random.default_rng(seed).uniform(-0.1, 0.1, (8, 4, ACTIONS[action]))
    options = {"dynamics": dynamics, "seed": seed, "action": action}
    rows, rewards, labels = flown(changed("converge", lambda spawn: spawn), actions, **options)
    if action == "velocity":
        actions = turned(actions, angle)
    rows_2, rewards_2, _ = flown(
        changed("converge", lambda spawn: turned_spawn(spawn, angle)), actions, **options
    )
    expected = rows.copy()
    for k, label in enumerate(labels):
        if label.endswith(" x"):
            expected[..., k : k + 3] = turned(rows[..., k : k + 3], angle)
    # Observations are float32, of up to 100 m.
    np.testing.assert_allclose(rows_2, expected, atol=2e-5, rtol=1e-6)
    np.testing.assert_allclose(rewards_2, rewards, atol=1e-6)
