"""What flew is found again: constants, delays and predictions, from logs with noise."""

import dataclasses
import json
import math

import flown
import numpy as np
import pytest

from bulletuav import Airspace, load_airframe
from bulletuav.cli import main
from bulletuav.identification.fitting import BLOCK, correlation_threshold
from bulletuav.identification.identify import identify
from bulletuav.identification.write import compute_rms, summarize, write_report, write_urdf

TRUE = load_airframe("cf2x")
START = dataclasses.replace(
    TRUE,
    thrust_coefficient=1.12 * TRUE.thrust_coefficient,
    torque_ratio=0.8 * TRUE.torque_ratio,
    drag_xy=0.7 * TRUE.drag_xy,
    drag_z=0.7 * TRUE.drag_z,
    drag_height=0.6 * TRUE.drag_height,
    lag_up=0.75 * TRUE.lag_up,
    lag_down=0.75 * TRUE.lag_down,
    inertia=(1.2 * TRUE.inertia[0], 1.2 * TRUE.inertia[1], TRUE.inertia[2]),
    damping=(1.0, 1.0, 3.0),
)
"""A wrong idea of the drone that flew"""
FOUND = (
    "thrust_coefficient",
    "torque_ratio",
    "drag_xy",
    "drag_z",
    "drag_height",
    "motor_lag",
    "inertia_x",
    "inertia_y",
    "damping_x",
    "damping_y",
    "damping_z",
)


@pytest.fixture(scope="module")
def flight():
    """A flight of 40 s without noise."""
    return flown.fly_example(TRUE, 40, seed=3)


@pytest.fixture(scope="module")
def log(flight, tmp_path_factory):
    return flown.write_example_log(
        tmp_path_factory.mktemp("log") / "flight.csv", flown.add_sensor_noise(flight, 3)
    )


@pytest.fixture(scope="module")
def result(log):
    return identify([log], START)


def test_constants_come_back_within_their_intervals(result):
    table = {one.constant.name: one for one in result.estimates}
    assert set(FOUND) == {name for name, one in table.items() if one.is_identified}
    for name in FOUND:
        one = table[name]
        true = one.constant.get(TRUE)
        assert one.low <= true <= one.high, f"{name}: {true} is not in {one.low} to {one.high}"
        # Narrow enough to mean something, and better than where the fit began
        assert one.high - one.low < 0.15 * true
        assert abs(one.after - true) < 0.2 * abs(one.before - true)


def test_constants_that_logs_of_this_kind_cannot_tell_are_left_out(result):
    names = {one.constant.name for one in result.estimates}
    assert not names & {"wake_share", "ground_gain", "ground_reach", "inertia_z"}


def test_what_a_log_does_not_tell_stays(tmp_path):
    rows = flown.fly_example(TRUE, 16, seed=4, path=lambda time: np.array([0, 0, 1.0]))
    log = flown.write_example_log(tmp_path / "still.csv", flown.add_sensor_noise(rows, 4))
    found = identify([log], dataclasses.replace(TRUE, drag_z=0.5 * TRUE.drag_z))
    table = {one.constant.name: one for one in found.estimates}
    assert not table["drag_z"].is_identified
    assert table["drag_z"].after == 0.5 * TRUE.drag_z
    assert table["thrust_coefficient"].is_identified
    assert "drag_z" not in write_urdf(found, tmp_path).read_text()


def test_the_delay_of_commands_is_found(result):
    (one,) = result.fitted
    assert one.delay == pytest.approx(0.020, abs=0.001)
    assert one.part.flight.gyro_delay == pytest.approx(0.0, abs=0.001)


def test_predictions_are_as_good_as_the_noise_lets_them(result):
    kept = {kind: np.array(compute_rms(result.kept, kind)) for kind in ("naive", "before", "after")}
    assert (kept["after"] < 0.5 * kept["before"]).all()
    assert (kept["after"] < 0.2 * kept["naive"]).all()
    fitted = np.array(compute_rms(result.fitted, "after"))
    np.testing.assert_allclose(kept["after"], fitted, rtol=0.35)


