"""Every example runs, in its shortest form, and does what it says."""

import re
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

import bulletuav

FOLDER = Path(__file__).parent.parent / "examples"
EXAMPLES = {
    "step_response": "",
    "pid_flight": "--seconds 2",
    "custom_task": "--seconds 2 --drones 3",
    "custom_airframe": "--payload 0.5",
    "ppo_hover": "--steps 1 --episodes 1",
    "ppo_crossing": "--steps 1 --episodes 1",
    "dqn_discrete": "--steps 5200 --episodes 1",
    "camera_cnn": "--steps 1 --episodes 1 --forests 2",
    "domain_randomisation": "--steps 1 --episodes 1",
    "curriculum": "--steps 1 --episodes 1",
}
"""Arguments of the shortest form"""
PICTURES = {
    "pid_flight": "square.png",
    "custom_task": "idleness.png",
    "custom_airframe": "step.png",
    "ppo_hover": "flight.png",
    "ppo_crossing": "flight.png",
    "camera_cnn": "flight.png",
}
MODELS = {
    "ppo_hover": {"model.zip"},
    "ppo_crossing": {"model.zip"},
    "dqn_discrete": {"untrained.zip", "trained.zip"},
    "camera_cnn": {"model.zip"},
    "domain_randomisation": {"certain.zip", "uncertain.zip"},
    "curriculum": {"model.zip"},
}
NUMBER = r"(-?\d+(?:\.\d+)?|nan|-?inf)"


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Runs an example as its command does, in an empty folder; gives what it printed."""

    def run_it(name, arguments):
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", [f"{name}.py", *arguments.split()])
        runpy.run_path(str(FOLDER / f"{name}.py"), run_name="__main__")
        return capsys.readouterr().out

    return run_it


def numbers(pattern, text):
    """What stands where the pattern has `#`; at least one match."""
    found = re.findall(pattern.replace("#", NUMBER), text)
    assert found, f"{pattern!r} is not in {text!r}"
    values = np.array(found, dtype=float)
    assert np.isfinite(values).all()
    return values


def test_every_example_is_tested_and_short():
    assert {path.stem for path in FOLDER.glob("*.py")} == set(EXAMPLES)
    for path in FOLDER.glob("*.py"):
        assert len(path.read_text().splitlines()) < 250, path.name


@pytest.mark.parametrize("name", [name for name, arguments in EXAMPLES.items() if arguments])
def test_help_tells_what_one_sees(name, run, capsys):
    with pytest.raises(SystemExit) as end:
        run(name, "--help")
    assert end.value.code == 0
    told = capsys.readouterr().out
    assert f"python examples/{name}.py" in told
    assert "Takes" in told


@pytest.mark.parametrize("name", EXAMPLES)
def test_it_runs(name, run, tmp_path):
    told = run(name, EXAMPLES[name])
    CHECKS[name](told, tmp_path / name)
    written = {path.name for path in tmp_path.rglob("*") if path.is_file()}
    assert {path.name for path in tmp_path.iterdir()} <= {name}, "writes outside its folder"
    assert MODELS.get(name, set()) == {file for file in written if file.endswith(".zip")}
    if name in PICTURES:
        assert (tmp_path / name / PICTURES[name]).read_bytes().startswith(b"\x89PNG")


def check_step_response(told, folder):
    overshoot, settling = numbers(r"overshoot # %, settles in # s", told).T
    assert len(overshoot) == 2
    assert (overshoot < 30).all()
    assert (settling < 10).all()


def check_pid_flight(told, folder):
    mean, most, _ = numbers(r"error # cm on average, # cm at most, # cm", told)[0]
    assert 0 < mean < most < 50


def check_custom_task(told, folder):
    rows = numbers(r"success #, conflicts #, worst idleness at the end # s", told)
    assert rows[:, 2] == pytest.approx(2.0)  # in two seconds no one comes round


def check_custom_airframe(told, folder):
    airframe = bulletuav.load_airframe(folder / "hexacopter.urdf")
    assert airframe.mass == pytest.approx(0.95 + 0.5 + 6 * (0.075 + 0.035))
    assert len(airframe.rotors) == 6
    formula, engine = numbers(r"hover speed # rad/s by formula, # rad/s", told)[0]
    assert formula == pytest.approx(airframe.hover_speed(), abs=0.05)
    assert engine == pytest.approx(formula, rel=1e-3)
    assert numbers("thrust to weight #", told)[0] > 2


def check_ppo_hover(told, folder):
    success, low, high = numbers(r"in bullet: success # \(# to #\)", told)[0]
    assert 0 <= low <= success <= high <= 1
    assert numbers(r"goal_distance # ", told)[0] < 20


def check_ppo_crossing(told, folder):
    rows = dict(re.findall(r"^(ppo|straight|orca) +(.*)$", told, re.MULTILINE))
    table = {name: [float(number) for number in row.split()] for name, row in rows.items()}
    assert [len(row) for row in table.values()] == [7, 7, 7]
    assert table["orca"][0] == 1  # all reach their goals
    assert table["straight"][3] > table["orca"][3]  # conflicts
    assert table["ppo"][0] == 0  # which has learned nothing yet


def check_dqn_discrete(told, folder):
    rows = numbers(
        r"ed in (?:point_mass|bullet): drone_success #, conflict #, conflicts #, goal_distance #",
        told,
    )
    assert len(rows) == 3
    assert (rows[:, 0] <= 1).all()
    assert (folder / "trained.zip").read_bytes() != (folder / "untrained.zip").read_bytes()


def check_camera_cnn(told, folder):
    rows = numbers(r": success # \(# to #\)", told)
    assert len(rows) == 3
    assert (rows[:, 1] <= rows[:, 0]).all()
    assert (rows[:, 0] <= rows[:, 2]).all()


def check_domain_randomisation(told, folder):
    rows = numbers(r"\n(?:certain|uncertain) +(?:certain|uncertain) +# +# +#", told)
    success, distance, collision = rows.T
    assert len(rows) == 4
    assert ((success >= 0) & (success <= 1) & (distance < 20) & (collision <= 1)).all()


def check_curriculum(told, folder):
    rows = numbers(r"stage # in bullet: success of drones #, episodes with conflict #", told)
    assert list(rows[:, 0]) == [0, 1, 2, 3]
    assert (rows[:, 1:] <= 1).all()


CHECKS = {
    name.removeprefix("check_"): check
    for name, check in list(globals().items())
    if name.startswith("check_")
}
