"""Parts of a task: what it asks all of them for, in the order in which they were added."""

import contextlib
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np
import pytest

import bulletuav
from bulletuav.compiled.kernel import kernel
from bulletuav.tasks import Spawn, Task, end, find_task
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


HIDDEN = (
    ("move_scene", lambda self, scene, time, flying, rngs: False),
    ("memory", lambda self: {}),
    ("update_memory", lambda self, frame, rngs: None),
    ("payload_power", lambda self, scene: 1.0),
    ("quantities", lambda self: {}),
    ("info", lambda self, frame: {}),
)


@pytest.mark.parametrize(("method", "function"), HIDDEN)
def test_a_method_that_forgets_its_parts_is_refused(method, function):
    forgetful = type("Forgetful", (Counting,), {"name": "forgetful", method: function})
    message = rf"Forgetful\.{method} hides that of the part Counter: call super\(\)\.{method}"
    with pytest.raises(TypeError, match=message):
        bulletuav.Aviary(forgetful, **QUICK)


def test_methods_that_no_part_has_need_no_super():
    class Bounded(Counting):
        name = "bounded"

        def memory_bounds(self):
            return {"one": (0, 10)}

    with contextlib.closing(bulletuav.Aviary(Bounded, **QUICK)) as aviary:
        assert aviary.task.memory_bounds() == {"one": (0, 10)}


def test_two_parts_of_one_name_are_refused():
    class Twice(Counting):
        name = "twice"

        def __init__(self, config, context):
            super().__init__(config, context)
            self.add(Counter("one", 2.0))

    with pytest.raises(ValueError, match="two parts define 'one'"):
        bulletuav.Aviary(Twice, **QUICK)


@kernel
def add_speeds(velocity, time, total, speed):
    for w in range(time.shape[0]):
        for i in range(velocity.shape[1]):
            total[w, i] += velocity[w, i, 0] if speed > 0 else 0.0


@kernel
def write_mean(total, time, eastward):
    for w in range(time.shape[0]):
        for i in range(total.shape[1]):
            eastward[w, i] = total[w, i] / max(time[w], 1e-9)


class Eastward(Part):
    """Sums velocities, and reports their sum by time, in compiled calls."""

    compiled_infos = ("eastward",)

    def memory(self):
        return {"total": (2,)}

    def memory_calls(self, frame):
        total = frame.scene.memory["total"]
        return ((add_speeds, frame.after.velocity, frame.time, total, 1.0),)

    def info_calls(self, frame, infos):
        return ((write_mean, frame.scene.memory["total"], frame.time, infos["eastward"]),)


class Moving(Counting):
    """A task with infos of compiled calls."""

    name = "moving"

    def __init__(self, config, context):
        super().__init__(config, context)
        self.add(Eastward())


def test_compiled_calls_of_parts_update_memory_and_write_infos():
    with contextlib.closing(bulletuav.Aviary(Moving, **QUICK)) as aviary:
        aviary.reset(seeds=0)
        assert not aviary.first_info()["eastward"].any()
        period, total = 1.0 / aviary.options.decision_hz, np.zeros(2)
        for k in range(1, 4):
            info = aviary.step(np.array([[[0.1 * k, 0.0, 0.0], [0.0, 0.0, 0.0]]])).info
            total += aviary.swarm.velocity[0, :, 0]
            np.testing.assert_allclose(info["eastward"], [total / (k * period)])
        assert total[0] > 0 == total[1]
        aviary.reset(seeds=1)
        assert not aviary.first_info()["eastward"].any()


def test_a_task_of_its_own_update_sees_what_compiled_calls_of_parts_wrote():
    seen = []

    class Watching(Moving):
        name = "watching"

        def update_memory(self, frame, rngs):
            before = frame.scene.memory["total"].copy()
            super().update_memory(frame, rngs)
            seen.append(frame.scene.memory["total"] - before)

    with contextlib.closing(bulletuav.Aviary(Watching, **QUICK)) as aviary:
        aviary.reset(seeds=0)
        for _ in range(2):
            aviary.step(np.array([[[0.1, 0.0, 0.0], [0.2, 0.0, 0.0]]]))
            np.testing.assert_allclose(seen[-1], aviary.swarm.velocity[..., 0])
    assert len(seen) == 2