TRIANGLE = "# {}\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


@pytest.fixture(scope="module")
def narrow(log):
    """Fits drag alone, which takes less time."""
    return identify([log], START, fit=["drag_xy"])


def test_the_kept_half_is_kept(result, narrow, flight, tmp_path):
    (fitted,), (kept,) = result.fitted, result.kept
    windows = fitted.part.windows, kept.part.windows
    assert not set(windows[0]) & set(windows[1])
    together = np.sort(np.concatenate(windows))
    np.testing.assert_array_equal(together, np.arange(len(fitted.part.flight.windows)))
    assert list(windows[0][: 2 * BLOCK]) == [0, 1, 2, 3, 8, 9, 10, 11]
    # Another flight in the kept windows, in their middles, changes no constant
    rows = flown.add_sensor_noise(flight, 3)
    measured = fitted.part.flight
    whole = len(windows[1]) // BLOCK * BLOCK
    for block in windows[1][:whole].reshape(-1, BLOCK):
        first = measured.windows[block[0]] + 30
        last = measured.windows[block[-1]] + measured.steps - 30
        rows[first:last, 1] += 0.01 * np.sin(np.linspace(0, 40, last - first))
    changed = identify(
        [flown.write_example_log(tmp_path / "other.csv", rows)], START, fit=["drag_xy"]
    )
    assert changed.estimates[0].after == narrow.estimates[0].after
    worse = compute_rms(changed.kept, "after")[0], compute_rms(narrow.kept, "after")[0]
    assert worse[0] > 1.1 * worse[1]


def test_the_urdf_loads_and_flies(result, tmp_path):
    path = write_urdf(result, tmp_path)
    loaded = load_airframe(path)
    assert path.name == "cf2x.urdf"
    assert "Fitted by bulletuav identify: thrust_coefficient, torque_ratio" in path.read_text()
    assert "flight.csv" in path.read_text()
    assert "Bitcraze" in path.read_text()  # what the file said before
    assert dataclasses.replace(loaded, urdf=result.airframe.urdf) == result.airframe
    space = Airspace([(0.0, 0.0, 1.0)], airframe=loaded, decision_hz=48, dynamics="rigid_body")
    space.command(0, "position", (0.5, 0.0, 1.0))
    for _ in range(4 * 48):
        space.step()
    np.testing.assert_allclose(space.swarm.position[0], (0.5, 0, 1), atol=0.02)


def test_meshes_from_elsewhere_go_into_the_folder(narrow, tmp_path):
    """And what lies beside it stays as it is."""
    source, folder = tmp_path / "frames" / "own", tmp_path / "out"
    source.mkdir(parents=True)
    folder.mkdir()
    text = narrow.before.urdf.read_text()
    visual = "<visual><geometry><mesh filename={}/></geometry></visual></link>"
    for name in ("../up.obj", "inside/in.obj"):
        mesh = source / name
        mesh.parent.mkdir(exist_ok=True)
        mesh.write_text(TRIANGLE.format(name))
        text = text.replace("</link>", visual.format(f'"{name}"'), 1)
    (source / "cf2x.urdf").write_text(text)
    (tmp_path / "up.obj").write_text(TRIANGLE.format("theirs"))
    before = dataclasses.replace(narrow.before, urdf=source / "cf2x.urdf")
    path = write_urdf(dataclasses.replace(narrow, before=before), folder)
    assert (tmp_path / "up.obj").read_text() == TRIANGLE.format("theirs")
    assert {one.relative_to(folder).as_posix() for one in folder.rglob("*.obj")} == {
        "up.obj",
        "inside/in.obj",
    }
    load_airframe(path)


def test_the_report_tells_all(result, tmp_path):
    markdown, table = write_report(result, tmp_path)
    text = markdown.read_text()
    for name in FOUND:
        assert f"| {name} |" in text
    assert "flight.csv" in text
    assert "| position, horizontal, m |" in text
    assert json.loads(table.read_text()) == json.loads(json.dumps(summarize(result)))


