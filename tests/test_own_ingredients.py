"""The examples of what users write: each runs as a program, is short, and is right."""

import ast
import functools
import importlib.util
import math
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from waiting import LONG

import bulletuav
from bulletuav.cli import main
from bulletuav.policies import find_policy
from bulletuav.tasks import TaskConfig
from bulletuav.tasks.ends import at_goal
from bulletuav.tasks.rewards.airspace import progress

FOLDER = Path(__file__).parents[1] / "examples" / "own"
EXAMPLES = sorted(path.stem for path in FOLDER.glob("*.py"))
NUMBER = r"(-?\d+(?:\.\d+)?)"


def code_lines(text):
    """Lines of a source that are neither empty nor of a docstring."""
    dropped = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            dropped |= set(range(node.lineno, node.end_lineno + 1))
    lines = enumerate(text.splitlines(), start=1)
    return [line for number, line in lines if line.strip() and number not in dropped]


def class_lines(text, name):
    """Lines of one class, decorators included."""
    (node,) = [one for one in ast.parse(text).body if getattr(one, "name", None) == name]
    first = min([node.lineno, *(one.lineno for one in node.decorator_list)])
    return code_lines("\n".join(text.splitlines()[first - 1 : node.end_lineno]))


@functools.cache
def own(name):
    """An example as a module."""
    spec = importlib.util.spec_from_file_location(f"own_{name}", FOLDER / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def sizes():
    """Lines of code of each example, also printed, to be seen with `pytest -s`."""
    found = {name: len(code_lines((FOLDER / f"{name}.py").read_text())) for name in EXAMPLES}
    print("\nlines of code:", ", ".join(f"{name} {count}" for name, count in found.items()))
    return found


def numbers(pattern, text):
    """What stands where the pattern has `#`; at least one match."""
    found = re.findall(pattern.replace("#", NUMBER), text)
    assert found, f"{pattern!r} is not in {text!r}"
    return np.array(found, dtype=float)


def test_there_is_one_of_each_kind():
    kinds = {"task": "chain", "sensor": "uwb", "reward": "smoothness", "dynamics": "glide"}
    kinds |= {"metric": "wobble", "policy": "higher", "airframe": "heavy", "block": "barometer"}
    assert sorted(kinds.values()) == EXAMPLES


def test_they_are_short(sizes):
    text = (FOLDER / "uwb.py").read_text()
    sensor = len(class_lines(text, "Uwb"))
    assert sizes["chain"] <= 55, sizes
    assert sensor <= 30, sizes
    assert len(class_lines((FOLDER / "glide.py").read_text(), "Glide")) <= 20, sizes
    assert max(sizes.values()) <= 60, sizes


def check_barometer(told):
    known, true = numbers("after #? ?s?.*: # m by pressure, # m above", told)[:, -2:].T
    np.testing.assert_allclose(known, true, atol=5.0)
    assert (known != true).all()


def check_chain(told):
    assert numbers("drone_success #", told) == 1
    assert numbers("goal_distance #", told) < 1


def check_glide(told):
    assert len(numbers(r"wind # m/s: #%", told)) == 2


def check_heavy(told):
    assert numbers("heavy: # kg, # rotors, # times its weight", told).tolist() == [[10, 6, 2.7]]
    (heavy, spent), (light, less) = numbers(r": # m from its goal after 8 s, for # J", told)
    assert max(heavy, light) < 0.1
    assert spent > 10 * less


def check_higher(told):
    (straight, success), (higher, more) = numbers("# conflicts, #% of the drones", told)
    assert straight > 1 > higher
    assert success < more == 100


def check_smoothness(told):
    one, other = numbers(": #", told)
    assert one == pytest.approx(other, abs=2e-6)
    assert one < -10


def check_uwb(told):
    distance = numbers("noise # m, dropout #: # m from", told)[:, 2]
    assert (np.diff(distance) > 0).all()
    assert distance[-1] < 3


def check_wobble(told):
    easy, hard = numbers("(?:easy|hard): # rad/s", told)
    assert 0 < easy < hard


CHECKS = {
    name.removeprefix("check_"): check
    for name, check in list(globals().items())
    if name.startswith("check_")
}


@pytest.mark.parametrize("name", EXAMPLES)
def test_each_runs_as_a_program(name, run_program, tmp_path):
    CHECKS[name](run_program(FOLDER / f"{name}.py"))
    assert list(tmp_path.iterdir()) == [], "writes files"


def test_one_runs_in_a_process_of_its_own(tmp_path):
    command = [sys.executable, str(FOLDER / "smoothness.py")]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=LONG)
    assert done.returncode == 0, done.stderr
    check_smoothness(done.stdout)
    assert list(tmp_path.iterdir()) == [], "writes files"


def commands():
    """Commands of the docstrings, by their example."""
    for name in EXAMPLES:
        text = ast.get_docstring(ast.parse((FOLDER / f"{name}.py").read_text())) or ""
        assert f"python examples/own/{name}.py" in text
        for command in re.findall(r"cd examples/own && (bulletuav .*)", text):
            yield pytest.param(command, id=name)