def test_infos_of_tasks_and_of_compiled_calls_have_different_names():
    def info(self, frame):
        return {**super(Moving, self).info(frame), "eastward": np.zeros(frame.alive.shape)}

    again = type("Again", (Moving,), {"name": "moving_again", "info": info})
    message = "gave 'eastward', as a part of it does: choose"
    aviary = bulletuav.Aviary(again, **QUICK)
    with contextlib.closing(aviary), pytest.raises(ValueError, match=message):
        aviary.reset(seeds=0)


@end
def too_low(position):
    """Return True below 30 m."""
    return position[2] < 30.0


@pytest.mark.parametrize(("base", "speed"), [("crossing", 20.0), ("los", 15.0)])
def test_ends_of_a_task_on_a_base_end_episodes_as_its_own(base, speed):
    kind = find_task(base)
    low = type("Low", (kind,), {"name": "low", "ends": (too_low,)})
    options = {**QUICK, "difficulty": "easy", "action": "velocity", "num_drones": 2}
    with contextlib.closing(bulletuav.Aviary(low, **options)) as aviary:
        aviary.reset(seeds=0)
        for _ in range(100):
            step = aviary.step(np.full((1, 2, 3), (0.0, 0.0, -1.0)))
            if step.terminated.any():
                break
        below = aviary.swarm.position[..., 2] < 30.0
        np.testing.assert_array_equal(step.terminated, below)
        assert below.any()


def test_a_reward_for_time_counts_an_early_end_that_a_task_adds():
    low = type("Low", (find_task("crossing"),), {"name": "low", "ends": (too_low,)})
    options = {**QUICK, "difficulty": "easy", "num_drones": 2, "max_speed": 20.0}
    with contextlib.closing(bulletuav.Aviary(low, **options)) as aviary:
        aviary.reset(seeds=0)
        decisions = [aviary.step(np.full((1, 2, 3), (0.0, 0.0, -1.0))) for _ in range(7)]
        count = next(k for k, step in enumerate(decisions, 1) if step.terminated[0, 0])
        assert count > 1
        costs = [step.info["reward/time"][0, 0] for step in decisions]
        assert costs[0] == -0.5
        assert costs[count - 1] == pytest.approx(-0.5 * (1 + aviary.options.horizon - count))


@pytest.mark.parametrize(
    ("declared", "method"),
    [({"success": too_low}, "succeeded"), ({"ends": (too_low,)}, "terminated")],
)
def test_conditions_without_effect_are_refused(declared, method):
    def nothing(self, frame):
        return np.zeros(frame.alive.shape, dtype=bool)

    lost = type("Lost", (Counting,), {"name": "lost", method: nothing, **declared})
    message = rf"{next(iter(declared))} of task 'lost' has no effect, as Lost\.{method}"
    with pytest.raises(TypeError, match=message):
        bulletuav.Aviary(lost, **QUICK)


@pytest.mark.parametrize("base", ["crossing", "los", "pursuit_evasion"])
def test_success_that_a_base_replaces_is_refused(base):
    other = type("Other", (find_task(base),), {"name": "other", "success": too_low})
    with pytest.raises(TypeError, match="success of task 'other' has no effect"):
        bulletuav.Aviary(other, **QUICK)


def test_a_new_default_of_an_option_keeps_its_bounds():
    crossing = find_task("crossing")

    @dataclass(frozen=True)
    class ManyConfig(crossing.Config):
        """Options of `crossing`, with obstacles."""

        num_obstacles: int = field(default=10, metadata={"unit": "spheres"})

    many = type("Many", (crossing,), {"name": "many", "Config": ManyConfig})
    with contextlib.closing(bulletuav.Aviary(many, num_obstacles=0, **QUICK)) as aviary:
        assert aviary.task.config.num_obstacles == 0
    with pytest.raises(ValueError, match="num_obstacles is 20000: .* 10000"):
        bulletuav.Aviary(many, num_obstacles=20_000, **QUICK)
