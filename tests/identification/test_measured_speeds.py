"""Logs with measured rotor speeds: constants come back, and lag has no effect."""

import dataclasses

import flown
import numpy as np
import pytest

from bulletuav import load_airframe
from bulletuav.cli import main
from bulletuav.identification.constants import choose_constants
from bulletuav.identification.flight import prepare_log
from bulletuav.identification.identify import identify
from bulletuav.identification.logs import Log
from bulletuav.identification.rollout import simulate_rotors
from bulletuav.identification.write import format_report, summarize, write_urdf
from bulletuav.vehicle.parameters import parameter_rows

TRUE = load_airframe("cf2x")
DELAY = 2
"""Rows after which a logged command of the example takes effect"""
WRONG_LAG = dataclasses.replace(
    TRUE,
    thrust_coefficient=1.1 * TRUE.thrust_coefficient,
    inertia=(1.3 * TRUE.inertia[0], *TRUE.inertia[1:]),
    lag_up=3 * TRUE.lag_up,
    lag_down=3 * TRUE.lag_down,
)
COMMANDS = slice(11, 15)
"""Columns of rotor speeds in the rows of an example"""


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """A log of 30 s with the rotor speeds of the flight instead of commands."""
    rows = flown.fly_example(TRUE, 30, seed=3)
    command = np.ascontiguousarray(rows[:, COMMANDS])
    late = np.concatenate([np.full((DELAY, 4), TRUE.hover_speed()), command[:-DELAY]])
    speed = np.empty_like(late)
    simulate_rotors(late, parameter_rows([TRUE])[0], 0.01, speed)
    rows = flown.add_sensor_noise(rows, 3)
    rows[:, COMMANDS] = speed
    return flown.write_example_log(tmp_path_factory.mktemp("measured") / "flight.csv", rows)


def test_constants_come_back_whatever_the_lag_of_the_airframe(log, tmp_path):
    found = identify([log], WRONG_LAG, fit=["thrust", "inertia_x"], measured=True)
    names = [one.constant.name for one in found.estimates]
    assert names == ["thrust_coefficient", "inertia_x"]
    for one in found.estimates:
        true = one.constant.get(TRUE)
        assert one.low <= true <= one.high
        assert abs(one.after - true) < 0.2 * abs(one.before - true)
    assert found.airframe.lag_up == WRONG_LAG.lag_up
    # Measured speeds have no delay, and need no lag to predict well
    assert abs(found.fitted[0].delay) < 0.003
    assert found.fitted[0].part.flight.measured
    commanded = identify([log], WRONG_LAG, fit=["thrust", "inertia_x"])
    rates = [np.abs(one.kept[0].after.rotation[..., 3:]).mean() for one in (found, commanded)]
    assert rates[0] < 0.8 * rates[1]
    # The files say which of the two the numbers are
    for one, measured in ((found, True), (commanded, False)):
        assert summarize(one)["measured"] is measured
        report, urdf = format_report(one), write_urdf(one, tmp_path).read_text()
        assert ("Delays of measured speeds and gyroscope" in report) is measured
        assert ("| measured speeds, ms |" in report) is measured
        assert ("Delays of commands and gyroscope" in report) is not measured
        assert ("Logs with measured rotor speeds: flight.csv" in urdf) is measured
        assert ("Logs: flight.csv" in urdf) is not measured


def test_measured_speeds_are_interpolated():
    time = np.arange(0.0, 3.0, 0.01)
    columns = {name: np.zeros(len(time)) for name in ("x", "y", "qx", "qy", "qz")}
    columns |= {"t": time, "z": np.ones(len(time)), "qw": np.ones(len(time))}
    columns |= {f"w{k}": TRUE.hover_speed() + 100 * k * time for k in (1, 2, 3, 4)}
    flight = prepare_log(Log("hover", columns, {}), TRUE, 0.5, measured=True)
    speeds = flight.measured_speeds(TRUE, 0.005)
    expected = TRUE.hover_speed() + 200 * (time[50:60] - 0.005)
    np.testing.assert_allclose(speeds[50:60, 1], expected)


def test_lag_has_no_effect_with_measured_speeds():
    assert "motor_lag" not in {one.name for one in choose_constants([], False, False, True)}
    assert "motor_lag" in {one.name for one in choose_constants([], False, False)}
    for name in ("lag", "motor_lag"):
        with pytest.raises(ValueError, match=f"--fit {name} has no effect with --measured"):
            choose_constants([name], False, False, True)


def test_motor_commands_are_no_measured_speeds(tmp_path, capsys):
    rows = flown.fly_example(TRUE, 6, seed=3)
    slope, intercept = TRUE.pwm.slope, TRUE.pwm.intercept
    rows[:, COMMANDS] = (rows[:, COMMANDS] * 60 / (2 * np.pi) - intercept) / slope
    names = [name.replace("w", "pwm") if name[1:].isdigit() else name for name in flown.COLUMNS]
    log = flown.write_example_log(tmp_path / "pwm.csv", rows, names)
    with pytest.raises(SystemExit):
        main(["identify", str(log), "--airframe", "cf2x", "--measured", "--out", str(tmp_path)])
    assert "--measured needs rotor speeds" in capsys.readouterr().err


def test_the_example_has_commands(tmp_path, capsys):
    example = str(tmp_path / "example.csv")
    with pytest.raises(SystemExit):
        main(["identify", "--example", example, "--airframe", "cf2x", "--measured"])
    assert "--measured has no effect with --example" in capsys.readouterr().err
