"""A simulation is its state and its stages: what these declare is true."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

import bulletuav
from bulletuav import Airspace, SetpointLevel
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.stages import Stage, airspace_stages, decision_stages
from bulletuav.envs.state import LAST, STATE, AirspaceState, Sizes, State
from bulletuav.geometry.obstacle import Obstacle

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


AIRSPACES = {
    "bullet": {"sensors": ("imu",), "dynamics": "bullet"},
    "rigid_body": {"wind": (1.0, 0.5, 0.0), "turbulence": "light", "sensors": ("imu", "gps")},
    "point_mass": {"dynamics": "point_mass"},
}


def airspace_of(case):
    """An airspace in which all that can change does: obstacles, yaws, forces, readings."""
    options = {"dynamics": "rigid_body", "decision_hz": 24, "seed": 3, **AIRSPACES[case]}
    places = [(0.0, 0.0, 1.0), (2.0, 0.0, 1.0)]
    airspace = Airspace(places, obstacles=(Obstacle("sphere", (0.2,)),), **options)
    airspace.place_obstacle(0, (5.0, 0.0, 1.0), velocity=(-0.5, 0.0, 0.0))
    airspace.command(None, SetpointLevel.VELOCITY, (0.5, 0.0, 0.2), yaw_rate=0.7)
    if airspace.consumes == SetpointLevel.ROTOR:
        airspace.apply(0, force=(0.1, 0.0, 0.0))
    return airspace


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


def changed_by(stages, programs, state):
    """Names of arrays that a run of stages changes; each by a stage that declares so."""
    written = set()
    for stage in stages:
        before = {name: array.copy() for name, array in state.named().items()}
        programs[stage.name].run()
        changed = {
            name
            for name, array in state.named().items()
            if array.tobytes() != before[name].tobytes()
        }
        assert not [name for name in changed if not is_declared(name, stage.writes)], stage.name
        written |= changed
    return written


def arrays_in(value):
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, tuple):
        for part in value:
            yield from arrays_in(part)


def require_declared(stages, programs, state):
    """Each array of the state that a compiled call gets is read or written, as declared."""
    spans = {
        name: (array.ctypes.data, array.ctypes.data + array.nbytes)
        for name, array in state.named().items()
    }
    for stage in stages:
        given = {
            name
            for _, arguments, _ in programs[stage.name].calls
            for array in arrays_in(arguments)
            for name, (low, high) in spans.items()
            if array.size and low <= array.ctypes.data < high
        }
        declared = (*stage.reads, *stage.writes)
        assert not [name for name in given if not is_declared(name, declared)], stage.name


@pytest.mark.parametrize("task", CASES)
def test_stages_write_what_they_declare(task):
    aviary, rng = made(task), np.random.default_rng(2)
    worlds = aviary.worlds
    for _ in range(6):
        act(aviary, rng)
        aviary.decide()
    programs = aviary.simulation.stage_programs()
    worlds.contacts.start_decision()
    worlds.forget_derived()
    act(aviary, rng)
    written = changed_by(aviary.simulation.stages, programs, worlds.state)
    assert {"action", "time", "swarm.position", "before.position", "rewards"} <= written


@pytest.mark.parametrize("task", CASES)
def test_stages_are_given_what_they_declare(task):
    aviary = made(task)
    simulation = aviary.simulation
    require_declared(simulation.stages, simulation.stage_programs(), aviary.worlds.state)


@pytest.mark.parametrize("case", AIRSPACES)
def test_stages_of_an_airspace_write_and_are_given_what_they_declare(case):
    airspace = airspace_of(case)
    simulation, state = airspace.simulation, airspace.world.state
    programs = simulation.stage_programs()
    require_declared(simulation.stages, programs, state)
    written = changed_by(simulation.stages, programs, state)
    assert {"swarm.position", "setpoint", "obstacle", "steps", "time"} <= written
    assert ("before.position" in written) == bool(airspace.readings)


@pytest.mark.parametrize("case", AIRSPACES)
def test_steps_of_an_airspace_are_the_same_stage_by_stage(case):
    one, other = airspace_of(case), airspace_of(case)
    for _ in range(3):
        one.step()
        for program in other.simulation.stage_programs().values():
            program.run()
        assert one.state_hash() == other.state_hash()
    assert one.readings.keys() == other.readings.keys()
    for name, array in one.readings.items():
        np.testing.assert_array_equal(other.readings[name], array)


@pytest.mark.parametrize("case", AIRSPACES)
def test_a_debugged_airspace_flies_the_same_bits(case, monkeypatch):
    monkeypatch.setitem(AIRSPACES, "debugged", {**AIRSPACES[case], "debug": True})
    one, other = airspace_of(case), airspace_of("debugged")
    for _ in range(3):
        one.step()
        other.step()
    assert one.state_hash() == other.state_hash()


@pytest.mark.parametrize("every", [decision_stages, airspace_stages])
def test_every_stage_declares_what_there_is(every):
    of_decision = every is decision_stages
    state = made("crossing").worlds.state if of_decision else airspace_of("rigid_body").world.state
    parts = {"dynamics", "engine", "readings", "rng"}
    parts |= {"energy", "account", "results", "observations"} if of_decision else set()
    names = {name for one in state.named() for name in (one, one.partition(".")[0])}
    stages = every()
    assert len({stage.name for stage in stages}) == len(stages)
    for stage in stages:
        assert {*stage.reads, *stage.writes} <= names | parts, stage.name
        assert stage.summary.endswith(".")
        assert type(stage).__module__ != Stage.__module__


def test_a_simulation_is_printed_as_its_stages():
    aviary = made("crossing")
    lines = repr(aviary.simulation).splitlines()
    assert lines[0] == "crossing in rigid_body: 2 worlds of 8 drones"
    assert len(lines) == 2 + len(aviary.simulation.stages)
    reads, writes = "given, alive, steps", "action, flown, flying, time"
    summary = "Check that actions are finite, clip them, and start the decision."
    assert " ".join(lines[2].split()) == f"admit {reads} {writes} {summary}"


def test_an_airspace_is_printed_as_its_stages():
    lines = repr(airspace_of("point_mass").simulation).splitlines()
    assert lines[0] == "airspace in point_mass: 2 drones"
    names = [" ".join(line.split("  ")[0].split()) for line in lines[2:]]
    assert names == ["wind", "move and turn", "fly", "count", "sense", "show"]
    assert lines[5].endswith("Count the step, and clear the forces that were applied in it.")


class Log(Stage):
    """Note how high drones are."""

    name, reads, writes = "log", ("swarm.position",), ()

    def __init__(self):
        self.heights = []

    def add_to(self, program, worlds):
        position = worlds.state.swarm.position
        program.callback(lambda: self.heights.append(position[0, 0, 2]))


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


def test_a_stage_is_inserted_before_another():
    aviary, log = made("crossing"), Log()
    aviary.simulation.insert(log, before="admit")
    aviary.simulation.insert(type("Last", (Log,), {"name": "last"})(), before="fly")
    names = [stage.name for stage in aviary.simulation.stages]
    assert names[:2] == ["log", "admit"]
    assert names[names.index("last") + 1] == "fly"
    height = aviary.swarm.position[0, 0, 2]
    act(aviary, np.random.default_rng(0))
    aviary.decide()
    assert log.heights == [height]


def test_a_stage_of_ones_own_takes_its_turn_in_an_airspace():
    airspace, log, early = airspace_of("point_mass"), Log(), Log()
    airspace.step()
    early.name = "early"
    airspace.simulation.insert(log, after="fly")
    airspace.simulation.insert(early, before="fly")
    height = airspace.swarm.position[0, 2]
    airspace.step()
    assert early.heights == [height]
    assert log.heights == [airspace.swarm.position[0, 2]]
    with pytest.raises(ValueError, match="before is 'admit': one of wind, move and turn, early"):
        airspace.simulation.insert(type("Third", (Log,), {"name": "third"})(), before="admit")


def test_stages_that_cannot_be_are_refused():
    simulation = made("crossing").simulation
    stages = simulation.stages
    with pytest.raises(ValueError, match="after is 'flight': one of admit, respawn, wind"):
        simulation.insert(Log(), after="flight")
    with pytest.raises(ValueError, match="before is 'flight': one of admit, respawn, wind"):
        simulation.insert(Log(), before="flight")
    with pytest.raises(ValueError, match="after is None and before is None: exactly one of them"):
        simulation.insert(Log())
    with pytest.raises(ValueError, match="after is 'fly' and before is 'wind': exactly one"):
        simulation.insert(Log(), after="fly", before="wind")
    wrong = type("Wrong", (Log,), {"writes": ("swarm.rotr_speed",)})()
    with pytest.raises(ValueError, match=r"array of stage 'log' 'swarm.rotr_speed': did you mean"):
        simulation.insert(wrong, after="fly")
    assert simulation.stages == stages
    simulation.insert(Log(), after="fly")
    with pytest.raises(ValueError, match="stage 'log' exists already"):
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


def require_as_declared(state, sizes, saved, last):
    """Check arrays against their declaration, and what snapshots hold of them."""
    for name, one in state.declared().items():
        array = getattr(state, name)
        assert (array.shape, array.dtype) == (one.shape(sizes), np.dtype(one.dtype))
    declared = state.declared().values()
    assert {one.kept for one in declared} == {STATE, "derived"} | ({LAST} if last else set())
    assert state.world_bytes() * sizes.W == sum(one.nbytes for one in state.named().values())
    # What snapshots hold is what is declared to be kept
    for kind in (STATE, LAST):
        assert all(saved[name] is array for name, array in state.kept(kind).items())


def test_the_state_is_declared_once():
    worlds = made("crossing").worlds
    assert isinstance(worlds.state, State)
    sizes = Sizes(2, 8, 3, worlds.state.setpoint.shape[-1])
    saved = {**worlds.state_arrays(), **worlds.last_arrays()}
    require_as_declared(worlds.state, sizes, saved, last=True)
    assert worlds.bounds()["steps"] == (0, 2**53)


@pytest.mark.parametrize("task", CASES)
def test_the_memory_that_worlds_take_follows_from_the_state(task):
    spec = EnvSpec(task, 5, CASES[task])
    named = made(task).worlds.state.named()
    assert spec.state_bytes() == sum(one.nbytes for one in named.values()) // 2


def test_memory_is_counted_before_it_is_allocated(monkeypatch):
    taken = EnvSpec("crossing", 1, {}).state_bytes()
    grown = {"given": State.declared()["given"]._replace(axes=f"W N A {10**12}")}
    declared = {**State.declared(), **grown}
    monkeypatch.setattr(State, "declared", classmethod(lambda cls: declared))
    with pytest.raises(ValueError, match="1 worlds of 8 drones .* need about"):
        EnvSpec("crossing", 1, {})
    assert taken < 10**5


def test_the_state_of_an_airspace_is_declared_once():
    world = airspace_of("rigid_body").world
    assert isinstance(world.state, AirspaceState)
    sizes = Sizes(1, 2, S=4, K=1)
    require_as_declared(world.state, sizes, world.state_arrays(), last=False)
    assert world.bounds()["steps"] == (0, 2**53)
    assert world.state_arrays().keys() >= {"told", "setpoint", "obstacle_turn"}


def test_the_page_shows_the_stages():
    assert stages.PAGE.read_text() == stages.written()


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