def test_the_same_logs_give_the_same_bits(narrow, log):
    again = identify([log], START, fit=["drag_xy"])
    one, other = ([(each.after, each.high) for each in told.estimates] for told in (narrow, again))
    assert one == other


def test_of_several_logs_every_other_is_kept(flight, tmp_path):
    # The second flies with stronger motors, a marker body that is tilted, and a later clock
    rows = flown.add_sensor_noise(flight, 5)
    rows[:, 11:15] *= 0.98
    logs = [
        flown.write_example_log(tmp_path / "a.csv", flown.add_sensor_noise(flight[:2000], 4)),
        flown.write_example_log(tmp_path / "b.csv", rows[:2000]),
        flown.write_example_log(tmp_path / "c.csv", flown.add_sensor_noise(flight[2000:], 6)),
    ]
    found = identify(logs, TRUE, fit=["drag_xy"])
    assert found.whole_logs
    assert [one.part.flight.log.path.name for one in found.fitted] == ["a.csv", "c.csv"]
    assert [one.part.flight.log.path.name for one in found.kept] == ["b.csv"]
    estimate = found.estimates[0]
    assert estimate.low < TRUE.drag_xy < estimate.high
    gain = {row["log"]: row["gain"] for row in summarize(found)["logs"]}
    assert gain["b.csv"] == pytest.approx(0.98**-2, abs=0.003)
    assert gain["a.csv"] == pytest.approx(1.0, abs=0.003)


def test_a_gyroscope_of_another_clock_and_with_a_bias(flight, tmp_path):
    rows = flown.add_sensor_noise(flight[:2000], 7)
    rows[:, 8:11] = np.roll(rows[:, 8:11], 3, axis=0) + (0.05, -0.03, 0.02)
    found = identify(
        [flown.write_example_log(tmp_path / "late.csv", rows)], TRUE, fit=["inertia_x"]
    )
    (one,) = found.fitted
    assert one.part.flight.gyro_delay == pytest.approx(0.030, abs=0.002)
    np.testing.assert_allclose(one.part.flight.gyro_bias, (0.05, -0.03, 0.02), atol=0.003)
    assert one.delay == pytest.approx(0.020, abs=0.002)
    assert found.estimates[0].low < TRUE.inertia[0] < found.estimates[0].high


@pytest.mark.parametrize("order", [(13, 14, 11, 12), (12, 11, 14, 13), (14, 13, 12, 11)])
def test_rotors_out_of_order_are_refused(flight, tmp_path, order):
    rows = flown.add_sensor_noise(flight[:1500], 8)
    rows[:, 11:15] = rows[:, order]
    log = flown.write_example_log(tmp_path / "swapped.csv", rows)
    said = r"[pqr] changes against .* 1 at x 0\.03253, y -0\.03253 m"
    for start in (TRUE, START):
        with pytest.raises(ValueError, match=said):
            identify([log], start)


def test_few_turns_may_be_opposite_by_chance():
    """The quantile of the normal distribution at 1 - 0.01 / 93 is 3.70115 (tables: 3.70)."""
    assert correlation_threshold(24) == pytest.approx(-math.tanh(3.70 / math.sqrt(21)), abs=1e-3)
    assert -0.2 < correlation_threshold(1000) < 0


def test_ground_effect_is_found_near_the_ground(tmp_path):
    def path(time):
        low = 0.045 + 0.03 * np.sin(2 * np.pi * 0.35 * time)
        return np.array([0.3 * np.sin(0.9 * time), 0.3 * np.cos(0.7 * time), low])

    rows = flown.add_sensor_noise(flown.fly_example(TRUE, 20, seed=1, path=path), 1)
    start = dataclasses.replace(TRUE, ground_effect_gain=0.2, ground_effect_reach=0.2)
    log = flown.write_example_log(tmp_path / "low.csv", rows)
    found = identify([log], start, fit=["ground_effect", "thrust"])
    for one in found.estimates:
        assert one.low <= one.constant.get(TRUE) <= one.high, one.constant.name
        assert one.high - one.low < 0.5 * one.constant.get(TRUE)


