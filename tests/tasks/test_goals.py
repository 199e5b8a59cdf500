"""Tasks tell whether their drones have goals, and infos and metrics keep to it."""

import numpy as np
import pytest

import bulletuav
from bulletuav.analysis.metrics import Meter
from bulletuav.commands.fly import shown_infos
from bulletuav.tasks import find_task

WITHOUT = {"coverage", "los", "mec", "mec_advanced", "mobile_users", "patrol", "search"}
FAST = {"dynamics": "single_integrator", "num_drones": 2, "action": "velocity"}


def small(name):
    """Options of a fast environment of a task."""
    cities = (
        {"area": 250.0, "num_layouts": 1} if "num_layouts" in vars(find_task(name).Config()) else {}
    )
    if name == "obstacles":
        cities = {}
    if find_task(name).needs_cables:
        cities["dynamics"] = "rigid_body"
    return FAST | cities | ({"leg": 50.0} if "navigation" in name else {})


def test_these_tasks_have_no_goals():
    assert {name for name in bulletuav.list_tasks() if not find_task(name).has_goals} == WITHOUT


@pytest.mark.parametrize("name", bulletuav.list_tasks())
def test_infos_tell_the_way_to_goals_where_there_are_goals(name):
    """All agents, at reset and at every step, have the same keys."""
    env = bulletuav.parallel_env(name, **small(name))
    _, first = env.reset(seed=0)
    *_, infos = env.step({agent: np.zeros(3, np.float32) for agent in env.agents})
    keys = {frozenset(info) for told in (first, infos) for info in told.values()}
    assert len(keys) == 1
    (told,) = keys
    assert ("goal_distance" in told) == (name not in WITHOUT)
    assert told >= set(shown_infos(env.aviary.task))
    if name not in WITHOUT:
        offset = env.aviary.scene.goal[0, 1] - env.aviary.swarm.position[0, 1]
        assert infos["drone_1"]["goal_distance"] == pytest.approx(np.linalg.norm(offset))
    env.close()


@pytest.mark.parametrize("name", ["mec", "hover"])
def test_metrics_of_goals_are_those_of_tasks_with_goals(name):
    aviary = bulletuav.Aviary(name, **small(name), horizon=3)
    aviary.reset(seeds=0)
    meter = Meter(aviary)
    while aviary.alive.any():
        flown = aviary.alive.copy()
        meter.record(aviary.step(np.zeros((1, 2, 3))), flown)
    row = meter.row(0)
    for metric in ("goal_distance", "fairness", "throughput"):
        assert np.isfinite(row[metric]) == (name == "hover")
    assert np.isfinite(row["served"]) == (name == "mec")
    aviary.close()


def test_queues_are_told():
    aviary = bulletuav.Aviary("mec", **small("mec"), arrival_rate=2.0)
    aviary.reset(seeds=0)
    step = aviary.step(np.zeros((1, 2, 3)))
    np.testing.assert_array_equal(step.info["queue"], aviary.scene.memory["queue"])
    assert step.info["queue"].max() > 0
    aviary.close()
