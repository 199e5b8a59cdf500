"""Mistakes of people who write tasks are named; those of others in test_author_mistakes_elsewhere.

Each entry of a table is a mistake and what its message must say.
"""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from own_ingredients import DRONES, GLOBAL, Perch, Uwb, fly, near, wrong

import bulletuav
from bulletuav import registry
from bulletuav.tasks import Task, TaskConfig, end, find_task, reward


def with_term(function):
    return wrong(Perch, reward={"near": (function, 1.0)})


def starting(**changes):
    return wrong(Perch, spawn=lambda self, rng: Perch.spawn(self, rng)._replace(**changes))


def remembering(function):
    return wrong(Perch, update_memory=lambda self, frame, rngs: function(frame.scene.memory))


def telling(name, value):
    return wrong(Perch, info=lambda self, frame: {name: value(frame)})


def test_a_task_that_is_right_passes():
    bulletuav.check_task(Perch)
    fly(reward={"far": (near, -1.0)})


def of_one_world(frame):
    return frame.distance[0]


@reward
def two_numbers(distance):
    return distance, distance


@reward
def nothing(distance):
    pass


@reward
def misspelt(distanse):
    return distanse


@reward
def infinite(distance):
    return 1.0 / (distance - distance)


@reward
def root_of_less_than_nothing(distance):
    return math.sqrt(-distance)


def of_all_not_a_number(frame):
    return np.full(frame.alive.shape, np.nan)


def twice(number):
    return 2 * number


@reward
def calls_plain_python(distance):
    return twice(distance)


@reward
def uses_a_set(distance):
    return float(len({distance, "far"}))


@reward
def parses_text(distance):
    return float(str(distance))


NEAR = "reward term 'near' of task 'perch'"


@pytest.mark.parametrize(
    ("term", "message"),
    [
        (of_one_world, rf"{NEAR} gave an array \(3,\) of float64: an array \(2, 3\) of numbers"),
        (two_numbers, rf"{NEAR} gave \(.*\): 1 number of one drone is needed"),
        (misspelt, r"'near' of task 'perch' asks for 'distanse', .* did you mean 'distance'"),
        (infinite, r"reward of drone 0 in world 0 is inf: .* task 'perch' gave {'near': inf}"),
        (of_all_not_a_number, r"reward of drone 0 in world 0 is nan: .* gave {'near': nan}"),
        (root_of_less_than_nothing, f"{NEAR} failed: ValueError: .*"),
        (uses_a_set, f"{NEAR} cannot be compiled: .*write it with plain numbers"),
        (nothing, f"{NEAR} gave None: 1 number of one drone"),
        (calls_plain_python, f"{NEAR} cannot be compiled: .*twice"),
        (parses_text, f"{NEAR} cannot be compiled"),
        (5, "reward term 'near' is 5|unknown reward 5"),
        ("nearr", "unknown reward 'nearr'"),
        ("no_such_module:near", "no_such_module:near cannot be imported: No module named"),
        ("no_such_module:near", "reward no_such_module:near cannot be imported"),
    ],
)
def test_reward_terms(term, message):
    with pytest.raises(ValueError, match=message):
        fly(with_term(term))


@dataclass(frozen=True)
class Bare:
    height: float = 1.0


class Undecorated(TaskConfig):
    height: float = 1.0


@end
def half_done(distance):
    return 0.5


EASY = {"easy": {}}
LACKS = "every task needs it, see bulletuav.tasks.base.Task"


