"""Public attributes of ingredients that nothing reads, and policies of other tasks."""

import functools
from typing import ClassVar

import numpy as np
import pytest

import bulletuav
from bulletuav.analysis.recording import fly_episode
from bulletuav.analysis.transitions import DatasetJob
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics import find_dynamics
from bulletuav.dynamics.base import Dynamics
from bulletuav.policies import Policy, find_policy
from bulletuav.registry import names
from bulletuav.sensors import Label, Sensor
from bulletuav.sensors.suite import find_sensor
from bulletuav.tasks import Spawn, Task, TaskConfig, find_task

FLY = {"dynamics": "point_mass", "horizon": 3}


class Near(Task[TaskConfig]):
    name = "near"
    observation = ("position", "goal_offset")
    reward: ClassVar = {"distance": -0.1}

    def spawn(self, rng):
        n = self.context.num_drones
        start = np.stack([5.0 * np.arange(n), np.zeros(n), np.full(n, 20.0)], axis=1)
        return Spawn(position=start, goal=start + 5.0)


class Anchor(Sensor):
    name = "anchor"
    numbers = (Label("distance", "m", 0.0, 500.0),)

    def measure(self, moment):
        return {"anchor": np.linalg.norm(moment.after.position, axis=-1)}


class Gliding(Dynamics):
    consumes = SetpointLevel.VELOCITY

    def advance_substep(self, swarm, alive, setpoint, air):
        swarm.velocity[:] = setpoint[..., :3]


class Still(Policy):
    name = "still"
    actions = ("velocity",)
    reads_swarm = False

    def reset(self, mask): ...

    def act(self, observations, swarm):
        return np.zeros(swarm.position.shape)


KINDS = {
    "task": (Near, find_task),
    "sensor": (Anchor, find_sensor),
    "dynamics": (Gliding, find_dynamics),
    "policy": (Still, find_policy),
}
TYPOS = [
    ("task", "sucess", "success"),
    ("task", "default", "defaults"),
    ("task", "end", "ends"),
    ("task", "update_memmory", "update_memory"),
    ("task", "move_scence", "move_scene"),
    ("task", "sensors", "required_sensors"),
    ("sensor", "number", "numbers"),
    ("sensor", "messure", "measure"),
    ("dynamics", "feel_surface", "feels_surface"),
    ("policy", "remember", "remembers"),
    ("policy", "encode", "encoded"),
]


@pytest.mark.parametrize(("kind", "name", "meant"), TYPOS)
def test_an_unknown_public_attribute_is_refused_with_the_nearest(kind, name, meant):
    base, find = KINDS[kind]
    find(base)
    said = f"{kind} Own has '{name}', which is no attribute of a {kind}: did you mean .*'{meant}'"
    for value in (None, lambda self: None):
        with pytest.raises(ValueError, match=said):
            find(type("Own", (base,), {name: value}))
    # Also with an annotation, which is for names unlike those that are known
    if kind != "task" or name not in ("sensors", "end"):
        with pytest.raises(ValueError, match=said):
            find(type("Own", (base,), {name: 1, "__annotations__": {name: int}}))


@pytest.mark.parametrize("kind", KINDS)
def test_helpers_begin_with_an_underscore_or_are_annotated_or_stand_beside(kind):
    base, find = KINDS[kind]

    class Helper:
        def nearby(self):
            return 5

    helpers = {"_helper": len, "gain": 0.5, "__annotations__": {"gain": float, "table": list}}
    own = type("Own", (base, Helper), helpers)
    find(own)
    find(type("More", (own,), {"gain": 0.7}))
    with pytest.raises(ValueError, match=f"{kind} Own has 'helper', which is no attribute"):
        find(type("Own", (base,), {"helper": len}))


@pytest.mark.parametrize("kind", KINDS)
def test_the_packages_own_may_be_derived_from(kind):
    find = KINDS[kind][1]
    for name in names(kind):
        found = find(name)
        if kind == "policy":
            continue  # specs, whose classes were checked
        own = found if isinstance(found, type) else type(found)
        find(type("Own", (own,), {"name": "own"}))


def test_a_typo_is_refused_wherever_the_ingredient_is_used():
    wrong = type("Wrong", (Near,), {"sucess": 1})
    for use in (bulletuav.check_task, functools.partial(bulletuav.parallel_env, **FLY)):
        with pytest.raises(ValueError, match="did you mean 'success'"):
            use(wrong)
    wrong = type("Wrong", (Anchor,), {"messure": 1})
    with pytest.raises(ValueError, match="did you mean 'measure'"):
        bulletuav.parallel_env("hover", sensors=(wrong(),), **FLY)
    wrong = type("Wrong", (Gliding,), {"consume": 1})
    with pytest.raises(ValueError, match="did you mean 'consumes'"):
        bulletuav.parallel_env("hover", dynamics=wrong)


def test_options_as_attributes_of_a_task_are_refused_with_their_place():
    with pytest.raises(ValueError, match="Options of environments go into defaults"):
        find_task(type("Own", (Near,), {"horizon": 5}))


class OfBlocks(Still):
    name = "of_blocks"

    def act(self, observations, swarm):
        return 0.0 * self.aviary.observer.split(observations)["uwb"]


class OfTask(Still):
    name = "of_task"

    def reset(self, mask):
        self.aviary.task.track  # noqa: B018


class OwnMistake(Still):
    name = "own_mistake"

    def act(self, observations, swarm):
        return self.undefined


@pytest.mark.parametrize(("policy", "said"), [(OfBlocks, "'uwb'"), (OfTask, "attribute 'track'")])
def test_a_policy_of_another_task_is_named_with_what_it_needs(policy, said):
    with pytest.raises(ValueError, match=f"{policy.name}' needs {said}.*: task 'hover' observes "):
        bulletuav.check_policy(policy, "hover", **FLY)


class OfConfig(Still):
    name = "of_config"

    def __init__(self, aviary):
        super().__init__(aviary)
        aviary.task.config.track  # noqa: B018


@pytest.mark.parametrize(
    ("policy", "said"),
    [(OfBlocks, "'uwb'"), (OfTask, "attribute 'track'"), (OfConfig, "attribute 'track'")],
)
def test_flights_of_a_policy_of_another_task_name_what_it_needs(policy, said, tmp_path):
    """Wherever it flies: in evaluations, datasets and recordings."""
    described = f"{policy.name}' needs {said}.*: task 'hover' observes .*; use the task"
    with pytest.raises(ValueError, match=described):
        bulletuav.evaluate("hover", policy, episodes=1, **FLY)
    with pytest.raises(ValueError, match=described):
        list(DatasetJob("hover", policy, 1, 0, FLY).fly([range(1)]))
    aviary = bulletuav.Aviary("hover", 1, **FLY)
    with pytest.raises(ValueError, match=described):
        fly_episode(aviary, find_policy(policy)(aviary), 0)
    aviary.close()


def test_other_mistakes_of_a_policy_are_raised_as_they_are():
    with pytest.raises(AttributeError, match="undefined"):
        bulletuav.check_policy(OwnMistake, "hover", **FLY)