def test_the_wake_of_a_drone_above_is_found(tmp_path):
    def above(time):
        return np.array([0.0, 0.0, 1.5])

    def path(time):
        return np.array([0.12 * np.sin(1.1 * time), 0.12 * np.cos(0.8 * time), 1.1])

    rows = flown.add_sensor_noise(flown.fly_example(TRUE, 20, seed=2, path=path, other=above), 2)
    start = dataclasses.replace(TRUE, wake_share=0.2, wake_spread=0.14)
    names = (*flown.COLUMNS, "other_x", "other_y", "other_z")
    log = flown.write_example_log(tmp_path / "below.csv", rows, names)
    found = identify([log], start, fit=["wake", "thrust"])
    for one in found.estimates:
        assert one.low <= one.constant.get(TRUE) <= one.high, one.constant.name
    share = next(one for one in found.estimates if one.constant.name == "wake_share")
    assert share.high - share.low < 0.2 * TRUE.wake_share


def test_the_command_maps_columns_and_writes_files(flight, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    rows = flown.add_sensor_noise(flight[:1500], 9)
    rows[:, 0] *= 1e3
    rows[:, 3] = 1e3 * (rows[:, 3] + 0.03)
    rows[:, 8] = -np.rad2deg(rows[:, 8])
    rows[:, 11:] *= 60 / (2 * np.pi)
    names = ("time", "x", "y", "alt", *flown.COLUMNS[4:8], "gx", "q", "r", "m1", "m2", "m3", "m4")
    flown.write_example_log("log.csv", rows, names)
    motors = [f"rpm{k}=m{k}" for k in (1, 2, 3, 4)]
    maps = ["--map", "t=time*ms", "z=alt*mm-0.03", "p=gx*-deg", *motors]
    main(["identify", "log.csv", "--airframe", "cf2x", "--fit", "drag_xy", *maps, "--out", "out"])
    told = capsys.readouterr()
    assert "drag_xy" in told.out
    assert "wrote out/cf2x.urdf" in told.out
    assert "fitting" in told.err
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "cf2x.urdf",
        "prediction.png",
        "report.json",
        "report.md",
    }
    row = json.loads((tmp_path / "out" / "report.json").read_text())["constants"]["drag_xy"]
    assert row["low"] < TRUE.drag_xy < row["high"]


def test_intervals_hold_with_other_noise(flight, tmp_path):
    """Of ten intervals of 95 % fewer than seven hold once in 10,000 times."""
    start = dataclasses.replace(TRUE, torque_ratio=START.torque_ratio, drag_xy=START.drag_xy)
    inside = 0
    for seed in range(5):
        log = flown.write_example_log(
            tmp_path / f"{seed}.csv", flown.add_sensor_noise(flight[:1400], 20 + seed)
        )
        for one in identify([log], start, fit=["torque_ratio", "drag_xy"]).estimates:
            inside += one.low <= one.constant.get(TRUE) <= one.high
    assert inside >= 7


@pytest.mark.slow
def test_intervals_hold_in_as_many_flights_as_they_say(tmp_path):
    inside = []
    for seed in range(30):
        rows = flown.add_sensor_noise(flown.fly_example(TRUE, 40, seed=100 + seed), seed)
        found = identify([flown.write_example_log(tmp_path / f"{seed}.csv", rows)], START)
        inside += [
            one.low <= one.constant.get(TRUE) <= one.high
            for one in found.estimates
            if one.is_identified
        ]
    assert len(inside) >= 30 * len(FOUND) - 10
    # 95 % of about 330 and three standard deviations; see benchmarks/intervals.py for more
    assert 0.91 < np.mean(inside) < 0.99
