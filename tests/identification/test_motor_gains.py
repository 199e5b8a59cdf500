"""Thrust gains of single motors come back, relative to their mean, and are not lost in silence."""

import dataclasses
import json

import flown
import numpy as np
import pytest

from bulletuav import Airspace, load_airframe
from bulletuav.cli import main
from bulletuav.identification.constants import MOTOR_GAINS, choose_constants
from bulletuav.identification.identify import identify
from bulletuav.identification.motor_gains import (
    center_gains,
    describe_missing_gains,
    make_even,
    make_gain_constants,
    make_uneven,
    motor_speed_ratios,
)
from bulletuav.identification.write import summarize, write_report, write_urdf

TRUE = load_airframe("cf2x")
START = dataclasses.replace(TRUE, thrust_coefficient=1.05 * TRUE.thrust_coefficient)
GAINS = np.array([1.06, 0.97, 1.02, 0.95]) / np.prod([1.06, 0.97, 1.02, 0.95]) ** 0.25
"""Gains of the drone that flew, whose geometric mean is 1"""
COMMANDS = slice(11, 15)
"""Columns of commands in the rows of an example"""


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Two fitted logs and one that is held out between them, of the same uneven drone.

    Rotors that turn as commanded have gain 1. The commands in these logs are lower or higher than
    the speeds by the square root of the gain.
    """
    folder = tmp_path_factory.mktemp("uneven")
    found = []
    for seed in (1, 2, 3):
        rows = flown.add_sensor_noise(flown.fly_example(TRUE, 15, seed=seed), seed)
        rows[:, COMMANDS] /= np.sqrt(GAINS)
        found.append(flown.write_example_log(folder / f"{seed}.csv", rows))
    return found


@pytest.fixture(scope="module")
def result(logs):
    return identify(logs, START, fit=["thrust", "motor_gains"])


def test_gains_come_back_within_their_intervals(result):
    names = [one.constant.name for one in result.estimates]
    assert names == ["thrust_coefficient", *(f"motor_gain_{k}" for k in (1, 2, 3, 4))]
    for one, true in zip(result.estimates[1:], GAINS, strict=True):
        assert one.before == 1.0
        assert one.low <= true <= one.high
        assert one.high - one.low < 0.01
        assert abs(one.after - true) < 0.2 * abs(1.0 - true)
    thrust = result.estimates[0]
    assert thrust.low <= TRUE.thrust_coefficient <= thrust.high
    # Relative gains: thrust_coefficient alone scales all motors
    assert np.prod([one.after for one in result.estimates[1:]]) == pytest.approx(1.0, abs=1e-4)


def test_gains_predict_held_out_flights(result, logs):
    even = identify(logs, START, fit=["thrust"])
    errors = [np.abs(one.kept[0].after.rotation[..., 3:]).mean() for one in (result, even)]
    assert errors[0] < 0.9 * errors[1]


def test_gains_are_reported_and_the_urdf_lacks_them(result, tmp_path):
    rows = summarize(result)["constants"]
    assert rows["motor_gain_3"]["low"] < GAINS[2] < rows["motor_gain_3"]["high"]
    report, table = write_report(result, tmp_path)
    assert "| motor_gain_3 | 1 | 1 | 1.0" in report.read_text()
    assert "The URDF does not contain the motor gains" in report.read_text()
    assert json.loads(table.read_text())["note"] == result.note
    loaded = load_airframe(write_urdf(result, tmp_path))
    assert dataclasses.replace(loaded, urdf=result.airframe.urdf) == result.airframe
    # An airframe with gains would be simulated without them
    assert type(result.airframe) is type(TRUE)


def test_the_note_says_how_to_simulate_the_gains():
    """The condition that it names makes the same torque as uneven commands do."""
    assert "by 1.2500 and set the condition rotor_effectiveness to (1.0000, 0.6400)" in (
        describe_missing_gains([1.25, 0.8])
    )
    highest = max(GAINS)
    quick = dataclasses.replace(TRUE, lag_up=0.0, lag_down=0.0)
    stronger = dataclasses.replace(quick, thrust_coefficient=highest * TRUE.thrust_coefficient)
    hover = TRUE.hover_speed()
    ratios = motor_speed_ratios(dataclasses.replace(make_uneven(TRUE), motor_gains=tuple(GAINS)))
    rates = []
    for drone, commands in ((stronger, np.full(4, hover)), (quick, ratios * hover)):
        space = Airspace(np.array([[0.0, 0.0, 1.0]]), airframe=drone, dynamics="rigid_body")
        if drone is stronger:
            space.set_condition(0, rotor_effectiveness=tuple(GAINS / highest))
        space.command(0, "rotor", commands)
        space.step()
        rates.append(space.swarm.rates[0].copy())
    assert np.abs(rates[1]).max() > 0.01
    np.testing.assert_allclose(rates[0], rates[1], rtol=0.02, atol=1e-3)


def test_only_ratios_of_gains_have_an_effect():
    uneven = dataclasses.replace(make_uneven(TRUE), motor_gains=(2.0, 2.0, 8.0, 2.0))
    other = dataclasses.replace(uneven, motor_gains=(1.0, 1.0, 4.0, 1.0))
    np.testing.assert_allclose(motor_speed_ratios(uneven), motor_speed_ratios(other))
    # Roots of the gains divided by their geometric mean, 4^(1/4)
    np.testing.assert_allclose(motor_speed_ratios(other)[1:3], (2**-0.25, 2**0.75))
    np.testing.assert_array_equal(motor_speed_ratios(TRUE), np.ones(4))
    np.testing.assert_array_equal(motor_speed_ratios(make_uneven(TRUE)), np.ones(4))
    assert make_even(uneven) == TRUE


def test_the_mean_of_the_gains_is_left_out_of_their_intervals():
    # Independent logarithms of deviation 1: without their mean, the variance is 1 - 1/2
    constants = [*choose_constants(["thrust"], False, False), *make_gain_constants(2)]
    theta, covariance = center_gains(constants, np.array([5.0, 1.0, 3.0, 7.0]), np.eye(4))
    np.testing.assert_allclose(theta, (5.0, -1.0, 1.0, 7.0))
    np.testing.assert_allclose(np.diag(covariance), (1.0, 0.5, 0.5, 1.0))
    # A mean that is not determined does not matter
    vague = np.eye(4) + 100 * np.outer((0, 1, 1, 0), (0, 1, 1, 0))
    np.testing.assert_allclose(center_gains(constants, theta, vague)[1], covariance)


def test_gains_are_fitted_only_together_and_on_request():
    assert MOTOR_GAINS not in {one.group for one in choose_constants([], True, True)}
    with pytest.raises(ValueError, match=r"--fit motor_gain_2: there is no such .*motor_gains"):
        choose_constants(["motor_gain_2"], False, False)


def test_the_command_prints_gains_and_the_note(logs, tmp_path, capsys):
    out = str(tmp_path / "out")
    main(["identify", str(logs[0]), "--airframe", "cf2x", "--fit", "motor_gains", "--out", out])
    printed = " ".join(capsys.readouterr().out.split())
    assert "motor_gain_4" in printed
    assert "The URDF does not contain the motor gains" in printed


def test_a_centre_of_mass_off_the_middle_makes_no_gains(tmp_path):
    """In hover, gains of 0.97 and 1.03 make the torque of a shift by 1 of 32.5 mm."""
    shifted = dataclasses.replace(
        TRUE, rotors=tuple((x - 0.001, y, turn) for x, y, turn in TRUE.rotors)
    )
    rows = flown.add_sensor_noise(flown.fly_example(shifted, 30, seed=1), 1)
    log = flown.write_example_log(tmp_path / "shifted.csv", rows)
    found = identify([log], TRUE, fit=["thrust", "motor_gains"])
    for one in found.estimates[1:]:
        assert one.after == pytest.approx(1.0, abs=0.005)
    # In hundredths of weight times arm: the shift of 1 mm about y
    unit = 0.01 * TRUE.arm
    assert found.fitted[0].log_parameters[4] == pytest.approx(0.001 / unit, rel=0.05)
