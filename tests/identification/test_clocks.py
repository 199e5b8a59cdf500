"""Delays of positions and velocities behind the attitude are found, and no longer bias drag."""

import dataclasses
import json

import flown
import numpy as np
import pytest

from bulletuav import load_airframe
from bulletuav.cli import main
from bulletuav.identification.curves import make_curves
from bulletuav.identification.errors import NUM_LOG_PARAMETERS, compute_errors
from bulletuav.identification.flight import prepare_log
from bulletuav.identification.identify import identify
from bulletuav.identification.logs import Log
from bulletuav.identification.write import summarize, write_report

TRUE = load_airframe("cf2x")
START = dataclasses.replace(TRUE, drag_xy=0.8 * TRUE.drag_xy)
NAMES = (*flown.COLUMNS, "vx", "vy", "vz")


def write_late_log(path, seed, late, seconds=15.0):
    """Write a flight whose positions and velocities are late by rows of 10 ms.

    Args:
        path: The file.
        seed: Seed of flight and noise.
        late: Rows by which positions are late, and velocities if the log has any.
        seconds: Duration, s.
    """
    rows = flown.fly_example(TRUE, seconds, seed=seed)
    velocity = np.gradient(rows[:, 1:4], 0.01, axis=0)
    velocity += 0.005 * np.random.default_rng(seed).standard_normal(velocity.shape)
    rows = np.concatenate([flown.add_sensor_noise(rows, seed), velocity], axis=1)
    rows[:, 1:4] = np.roll(rows[:, 1:4], late[0], axis=0)
    if len(late) == 1:
        return flown.write_example_log(path, rows[late[0] :, :-3])
    rows[:, -3:] = np.roll(rows[:, -3:], late[1], axis=0)
    return flown.write_example_log(path, rows[max(late) :], NAMES)


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Two logs that are fitted, the second without velocities, and one that is held out."""
    folder = tmp_path_factory.mktemp("clocks")
    late = {"a": (3, 1), "b": (2, 2), "c": (2,)}
    return [write_late_log(folder / f"{name}.csv", ord(name), rows) for name, rows in late.items()]


@pytest.fixture(scope="module")
def result(logs):
    return identify(logs, START, fit=["drag"], clocks=True)


def test_delays_come_back_within_their_intervals(result):
    expected = {("a.csv", "position"): 0.03, ("a.csv", "velocity"): 0.01}
    expected["c.csv", "position"] = 0.02
    assert [(one.log, one.quantity) for one in result.clocks] == list(expected)
    for one, true in zip(result.clocks, expected.values(), strict=True):
        assert one.low <= true <= one.high
        assert one.high - one.low < 0.002
    # Commands have a clock of their own
    assert result.fitted[0].delay == pytest.approx(0.02, abs=0.001)


def test_drag_is_biased_without_the_delays(result, logs):
    """A late velocity looks like drag, or like its opposite."""
    (drag, *_) = result.estimates
    assert drag.low <= TRUE.drag_xy <= drag.high
    other = identify(logs, START, fit=["drag"])
    assert other.clocks == []
    assert not other.estimates[0].low <= TRUE.drag_xy <= other.estimates[0].high
    kept = [np.abs(one.kept[0].after.translation).mean() for one in (result, other)]
    assert kept[0] < 0.7 * kept[1]


def test_logs_of_one_clock_have_no_delays(tmp_path):
    log = write_late_log(tmp_path / "on_time.csv", 5, (0, 0), 30.0)
    found = identify([log], START, clocks=True)
    for one in found.clocks:
        assert one.low <= 0.0 <= one.high
        assert one.high - one.low < 0.003
    drag = next(one for one in found.estimates if one.constant.name == "drag_xy")
    assert drag.low <= TRUE.drag_xy <= drag.high


def test_delays_are_reported(result, tmp_path):
    rows = summarize(result)["clocks"]
    assert rows[0]["log"] == "a.csv"
    assert rows[0]["low"] < 0.03 < rows[0]["high"]
    report, table = write_report(result, tmp_path)
    assert f"| a.csv | position | {1e3 * rows[0]['delay']:.2f} | " in report.read_text()
    assert json.loads(table.read_text())["clocks"] == rows


def test_curves_are_those_of_the_aligned_flight(result):
    """Predictions start near the measurements, with the delays of either airframe's fit."""
    curves = make_curves(result.fitted[0])
    for curve in curves[:2]:
        assert np.abs(curve.after - curve.measured).mean() < 0.02
        assert np.abs(curve.before - curve.measured).mean() < 0.05