@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        ({"name": None}, f"task Perch has no name: {LACKS}"),
        ({"observation": ()}, f"task Perch has no observation: {LACKS}"),
        ({"reward": None}, f"task Perch has no reward: {LACKS}"),
        ({"spawn": Task.spawn}, f"task Perch has no spawn: {LACKS}"),
        ({"Config": Bare}, "Config of task Perch has no field d_safe: derive it from .*TaskConfig"),
        ({"reward": {"near": near}}, r"has 'near': <function near.*>; a weight, or \(term, weight"),
        (
            {"reward": {"near": (near,)}},
            r"has 'near': .*; a weight, or \(term, weight\), is needed",
        ),
        ({"reward": {"nearr": 1.0}}, "unknown reward 'nearr'"),
        ({"reward": {"distanse": 1.0}}, "unknown reward 'distanse': did you mean 'distance'"),
        ({"reward": [near]}, "reward of task Perch is .*: a dict is needed"),
        ({"training_weights": [1.0]}, "training_weights of task Perch is .*: a dict is needed"),
        ({"training_weights": {"nearr": 1.0}}, "training_weights of task Perch: .*mean 'near'"),
        ({"training_weights": {"near": math.inf}}, "of task Perch: weight of 'near' is inf"),
        ({"observation": ("velocityy",)}, "block 'velocityy': did you mean 'velocity'"),
        ({"difficulties": {}}, "difficulties of task Perch are empty: leave them out, or name one"),
        ({"difficulties": EASY | {"hard": {"num_drnes": 4}}}, "'num_drnes': did you mean"),
        ({"difficulties": EASY | {"hard": {"num_drones": 0}}}, "num_drones is 0: a whole number"),
        ({"defaults": {"num_dornes": 4}}, "task 'perch': 'num_dornes': did you mean 'num_drones'"),
        ({"ends": ("collision",)}, "ends of task Perch are .*'collision'.*: a tuple of functions"),
        ({"ends": near}, "ends of task .*: a tuple"),
        ({"ends": (half_done,)}, "end 'half_done'.*bool"),
        ({"observation": "velocity"}, "observation of task .*: a tuple"),
        ({"difficulties": EASY | {"hard": 3}}, "difficult.* of task Perch .*: a dict"),
        ({"Config": Undecorated}, "Config of task Perch .*dataclass"),
    ],
)
def test_parts_of_a_task(attributes, message):
    with pytest.raises(ValueError, match=message):
        bulletuav.check_task(wrong(Perch, **attributes))


def test_a_task_of_which_parts_were_forgotten_altogether():
    class Empty(Task[TaskConfig]): ...

    with pytest.raises(ValueError, match="task Empty has no spawn"):
        fly(Empty)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"difficulty": "hard"}, "unknown difficulty 'hard': choose from easy"),
        ({"preset": "mine"}, "preset is 'mine': task 'perch' has none"),
        ({"weights": {"nearr": 1.0}}, "weights: unknown reward term 'nearr': did you mean 'near'"),
        ({"weights": {"near": math.nan}}, "weight of reward term 'near' is nan: a finite number"),
        ({"reward": {"far": near}}, r"reward has 'far': .*; \(term, weight\) is needed"),
        ({"reward": {"far": ("distanse", 1.0)}}, "unknown reward 'distanse': did you mean"),
        ({"observation": ("velocity", "uwb")}, "unknown observation block 'uwb'"),
        ({"sensors": (Uwb(), Uwb())}, "sensors has 'uwb' twice: unique names are needed"),
        (
            {"sensors": (Uwb(),), "randomization": {"uwb_noize": 0.1}},
            "unknown randomization 'uwb_noize': did you mean 'uwb_noise'",
        ),
        (
            {"sensors": (Uwb(),), "randomization": {"uwb_noise": 2.0}},
            "randomization uwb_noise is 2.0: from low to high within 0 and 1 is needed",
        ),
        ({"reward": {"near": (of_one_world, -1.0)}}, "reward has 'near'.*task 'perch'.*weights"),
    ],
)
def test_options(options, message):
    with pytest.raises(ValueError, match=message):
        bulletuav.Aviary(Perch, **options).close()


@dataclass(frozen=True)
class Postponed(TaskConfig):
    """As every config is below `from __future__ import annotations`."""

    height: "float" = 1.0


@pytest.mark.parametrize("height", [-1.0, "high"])
def test_values_of_a_config_whose_annotations_are_postponed(height):
    with pytest.raises(
        ValueError, match=f"height is '?{height if isinstance(height, str) else -1}"
    ):
        bulletuav.Aviary(wrong(Perch, Config=Postponed), height=height).close()


