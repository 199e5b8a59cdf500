"""Parts of a task: what it asks all of them for, in the order in which they were added."""

import contextlib
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
import pytest

import bulletuav
from bulletuav.tasks import Spawn, Task
from bulletuav.tasks.goal_flight import FlightConfig, GoalFlight
from bulletuav.tasks.observations.base import make_drone_block
from bulletuav.tasks.parts.base import Part, Starts

QUICK = {"dynamics": "single_integrator"}


class Counter(Part):
    """Counts decisions, moves goals up, draws power, and notes each in infos."""

    def __init__(self, name, step):
        self.name, self.step = name, step

    def memory(self):
        return {self.name: ()}

    def move_scene(self, scene, time, flying, rngs):
        scene.goal[flying, :, 2] += self.step
        return False

    def update_memory(self, frame, rngs):
        frame.scene.memory[self.name][:] += 1

    def payload_power(self, scene):
        return self.step

    def quantities(self):
        return {f"{self.name}_twice": lambda frame: 2 * self._counted(frame)}

    def _counted(self, frame):
        return frame.scene.memory[self.name][:, None] + np.zeros(frame.alive.shape)

    def info(self, frame):
        return {f"count_{self.name}": self._counted(frame)}

    def world_state(self):
        return {self.name: make_drone_block(self.name, "1", 100.0, 2)}

    def finish(self, spawn, is_given, rng):
        return spawn._replace(goal=2 * spawn.goal + self.step)


class Counting(Task):
    """Hovers, and lets two parts count."""

    name = "counting"
    observation = ("position",)
    reward: ClassVar = {"both": (lambda frame: np.ones(frame.alive.shape), 1.0)}
    defaults: ClassVar = {"num_drones": 2, "horizon": 10}

    def __init__(self, config, context):
        super().__init__(config, context)
        self.first, self.second = self.add(Counter("one", 1.0)), self.add(Counter("two", 10.0))

    def spawn(self, rng):
        return Spawn(np.array([(0.0, 0, 10), (5.0, 0, 10)]), np.zeros((2, 3)))


def test_a_task_asks_its_parts_in_their_order():
    with contextlib.closing(bulletuav.Aviary(Counting, **QUICK)) as aviary:
        aviary.reset(seeds=0)
        np.testing.assert_array_equal(aviary.scene.goal, np.full((1, 2, 3), 2 * 1.0 + 10.0))
        infos = [aviary.step(np.zeros((1, 2, 3))).info for _ in range(3)]
        np.testing.assert_array_equal(aviary.scene.goal[..., 2], np.full((1, 2), 12.0 + 3 * 11.0))
        assert infos[-1]["count_one"][0, 0] == infos[-1]["count_two"][0, 1] == 3
        assert aviary.task.payload_power(aviary.scene) == 11.0
        assert {"one_twice", "two_twice"} <= set(aviary.task.quantities())


def test_a_task_without_parts_leaves_pythons_turns_out():
    class Plain(Counting):
        name = "plain"

        def __init__(self, config, context):
            Task.__init__(self, config, context)

    with contextlib.closing(bulletuav.Aviary(Plain, **QUICK)) as aviary:
        for method in ("move_scene", "update_memory", "payload_power", "finish", "info"):
            assert not aviary.task.overrides_method(method)
        aviary.reset(seeds=0)
        with contextlib.closing(bulletuav.Aviary(Counting, **QUICK)) as other:
            other.reset(seeds=0)
            names = [aviary.simulation.make_program().names, other.simulation.make_program().names]
    assert names[0].count("") < names[1].count("")


def test_goals_respawn_where_starts_draw_further_ones_alone():
    class Somewhere(Starts):
        def draw(self, rng):
            return Spawn(np.array([(0.0, 0, 40)]), np.array([(1.0, 0, 40)]))

    @dataclass(frozen=True)
    class AgainConfig(FlightConfig):
        """As those of flights to goals, which respawn."""

        at_goal: Literal["leave", "respawn"] = "respawn"

    class Again(GoalFlight[AgainConfig]):
        name = "again"
        defaults: ClassVar = {**GoalFlight.defaults, "num_drones": 1, "difficulty": "easy"}

        def __init__(self, config, context):
            super().__init__(config, context)
            self.starts = Somewhere()

    with contextlib.closing(bulletuav.Aviary(Again, **QUICK)) as aviary:
        aviary.reset(seeds=0)
        with pytest.raises(ValueError, match="draws no further goals"):
            aviary.step(np.zeros((1, 1, 3)))
