"""Environments whose compiled functions run as plain Python, for debuggers: the same bits."""

import itertools
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import bulletuav
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.envs.airspace import Airspace

QUICK = {
    "crossing": {"dynamics": "point_mass", "randomization": {"gps_noise": 1.0}},
    "hover": {"dynamics": "bullet", "turbulence": "light", "energy": "actuator"},
    "navigation": {"dynamics": "rigid_body", "controller": "lee", "battery_capacity": 1.0},
}
LADDER = ("bullet", "rigid_body", "point_mass", "double_integrator", "single_integrator")
OTHERS = dict(zip(bulletuav.list_tasks(), itertools.cycle(LADDER), strict=False))
OTHERS["transport"] = "rigid_body"  # its loads need cables


def flown(task, **options):
    """All that three decisions of two worlds give, with a reset of one of them."""
    given = {"num_worlds": 2, "seed": 5, **options}
    env = bulletuav.batch_env(task, given.pop("num_worlds"), **given)
    results, rng = [env.reset(seed=3)[0]], np.random.default_rng(1)
    for _ in range(3):
        step = env.step(rng.uniform(-1, 1, env.aviary.given.shape))
        results += [step[0], *map(np.asarray, step[1:4])]
    results.append(env.aviary.reset(mask=np.array([False, True])))
    results.append(np.array(env.aviary.state_hash()))
    env.close()
    # Pictures come in a dict
    parts = (one.values() if isinstance(one, dict) else (one,) for one in results)
    return [array.tobytes() for array in itertools.chain.from_iterable(parts)]


@pytest.mark.parametrize("task", QUICK)
def test_a_debugged_environment_flies_the_same_bits(task):
    options = QUICK[task]
    assert flown(task, debug=True, **options) == flown(task, **options)


@pytest.mark.slow
@pytest.mark.parametrize("task", OTHERS)
def test_every_task_flies_the_same_bits(task):
    options = {"dynamics": OTHERS[task], "observation_format": "vector"}
    assert flown(task, debug=True, **options) == flown(task, **options)


def fallen(steps, **options):
    """The state of drones that fall on each other and on the ground."""
    places = [(0.0, 0.0, 0.1), (0.02, 0.01, 0.16), (2.0, 2.0, 0.05)]
    air = Airspace(places, decision_hz=48, seed=0, **options)
    for _ in range(steps):
        air.step()
    air.command(2, SetpointLevel.VELOCITY, (1.0, 0.0, 0.2), yaw_rate=0.5)
    air.step()
    assert set(air.contacts.drone) >= {0, 1}
    return air.state_hash()


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body"])
def test_debugged_contacts_are_the_same(dynamics):
    options = {"dynamics": dynamics, "contacts": "stop"}
    assert fallen(8, debug=True, **options) == fallen(8, **options)


@pytest.mark.slow
def test_debugged_impulses_are_the_same():
    assert fallen(20, debug=True) == fallen(20)


def functions_seen(**options):
    """Names of all functions of the package that Python runs in a decision."""
    env = bulletuav.parallel_env("crossing", num_drones=2, dynamics="rigid_body", **options)
    env.reset(seed=0)
    actions = {agent: np.zeros(3) for agent in env.agents}
    env.step(actions)
    seen = set()
    sys.settrace(lambda frame, *_: seen.add(frame.f_code.co_name))
    try:
        env.step(actions)
    finally:
        sys.settrace(None)
    return seen


def test_debuggers_see_every_function_of_a_decision():
    hidden = functions_seen(debug=True) - functions_seen()
    assert {
        "admit",
        "rotor_wrench",
        "rotor_speed_after",
        "fill_conflict",
        "end_episodes",
        "sum_rewards",
    } <= hidden


def test_the_session_of_the_documentation(tmp_path):
    """It stops at the force on the body, and not at what the controller makes of its model."""
    page = Path(__file__).parents[2].joinpath("CONTRIBUTING.md").read_text()
    session = re.search(r"```console\n(\$ python -m pdb.*?)```", page, re.DOTALL).group(1)
    program = re.search(r"```python\n(# fly\.py\n.*?)```", page, re.DOTALL).group(1)
    commands = re.findall(r"^\(Pdb\) (.*)$", session, re.MULTILINE)
    tmp_path.joinpath("fly.py").write_text(program)
    run = subprocess.run(
        [sys.executable, "-m", "pdb", "fly.py"],
        input="\n".join(commands),
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert "Error" not in run.stdout, run.stdout + run.stderr
    answers = dict(zip(commands, run.stdout.split("(Pdb) ")[1:], strict=True))
    assert re.search(r"slope_of\(\)\n.*\n.*wrench\(\)", answers["where"])
    thrust, mass = map(float, re.findall(r"float64\((.*?)\)", answers["p rotors[0], row.mass"]))
    # What the rotors of the same flight give, compiled, where its second decision begins
    env = bulletuav.parallel_env("crossing", num_drones=2, dynamics="rigid_body")
    env.reset(seed=0)
    env.step({agent: [1.0, 0.0, 0.0] for agent in env.agents})
    row, speed = env.aviary.parameters[0, 0], env.aviary.swarm.rotor_speed[0, 0]
    assert thrust == pytest.approx(row["thrust_coefficient"] * (speed**2).sum(), rel=1e-12)
    assert mass == row["mass"]
    assert abs(thrust / (mass * 9.80665) - 1.0) > 0.01
    assert "--Return--" in answers["return"]


def test_debug_needs_one_process():
    with pytest.raises(ValueError, match="debug is True.*workers=1"):
        bulletuav.batch_env("hover", 2, workers=2, debug=True)


def test_debug_is_a_bool():
    with pytest.raises(ValueError, match="debug is 'yes'"):
        bulletuav.parallel_env("hover", debug="yes")


def test_a_snapshot_of_a_debugged_environment_goes_on_in_another():
    states = []
    for first, second in itertools.permutations([False, True]):
        one = bulletuav.batch_env("hover", 1, dynamics="rigid_body", debug=first).aviary
        other = bulletuav.batch_env("hover", 1, dynamics="rigid_body", debug=second).aviary
        one.reset(seeds=2)
        one.step(np.full(one.given.shape, 0.1))
        other.load_state(one.save_state())
        other.step(np.full(other.given.shape, 0.2))
        states.append(other.state_hash())
    assert states[0] == states[1]