@pytest.mark.parametrize(
    ("task", "message"),
    [
        (starting(position=np.full((DRONES, 3), np.nan)), "position of the .*: finite numbers are"),
        (starting(goal=np.full(3, np.inf)), "goal of the spawn of task 'perch' .*: finite numbers"),
        (
            starting(position=np.zeros(3)),
            r"position of the .* has shape \(3,\): \(3, 3\) is needed",
        ),
        (starting(position=np.full((DRONES, 3), 9.0)), "start positions of drones 0 and 1 overlap"),
        (starting(memory={"idel": np.zeros(2)}), "memory in the spawn .*did you mean 'idle'"),
        (starting(memory={"idle": np.zeros(3)}), r"has shape \(3,\): \(2,\) is needed"),
        (wrong(Perch, spawn=lambda self, rng: (0, 1)), r"gave \(0, 1\): a Spawn is needed"),
    ],
)
def test_starts(task, message):
    with pytest.raises(ValueError, match=message):
        fly(task)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (
            lambda memory: memory["idel"].fill(1),
            KeyError,
            "unknown memory 'idel': did you mean 'id",
        ),
        (
            lambda memory: memory.__setitem__("idle", np.zeros((2, 2))),
            ValueError,
            r"memory 'idle' cannot be replaced: write into it, memory\['idle'\]\[:\] = ",
        ),
        (
            lambda memory: memory.__setitem__("idel", np.zeros((2, 2))),
            ValueError,
            "unknown memory 'idel': did you mean 'idle'",
        ),
        (
            lambda memory: memory.update(idle=np.zeros(3)),
            AttributeError,
            "has no attribute 'update'",
        ),
    ],
)
def test_memory(change, error, message):
    with pytest.raises(error, match=message):
        fly(remembering(change))


@pytest.mark.parametrize(
    ("task", "message"),
    [
        (telling("idle", lambda frame: 3.0), r"gave 3.0 as 'idle': an array \(2, 3\) \(worlds, dr"),
        (
            telling("idle", lambda frame: np.zeros(2)),
            r"gave an array \(2,\) as 'idle': an array \(2",
        ),
        (wrong(Perch, info=lambda self, frame: None), "info of task 'perch' gave None: a dict of"),
        (telling("success", lambda frame: frame.distance), "info of task 'perch'.*'success'"),
    ],
)
def test_infos(task, message):
    with pytest.raises(ValueError, match=message):
        fly(task)


def counts_in_evaluate_step(self, frame):
    frame.scene.memory["idle"][:] += 1
    return Perch.evaluate_step(self, frame)


def moves_drones_in_evaluate_step(self, frame):
    frame.after.position[:] += 1
    return Perch.evaluate_step(self, frame)


def draws_from_its_own_generator(self, rng):
    return Perch.spawn(self, GLOBAL)


def draws_from_numpy(self, rng):
    goal = np.random.uniform(0.0, 9.0, 3)  # noqa: NPY002  # the mistake
    return Perch.spawn(self, rng)._replace(goal=goal)


def counts_in_the_task(self, rng):
    self.count = getattr(self, "count", 0) + 1
    return Perch.spawn(self, rng)._replace(goal=np.array((0.0, 0.0, 10.0 + self.count)))


def draws_once_for_all_worlds(self, scene, time, flying, rngs):
    scene.goal[flying] += rngs[0].uniform(-1.0, 1.0)
    return False


@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        ({"evaluate_step": counts_in_evaluate_step}, "changes the swarm, the scene or its memory"),
        ({"evaluate_step": moves_drones_in_evaluate_step}, "changes the swarm, the scene or its"),
        ({"spawn": draws_from_its_own_generator}, "differs at decision 0 of two flights from the"),
        ({"spawn": draws_from_numpy}, "differs at decision 0 of two flights from the same seed"),
        ({"spawn": counts_in_the_task}, "when it flies alone, at decision 0: worlds must be"),
        (
            {"move_scene": draws_once_for_all_worlds},
            "when it flies alone, at decision 1: worlds mus",
        ),
        ({"info": lambda self, frame: {"idle": np.full((3, 3), np.nan)}}, "info 'idle' .* is NaN"),
    ],
)
def test_what_only_the_check_of_tasks_sees(attributes, message):
    with pytest.raises(ValueError, match=f"'perch'.*{message}|{message}"):
        bulletuav.check_task(wrong(Perch, **attributes))


@pytest.mark.parametrize("task", bulletuav.list_tasks())
def test_a_registered_term_flies_in_a_task_or_is_refused_when_it_is_made(task):
    refused = []
    dynamics = "rigid_body" if find_task(task).needs_cables else "single_integrator"
    for name in registry.names("reward"):
        own = {"reward": {"own": (name, 0.5)}}
        try:
            aviary = bulletuav.Aviary(task, dynamics=dynamics, action="velocity", **own)
        except ValueError as error:
            refused.append(str(error))
            continue
        aviary.reset()
        rewards = aviary.step(np.zeros((1, aviary.num_drones, 3))).rewards
        assert np.isfinite(rewards).all()
        aviary.close()
    assert all("reward term 'own' of task" in one for one in refused)
    assert 0 < len(refused) < len(registry.names("reward"))
