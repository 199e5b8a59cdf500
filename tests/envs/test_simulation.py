"""A simulation is its state and its stages: what these declare is true."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

import bulletuav
from bulletuav.envs.stages import Stage, decision_stages
from bulletuav.envs.state import ARRAYS, LAST, STATE, Sizes

sys.path.append(str(Path(__file__).parents[2] / "tools"))
import stages

CASES = {
    "crossing": {"dynamics": "rigid_body", "randomization": {"gps_noise": 1.0}},
    "obstacles": {"dynamics": "point_mass", "num_moving": 2, "turbulence": "light"},
    "mec": {"dynamics": "double_integrator"},
    "race": {"dynamics": "rigid_body"},
    "lidar_navigation": {"dynamics": "bullet", "battery_capacity": 1.0},
    "hover": {"action": "discrete_27", "dynamics": "point_mass"},
}


def made(task):
    aviary = bulletuav.Aviary(task, 2, **CASES[task])
    aviary.reset(seeds=3)
    return aviary


def act(aviary, rng):
    low, high = aviary.action.low, aviary.action.high
    drawn = rng.uniform(low, high, aviary.given.shape)
    aviary.given[:] = drawn if aviary.action.choices is None else np.rint(drawn)


def is_declared(name, declared):
    """Whether an array is declared, or all of its group is, such as "swarm"."""
    return name in declared or name.partition(".")[0] in declared


@pytest.mark.parametrize("task", CASES)
def test_stage_by_stage_is_the_same_as_all_at_once(task):
    one, other = made(task), made(task)
    rngs = np.random.default_rng(1), np.random.default_rng(1)
    for _ in range(4):
        act(one, rngs[0])
        act(other, rngs[1])
        one.decide()
        times = other.simulation.decide_by_stages()
        assert one.observations().tobytes() == other.observations().tobytes()
        np.testing.assert_array_equal(one.rewards, other.rewards)
    assert one.state_hash() == other.state_hash()
    assert list(times) == [stage.name for stage in one.simulation.stages]


@pytest.mark.parametrize("task", CASES)
def test_stages_write_what_they_declare(task):
    aviary, rng = made(task), np.random.default_rng(2)
    worlds, written = aviary.worlds, set()
    for _ in range(6):
        act(aviary, rng)
        aviary.decide()
    programs = aviary.simulation.stage_programs()
    worlds.contacts.start_decision()
    worlds.forget_derived()
    act(aviary, rng)
    for stage in aviary.simulation.stages:
        before = {name: array.copy() for name, array in worlds.state.named().items()}
        programs[stage.name].run()
        changed = {
            name
            for name, array in worlds.state.named().items()
            if array.tobytes() != before[name].tobytes()
        }
        undeclared = [name for name in changed if not is_declared(name, stage.writes)]
        assert not undeclared, stage.name
        written |= changed
    assert {"action", "time", "swarm.position", "before.position", "rewards"} <= written


@pytest.mark.parametrize("task", CASES)
def test_stages_are_given_what_they_declare(task):
    """Each array of the state that a compiled call gets is read or written, as declared."""
    aviary = made(task)
    worlds = aviary.worlds
    spans = {
        name: (array.ctypes.data, array.ctypes.data + array.nbytes)
        for name, array in worlds.state.named().items()
    }

    programs = aviary.simulation.stage_programs()

    def arrays_in(value):
        if isinstance(value, np.ndarray):
            yield value
        elif isinstance(value, tuple):
            for part in value:
                yield from arrays_in(part)

    for stage in aviary.simulation.stages:
        given = {
            name
            for _, arguments, _ in programs[stage.name].calls
            for array in arrays_in(arguments)
            for name, (low, high) in spans.items()
            if array.size and low <= array.ctypes.data < high
        }
        declared = (*stage.reads, *stage.writes)
        assert not [name for name in given if not is_declared(name, declared)], stage.name


def test_every_stage_declares_what_there_is():
    aviary = made("crossing")
    parts = {"dynamics", "energy", "readings", "account", "results", "observations"}
    parts |= {"engine", "rng"}
    names = {name for one in aviary.worlds.state.named() for name in (one, one.partition(".")[0])}
    every = decision_stages()
    assert len({stage.name for stage in every}) == len(every)
    for stage in every:
        assert {*stage.reads, *stage.writes} <= names | parts, stage.name
        assert stage.summary.endswith(".")
        assert type(stage).__module__ != Stage.__module__


def test_a_simulation_is_printed_as_its_stages():
    aviary = made("crossing")
    lines = repr(aviary.simulation).splitlines()
    assert lines[0] == "crossing in rigid_body: 2 worlds of 8 drones"
    assert len(lines) == 2 + len(aviary.simulation.stages)
    reads, writes = "given, alive, steps", "action, flown, flying, time"
    summary = "Refuse actions that are not finite, clip the others, and start the decision."
    assert " ".join(lines[2].split()) == f"admit {reads} {writes} {summary}"


class Log(Stage):
    """Note how high drones are."""

    name, reads, writes = "log", ("swarm.position",), ()

    def __init__(self):
        self.heights = []

    def add_to(self, program, worlds):
        position = worlds.state.swarm.position
        program.turn(lambda: self.heights.append(position[0, 0, 2]))


def test_a_stage_of_ones_own_takes_its_turn():
    aviary, log = made("crossing"), Log()
    act(aviary, np.random.default_rng(0))
    aviary.decide()
    aviary.simulation.insert(log, after="fly")
    aviary.simulation.insert(type("Second", (Log,), {"name": "second"})(), after="fly")
    for _ in range(2):
        aviary.decide()
    assert len(log.heights) == 2
    assert log.heights[1] == aviary.swarm.position[0, 0, 2]
    names = [stage.name for stage in aviary.simulation.stages]
    assert names[names.index("fly") :][:3] == ["fly", "second", "log"]


def test_stages_that_cannot_be_are_refused():
    simulation = made("crossing").simulation
    with pytest.raises(ValueError, match="after is 'flight': one of admit, wind"):
        simulation.insert(Log(), after="flight")
    simulation.insert(Log(), after="fly")
    with pytest.raises(ValueError, match="stage 'log' is there already"):
        simulation.insert(Log(), after="fly")


def test_a_profile_has_each_stage():
    aviary = bulletuav.Aviary("hover", 2, horizon=3, action="discrete_27", dynamics="point_mass")
    with pytest.raises(RuntimeError, match="call reset"):
        aviary.profile()
    aviary.reset(seeds=0)
    profile = aviary.profile(decisions=8)
    assert list(profile) == [stage.name for stage in aviary.simulation.stages]
    assert min(profile.values()) > 0.0
    assert aviary.alive.any()
    with pytest.raises(ValueError, match="decisions is 0"):
        aviary.profile(decisions=0)


def test_the_state_is_declared_once():
    aviary = made("crossing")
    state, sizes = aviary.worlds.state, Sizes(2, 8, 3, aviary.worlds.state.setpoint.shape[-1])
    for name, one in ARRAYS.items():
        array = getattr(state, name)
        assert (array.shape, array.dtype) == (one.shape(sizes), np.dtype(one.dtype))
    kept = {one.kept for one in ARRAYS.values()}
    assert kept == {STATE, LAST, "derived"}
    # What snapshots hold is what is declared to be kept
    saved = {**aviary.worlds.state_arrays(), **aviary.worlds.last_arrays()}
    assert all(saved[name] is array for name, array in state.kept(STATE).items())
    assert all(saved[name] is array for name, array in state.kept(LAST).items())


def test_the_page_shows_the_stages():
    page = stages.PAGE.read_text()
    assert stages.updated(page) == page


def test_the_stage_of_the_documentation(capsys):
    page = Path(__file__).parents[2].joinpath("CONTRIBUTING.md").read_text()
    (code,) = re.findall(
        r"```python\n(import bulletuav\nfrom bulletuav.envs.stages.*?)```", page, re.DOTALL
    )
    space = {}
    exec(code, space)
    env = space["env"]
    env.reset(seed=0)
    env.step({agent: np.zeros(3) for agent in env.agents})
    assert capsys.readouterr().out == f"{env.aviary.swarm.rotor_speed[0, 0]}\n"