@pytest.mark.parametrize("command", list(commands()))
def test_commands_of_the_docstrings_run_in_their_folder(command, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(FOLDER)
    monkeypatch.setattr(sys, "path", [one for one in sys.path if one])
    for name in EXAMPLES:
        monkeypatch.delitem(sys.modules, name, raising=False)
    words = shlex.split(command)[1:]
    words = words[: words.index("--out")] if "--out" in words else words
    words += ["--animation", "none"] if words[0] == "fly" else ["--episodes", "2"]
    main([*words, "--out", str(tmp_path / "out")])
    assert "wrote" in capsys.readouterr().out
    assert (tmp_path / "out" / "run.json").is_file()
    if words[0] == "evaluate":
        assert "wobble" in (tmp_path / "out" / "episodes.csv").read_text().splitlines()[0]


def test_a_reward_a_block_and_an_end_are_plain_functions():
    assert progress(3.0, 2.0) == 1.0
    assert at_goal(0.5, 1.0)
    assert own("smoothness").smoothness((3.0, 4.0, 0.0), (0.0, 0.0, 0.0)) == 5.0
    places = np.array([[0.0, 0.0, 10.0], [-3.0, -4.0, 12.0]])
    chain = own("chain")
    assert chain.uneven(0, tuple(places[0]), places, 5.0) == 0.0
    assert chain.uneven(1, tuple(places[1]), places, 4.0) == 1.0
    assert chain.in_place(0.9, 5.0)
    assert not chain.in_place(1.1, 5.0)


def test_the_config_of_a_task_comes_from_its_brackets():
    chain = own("chain")
    assert chain.Chain.Config is chain.ChainConfig
    assert issubclass(chain.ChainConfig, TaskConfig)
    with pytest.raises(ValueError, match="spacing is -1: it must not be negative"):
        bulletuav.Aviary(chain.Chain, spacing=-1.0)


def test_places_of_a_chain_go_round_and_stay_evenly_apart():
    aviary = bulletuav.Aviary(own("chain").Chain, 2, dynamics="point_mass", leader_speed=6.0)
    aviary.reset(seeds=0)
    first = aviary.scene.goal.copy()
    for _ in range(10):
        before = aviary.scene.goal.copy()
        aviary.step(np.zeros((2, 4, 3)))
        moved = aviary.scene.goal - before
        np.testing.assert_allclose(np.linalg.norm(moved, axis=-1), 0.6, rtol=1e-3)
        np.testing.assert_allclose(moved, 0.1 * aviary.scene.goal_velocity, atol=0.02)
    gaps = np.linalg.norm(np.diff(aviary.scene.goal, axis=1), axis=-1)
    np.testing.assert_allclose(gaps, 5.0, rtol=2e-3)
    np.testing.assert_allclose(gaps, np.linalg.norm(np.diff(first, axis=1), axis=-1))
    aviary.close()


def test_both_ways_of_a_reward_term_give_the_same():
    smoothness = own("smoothness")
    terms = {"one": (smoothness.smoothness, -0.1), "all": (smoothness.smoothness_of_all, -0.1)}
    aviary = bulletuav.Aviary("crossing", dynamics="point_mass", reward=terms)
    aviary.reset(seeds=0)
    info = aviary.step(np.full((1, 8, 3), 0.5)).info
    np.testing.assert_allclose(info["reward/one"], info["reward/all"], rtol=1e-12)
    assert (info["reward/one"] < 0).all()
    aviary.close()


def test_who_glides_slows_down_without_a_command():
    glide = own("glide").Glide
    aviary = bulletuav.Aviary("converge", dynamics=glide, action="velocity", effects=())
    aviary.reset(seeds=0)
    speed = [np.linalg.norm(aviary.swarm.velocity, axis=-1)]
    for _ in range(5):
        aviary.step(np.zeros((1, aviary.num_drones, 3)))
        speed.append(np.linalg.norm(aviary.swarm.velocity, axis=-1))
    assert (np.diff(speed, axis=0) < 0).all()
    aviary.close()


@given(st.lists(st.floats(-20.0, 20.0), min_size=3, max_size=3))
def test_places_follow_from_distances_to_anchors(place):
    uwb = own("uwb")
    distance = np.linalg.norm(np.array(place) - uwb.ANCHORS, axis=-1)
    np.testing.assert_allclose(uwb.position_from(distance), place, atol=1e-9)


def test_the_policy_of_a_file_is_found_by_module_and_name(monkeypatch):
    monkeypatch.syspath_prepend(FOLDER)
    monkeypatch.delitem(sys.modules, "higher", raising=False)
    higher = find_policy("higher:Higher").make
    assert higher.__name__ == "Higher"
    assert find_policy(higher).name == "higher"


def test_the_airframe_is_as_heavy_as_its_comment_says():
    airframe = bulletuav.load_airframe(FOLDER / "heavy.urdf")
    assert airframe.mass == 5.5 + 6 * (0.45 + 0.3)
    arms = 6 * (0.45 * 0.6**2 + 0.3 * 0.6**2 / 3)
    hub = 5.5 / 12 * (0.3**2 + 0.2**2), 5.5 / 12 * 2 * 0.3**2
    expected = hub[0] + arms / 2, hub[0] + arms / 2, hub[1] + arms
    np.testing.assert_allclose(airframe.inertia, expected, rtol=1e-3)
    diameter = 2 * airframe.propeller_radius
    thrust = 0.11 * 1.225 * diameter**4 / (2 * math.pi) ** 2
    assert airframe.thrust_coefficient == pytest.approx(thrust, rel=1e-3)
    torque = 0.045 / (2 * math.pi * 0.11) * diameter
    assert airframe.torque_ratio == pytest.approx(torque, rel=1e-3)
    drag = 0.25 * airframe.mass / (6 * airframe.hover_speed())
    assert airframe.drag_xy == pytest.approx(drag, rel=1e-3)


ATMOSPHERE = {0.0: 1013.25, 500.0: 954.608, 1000.0: 898.746, 5000.0: 540.199, 11000.0: 226.320}
"""Pressure, hPa, at geopotential heights, m: ISO 2533:1975"""


@pytest.mark.parametrize("height", ATMOSPHERE)
def test_the_barometer_has_the_standard_atmosphere(height):
    barometer = own("barometer")
    pressure = barometer.pressure_at(height)
    assert pressure / 100 == pytest.approx(ATMOSPHERE[height], abs=6e-4)
    assert barometer.pressure_altitude(pressure) == pytest.approx(height, abs=1e-6)


@given(st.floats(-500.0, 10_999.0), st.floats(0.1, 1.0))
def test_pressure_falls_with_height_by_the_weight_of_the_air(height, rise):
    barometer = own("barometer")
    low, high = barometer.pressure_at(height), barometer.pressure_at(height + rise)
    temperature = 288.15 - 0.0065 * (height + rise / 2)
    density = (low + high) / 2 / (287.05287 * temperature)
    assert low - high == pytest.approx(9.80665 * density * rise, rel=1e-6, abs=1e-9)


def test_a_barometer_reads_the_height_and_drifts_as_it_is_told():
    barometer = own("barometer")

    def fly(**uncertain):
        aviary = bulletuav.Aviary(
            "hover",
            2,
            num_drones=4,
            action="velocity",
            dynamics="point_mass",
            horizon=400,
            sensors=(barometer.Barometer(),),
            observation=("velocity", "barometer", barometer.pressure_altitude),
            randomization={f"barometer_{key}": value for key, value in uncertain.items()},
        )
        errors = [aviary.reset(seeds=0)[..., -1] - aviary.swarm.position[..., 2]]
        for _ in range(300):
            observed = aviary.step(np.zeros((2, 4, 3))).observations
            errors.append(observed[..., -1] - aviary.swarm.position[..., 2])
        aviary.close()
        return np.array(errors)

    metre = 101325 * barometer.EXPONENT * barometer.LAPSE / barometer.SEA_LEVEL_TEMPERATURE  # Pa
    np.testing.assert_allclose(fly(), 0.0, atol=2e-3)
    assert fly(noise=2.0).std() * metre == pytest.approx(2.0, rel=0.05)
    drifted = fly(drift=3.0)
    np.testing.assert_allclose(drifted[0], 0.0, atol=2e-3)
    steps = np.diff(drifted, axis=0) * metre
    assert steps.std() * math.sqrt(30) == pytest.approx(3.0, rel=0.05)  # 30 decisions a second


def test_a_term_by_its_name_gets_the_sensor_that_it_reads():
    chain = own("chain")

    class Wary(chain.Chain):
        name = "wary"

        def quantities(self):
            return {"proximity_range": 5.0}

    aviary = bulletuav.Aviary(Wary, dynamics="point_mass", reward={"wary": ("proximity", -1.0)})
    try:
        aviary.reset(seeds=0)
        assert "reward/wary" in aviary.step(np.zeros((1, 4, 3))).info
    finally:
        aviary.close()


def test_an_evaluation_goes_on_only_with_the_same_ingredients(tmp_path):
    barometer = own("barometer")

    def paying(bonus):
        def term(frame):
            return np.full(frame.alive.shape, bonus)

        result = bulletuav.evaluate(
            "crossing",
            "straight",
            1,
            out=tmp_path / "out",
            dynamics="point_mass",
            horizon=5,
            sensors=(barometer.Barometer(),),
            reward={"bonus": (term, 1.0)},
        )
        return result.estimates()["return"].mean

    first = paying(1.0)
    assert paying(1.0) == first
    with pytest.raises(ValueError, match="holds another run"):
        paying(2.0)
