"""Mistakes of people who write sensors, blocks, dynamics, policies and metrics are named.

Each entry of a table is a mistake and what its message must say.
"""

import math

import numpy as np
import pytest
from own_ingredients import GLOBAL, Drift, Perch, Still, Uwb, fly, wrong

import bulletuav
from bulletuav.analysis.metrics import find_metric
from bulletuav.dynamics import find_dynamics
from bulletuav.policies import find_policy
from bulletuav.sensors import Label, Sensor
from bulletuav.sensors.suite import find_sensor
from bulletuav.tasks import block, end, find_task, reward


def measuring(function, **attributes):
    return wrong(Uwb, measure=lambda self, moment: function(moment), **attributes)()


def sense(sensor):
    fly(sensors=(sensor,), observation=("velocity", "uwb"))


def test_what_is_right_passes():
    sense(Uwb())
    bulletuav.check_sensor(Uwb())
    bulletuav.check_dynamics(Drift)
    bulletuav.check_policy(Still)


HIGH = Label("high", "m", 0.0, 500.0)
GAVE = "measure of sensor 'uwb' returned"


class Nameless(Sensor):
    numbers = (HIGH,)

    def measure(self, moment):
        return {}


def heights(moment):
    return moment.after.position[..., 2]


@pytest.mark.parametrize(
    ("sensor", "message"),
    [
        (wrong(Uwb, numbers=())(), "sensor 'uwb' .* no labels .*`numbers`, one Label per number"),
        (
            measuring(lambda moment: {"uwb": np.zeros(3)}),
            rf"{GAVE} an array \(3,\) as 'uwb': \(2, 3\)",
        ),
        (
            wrong(Uwb, numbers=(HIGH, HIGH))(),
            rf"{GAVE} an array \(2, 3\) as 'uwb': \(2, 3, 2\) is nee",
        ),
        (measuring(lambda moment: {"uwb": heights(moment) * np.nan}), f"{GAVE} .*: finite numbers"),
        (measuring(lambda moment: {"uwb": 3.0}), f"{GAVE} 3.0 as 'uwb': a NumPy array is needed"),
        (measuring(heights), f"{GAVE} .*: a dict of arrays by name of reading is needed"),
        (5, "unknown sensor 5"),
        (Perch, "unknown sensor <class"),
        (measuring(lambda moment: {"uvb": heights(moment)}), f"{GAVE} no reading 'uwb'"),
        (Nameless(), "sensor Nameless has no name"),
        (wrong(Uwb, numbers=HIGH)(), "labels? of sensor 'uwb'|'uwb'.* Label"),
        (wrong(Uwb, numbers=(Label("high", "m", 5.0, -5.0),))(), "bounds? of .*high"),
    ],
)
def test_sensors(sensor, message):
    with pytest.raises(ValueError, match=message):
        sense(sensor)


@pytest.mark.parametrize(
    ("sensor", "message"),
    [
        (
            measuring(lambda moment: {"uwb": GLOBAL.uniform(0.0, 9.0, moment.mask.shape)}),
            "sensor 'uwb' differs at decision 0 of two flights from the same seed",
        ),
        (
            measuring(lambda moment: {"uwb": heights(moment) + moment.after.position.mean()}),
            "sensor 'uwb' gives a world other results when it flies alone, at decision 0",
        ),
    ],
)
def test_what_only_the_check_of_sensors_sees(sensor, message):
    with pytest.raises(ValueError, match=message):
        bulletuav.check_sensor(sensor)


@block([HIGH, HIGH])
def one_of_two(distance):
    return distance


@block([HIGH])
def three_of_one(position):
    return position


@block([HIGH])
def without_an_axis_for_labels(frame):
    return frame.distance


@block([HIGH])
def misspelt(distanse):
    return distanse


@block([HIGH])
def of_all_not_a_number(frame):
    return np.full((*frame.alive.shape, 1), np.nan)


@block([HIGH])
def undefined(distance):
    return math.nan


@block(["high"])
def labelled_by_texts(distance):
    return distance


@block([])
def without_labels(distance):
    return distance


def undecorated(distance):
    return distance


def of(name):
    return f"observation block '{name}'.* gave"


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (one_of_two, f"{of('one_of_two')} .*: 2 numbers of one drone are needed"),
        (three_of_one, f"{of('three_of_one')} .*: 1 number of one drone is needed"),
        (without_an_axis_for_labels, r"gave an array \(2, 3\) .* an array \(2, 3, 1\) of numbers"),
        (misspelt, "'misspelt' of task 'perch' asks for 'distanse', .*did you mean 'distance'"),
        (labelled_by_texts, r"labels of .* are \('high',\): a list of Label\(name, unit"),
        (undecorated, "a Block is needed; decorate a per-drone function with @block"),
        ("no_such_module:it", "observation no_such_module:it cannot be imported"),
        (without_labels, "labels of .*'without_labels'"),
        (of_all_not_a_number, f"{of('of_all_not_a_number')}.*finite"),
        (undefined, f"{of('undefined')}.*finite"),
    ],
)
def test_blocks(function, message):
    with pytest.raises(ValueError, match=message):
        fly(observation=(function,))