def sine_flight(names=()):
    """A log whose columns are sines, with columns of a velocity or another drone if named."""
    time = np.arange(0.0, 4.0, 0.01)
    columns = {name: np.zeros(len(time)) for name in ("y", "qx", "qy", "qz")}
    columns |= {"t": time, "x": np.sin(time), "z": 1.0 + 0 * time, "qw": np.ones(len(time))}
    columns |= {f"w{k}": np.full(len(time), TRUE.hover_speed()) for k in (1, 2, 3, 4)}
    columns |= {name: np.sin(time) for name in names}
    return prepare_log(Log("sine", columns, {}), TRUE, 0.5)


def test_positions_and_velocities_are_shifted():
    inner = slice(50, -50)
    flight = sine_flight(("vx", "vy", "vz", "other_x", "other_y", "other_z"))
    time = flight.grid[inner]
    track = flight.align_track(0.033, -0.014)
    np.testing.assert_allclose(track.position[inner, 0], np.sin(time + 0.033), atol=1e-6)
    np.testing.assert_allclose(track.other[inner, 1], np.sin(time + 0.033), atol=1e-6)
    # Logged velocities are smoothed by a parabola
    np.testing.assert_allclose(track.velocity[inner, 2], np.sin(time - 0.014), atol=1e-4)
    np.testing.assert_array_equal(track.rates, flight.track.rates)
    # Beyond the end, the last value stays
    assert track.position[-1, 0] == pytest.approx(flight.track.position[-1, 0])


def test_velocities_from_positions_have_their_delay():
    flight = sine_flight()
    track = flight.align_track(0.033, 5.0)
    inner = slice(50, -50)
    np.testing.assert_allclose(
        track.velocity[inner, 0], np.cos(flight.grid[inner] + 0.033), atol=1e-5
    )
    assert track.other.shape == (0, 3)
    assert flight.align_track(0.0, 5.0) is flight.track


def test_shifted_measurements_predict_the_same(tmp_path):
    """Errors of a late log with its delays are those of the log on time."""
    windows = np.arange(4)
    found = []
    for late in (0, 3):
        rows = flown.fly_example(TRUE, 4, seed=6)
        rows[:, 1:4] = np.roll(rows[:, 1:4], late, axis=0)
        path = flown.write_example_log(tmp_path / f"{late}.csv", rows)
        columns = np.genfromtxt(path, delimiter=",", names=True)
        log = Log(path, {name: columns[name] for name in columns.dtype.names}, {})
        own = np.zeros(NUM_LOG_PARAMETERS)
        own[7] = late
        found.append(compute_errors(prepare_log(log, TRUE, 0.5), windows, TRUE, own))
    np.testing.assert_allclose(found[1].translation, found[0].translation, atol=1e-6)
    np.testing.assert_allclose(found[1].rotation, found[0].rotation, atol=1e-9)


def test_clocks_that_are_too_far_off_raise_an_error(tmp_path):
    log = write_late_log(tmp_path / "late.csv", 7, (30,))
    message = r"late\.csv: the clock of the position is 0\.25 s or more off .*: shift x, y, z by"
    with pytest.raises(ValueError, match=message):
        identify([log], TRUE, fit=["thrust"], clocks=True)


def test_the_command_prints_delays(logs, tmp_path, capsys):
    common = ["identify", str(logs[2]), "--airframe", "cf2x", "--fit", "thrust"]
    main([*common, "--clocks", "--out", str(tmp_path / "out")])
    printed = capsys.readouterr().out
    assert "Delays behind the attitude, ms" in printed
    assert "position" in printed
    main([*common, "--out", str(tmp_path / "other")])
    assert "Delays behind the attitude, ms" not in capsys.readouterr().out


def test_the_example_has_one_clock(tmp_path, capsys):
    example = str(tmp_path / "example.csv")
    with pytest.raises(SystemExit):
        main(["identify", "--example", example, "--airframe", "cf2x", "--clocks"])
    assert "--clocks has no effect with --example" in capsys.readouterr().err