@pytest.mark.parametrize("function", [of_all_not_a_number, undefined])
def test_what_only_the_check_of_tasks_sees_of_blocks(function):
    with pytest.raises(ValueError, match="nan.*finite numbers|high' is NaN"):
        bulletuav.check_task(Perch, observation=("velocity", function))


@pytest.mark.parametrize(
    "decorate",
    [
        reward,
        end,
        block([HIGH]),
    ],
)
def test_decorators_are_for_functions(decorate):
    with pytest.raises(TypeError, match="is for functions, and 5 is none"):
        decorate(5)


def test_block_without_its_labels():
    def bare(distance):
        return distance

    with pytest.raises((TypeError, ValueError), match="bare"):
        fly(observation=(block(bare),))


def flying(function):
    def advance_substep(self, swarm, alive, setpoint, air):
        function(swarm)

    return wrong(Drift, advance_substep=advance_substep)


def drifts_by_chance(swarm):
    swarm.position[:] += GLOBAL.uniform(0.0, 0.01)


def drifts_with_all_worlds(swarm):
    swarm.position[:] += 0.001 * np.tanh(swarm.position.mean())


def loses_drones(swarm):
    swarm.position[:] = np.nan


@pytest.mark.parametrize(
    ("dynamics", "error", "message"),
    [
        (flying(loses_drones), RuntimeError, "'Drift' gave drone 0 in world 0 a position that is"),
        (flying(drifts_by_chance), ValueError, "dynamics 'Drift' differs at decision 1 of two fli"),
        (flying(drifts_with_all_worlds), ValueError, "'Drift' gives a world other results when it"),
        (5, ValueError, "unknown dynamics 5: choose from bullet"),
    ],
)
def test_dynamics(dynamics, error, message):
    with pytest.raises(error, match=message):
        bulletuav.check_dynamics(dynamics)


def acting(function):
    return wrong(Still, act=lambda self, observations, swarm: function(swarm.position))


def pushes_drones(position):
    position[:] += 1.0
    return np.zeros(position.shape)


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        (
            acting(lambda position: position[0]),
            r"'still' returned an array \(8, 3\): an array \(3, 8, 3\)",
        ),
        (
            acting(lambda position: position * np.nan),
            "'still' returned .*: finite numbers are needed",
        ),
        (acting(lambda position: None), "act of policy 'still' returned None: an array"),
        (acting(lambda position: GLOBAL.uniform(-1, 1, position.shape)), "acts differently at dec"),
        (
            acting(pushes_drones),
            "policy 'still' modifies the swarm state in place: work on a copy",
        ),
        (5, "policy is 5: a name, module:Name, a run's folder"),
    ],
)
def test_policies(policy, message):
    with pytest.raises(ValueError, match=message):
        bulletuav.check_policy(policy)


def of_no_world(step, aviary):
    return 3.0


def of_each_drone(step, aviary):
    return np.zeros(aviary.alive.shape)


def jerk(step, aviary):
    return np.zeros(aviary.num_worlds)


@pytest.mark.parametrize(
    ("metric", "message"),
    [
        (
            of_no_world,
            r"metric 'of_no_world' returned 3.0: an array \(\d+,\) of numbers, one for each w",
        ),
        (
            of_each_drone,
            r"metric 'of_each_drone' returned an array \(\d+, 3\) .*, one for each world",
        ),
        (jerk, "metric 'jerk' is a standard metric already: choose another name"),
        (5, "unknown metric 5: choose from"),
    ],
)
def test_metrics(metric, message):
    with pytest.raises(ValueError, match=message):
        bulletuav.evaluate(Perch, Still, 2, metrics=(metric,))


FINDERS = {
    "sensor": (find_sensor, "gpz", "gps"),
    "metric": (find_metric, "jerkk", "jerk"),
    "dynamics": (find_dynamics, "bulet", "bullet"),
    "policy": (find_policy, "stright", "straight"),
    "task": (find_task, "crosing", "crossing"),
}


@pytest.mark.parametrize("kind", FINDERS)
def test_names_that_there_are_not(kind):
    find, misspelt, right = FINDERS[kind]
    with pytest.raises(ValueError, match=f"unknown {kind} '{misspelt}': did you mean '{right}'"):
        find(misspelt)
    with pytest.raises(ValueError, match=f"{kind} nowhere:It cannot be imported: No module named"):
        find("nowhere:It")
    with pytest.raises(ValueError, match=f"{kind} own_ingredients:Perc is not there: did you mean"):
        find("own_ingredients:Perc")
    with pytest.raises(ValueError, match=f"{kind} own_ingredients:DRONES is 3: that is no {kind}"):
        find("own_ingredients:DRONES")
