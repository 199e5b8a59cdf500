"""NanoBench's table on small made-up flights, whose thrust, tilt and drag are known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bulletuav import load_airframe
from bulletuav.reproduction import find_reproduction
from bulletuav.reproduction.flight_series import LogError, pick_evenly
from bulletuav.reproduction.nanobench_flights import (
    MOTOR_COLUMNS,
    NANOBENCH_COLUMNS,
    NanobenchFlight,
    compute_rotor_commands,
    find_nanobench_flights,
    read_nanobench_flight,
    read_nanobench_flights,
)
from bulletuav.reproduction.nanobench_onboard import (
    ONBOARD_COLUMNS,
    align_positions,
    compute_estimate_errors,
    compute_tracking_errors,
    drop_interpolated_rows,
    find_onboard_logs,
)
from bulletuav.reproduction.nanobench_rollouts import (
    HORIZON,
    RATE_ROWS,
    DroneTrim,
    FlightWindows,
    calibrate_trim,
    compute_channel_errors,
    find_flown_windows,
    hold_rates,
    predict_constant_windows,
    predict_windows,
)
from bulletuav.reproduction.table import Settings
from bulletuav.reproduction.tables import nanobench

G = 9.80665
AIRFRAME = replace(load_airframe("cf2x"), mass=nanobench.FLOWN_MASS)
GAIN = 0.9
"""Factor of the thrust of the made-up drone"""


def hover_pwm(gain=GAIN, volts=3.7):
    """The command at which the thrust is the weight."""
    speed = np.sqrt(AIRFRAME.mass * G / (4 * gain * AIRFRAME.thrust_coefficient))
    return (speed * 30 / np.pi - 1900) / (6980 * volts)


def made_up_flight(seconds=4.0, speed=1.0, course=0.0, tilt=(0.0, 0.0), name="B2_a"):
    """A level flight that its drag slows down, under hover commands.

    Rotors spin at the speed of hover with a lower gain, so that drag is that of this speed.
    """
    t = np.arange(0.0, seconds, 0.01)
    pwm = hover_pwm()
    total = 4 * compute_rotor_commands(np.array(pwm), np.array(3.7))
    rate = AIRFRAME.drag_xy * total / AIRFRAME.mass
    velocity = speed * np.exp(-rate * t)
    along = speed / rate * (1 - np.exp(-rate * t))
    axis = np.array([np.cos(course), np.sin(course), 0.0])
    heading = Rotation.from_euler("z", course)
    quaternion = (heading * Rotation.from_rotvec([*tilt, 0.0]).inv()).as_quat()
    return NanobenchFlight(
        name,
        time=t + 1e9,
        position=np.outer(along, axis) + [0.0, 0.0, 1.0],
        velocity=np.outer(velocity, axis),
        quaternion=np.tile(quaternion, (len(t), 1)),
        rates=np.zeros((len(t), 3)),
        pwm=np.full((len(t), 4), pwm),
        volts=np.full(len(t), 3.7),
    )


def write_flight(folder, flight, change=lambda table: None):
    columns = np.column_stack(
        [
            flight.time,
            flight.position,
            flight.quaternion,
            flight.velocity,
            flight.rates,
            flight.pwm * 65535,
            flight.volts,
        ]
    )
    table = dict(zip(NANOBENCH_COLUMNS, columns.T.copy(), strict=True))
    change(table)
    path = folder / "datasets" / "dataset" / f"{flight.name}.csv"
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = np.stack(list(table.values()), axis=1)
    np.savetxt(path, rows, delimiter=",", header=",".join(table), comments="", fmt="%.9f")
    return path


def test_a_flight_is_read_as_it_was_written(tmp_path):
    flight = made_up_flight()
    read = read_nanobench_flight(write_flight(tmp_path, flight))
    for name, values in vars(flight).items():
        if name != "name":
            np.testing.assert_allclose(getattr(read, name), values, atol=1e-7, err_msg=name)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.pop("imu_gyro_y"), "no column imu_gyro_y"),
        (lambda t: t["qx"].__setitem__(7, np.nan), "first in qx, row 7"),
        (lambda t: t["t"].__setitem__(5, 0.0), "do not rise"),
        (lambda t: t[MOTOR_COLUMNS[2]].__setitem__(9, -6553.5), "from -0.10 to"),
        (lambda t: t["pz"].__imul__(0.2), "never above 0.5 m"),
        (
            lambda t: [t[k].__imul__(0) for k in ("qx", "qy", "qz", "qw")],
            "quaternion of length 0.00",
        ),
        (lambda t: t["qw"].__setitem__(7, 1.5), "a quaternion of length 1.50, not 1"),
        (lambda t: t.update({k: t[k][:0] for k in t}), "times of 0 rows do not rise"),
    ],
)
def test_broken_flights_are_left_out_with_the_reason(tmp_path, change, message):
    path = write_flight(tmp_path, made_up_flight(), change)
    flights, refused = read_nanobench_flights([path])
    assert not flights
    assert len(refused) == 1
    assert refused[0].startswith("B2_a: ")
    assert message in refused[0]


def test_a_torn_file_is_left_out(tmp_path):
    path = write_flight(tmp_path, made_up_flight())
    text = path.read_text()
    path.write_text(text + "1,2,3\n")
    with pytest.raises(LogError, match="B2_a: rows differ in length"):
        read_nanobench_flight(path)


def test_a_folder_without_flights_is_named(tmp_path):
    with pytest.raises(LogError, match="no flights; is it a clone"):
        find_nanobench_flights(tmp_path)


def test_windows_leave_out_rows_on_the_ground_and_gaps():
    flight = made_up_flight()
    flight.position[200:210, 2] = 0.1
    flight.time[330:] += 0.05
    starts = find_flown_windows(flight, 1000).starts
    assert starts[0] == 50
    # A window needs flight from 50 rows before its first row to its last row
    assert starts[starts < 240].max() == 199 - HORIZON
    assert starts[(starts >= 200)].min() == 260
    assert not [s for s in starts if s < 330 <= s + HORIZON]


def test_items_are_picked_evenly():
    assert pick_evenly(np.arange(101), 3).tolist() == [0, 50, 100]
    assert pick_evenly(np.arange(2), 3).tolist() == [0, 1]


def test_errors_are_norms_and_the_angle_between_attitudes():
    flight = made_up_flight(speed=0.0)
    windows = FlightWindows(flight, np.array([60, 100]))
    states = predict_constant_windows(windows)
    states[..., :3] += [0.3, 0.0, 0.4]
    states[..., 7:10] += [0.0, 1.2, 0.5]
    states[..., 3:7] = -(Rotation.from_rotvec([0.0, 2.5, 0.0])).as_quat()
    states[..., 10:] += [2.0, 1.0, 2.0]
    errors = compute_channel_errors(windows, states)
    np.testing.assert_allclose(errors, np.broadcast_to([0.5, 1.3, 2.5, 3.0], errors.shape))


def test_a_flight_by_the_law_itself_is_predicted_and_naive_is_not():
    windows = find_flown_windows(made_up_flight(), 10)
    trim = DroneTrim(gain=GAIN)
    given = compute_channel_errors(windows, predict_windows(windows, AIRFRAME, trim, True))
    naive = compute_channel_errors(windows, predict_constant_windows(windows))
    assert naive[:, -1, 0].min() > 0.1
    # The drag of the body, which the made-up flight lacks, remains
    assert given[:, -1, 0].max() < 0.004
    assert given[:, -1, 1].max() < 0.016


@pytest.mark.parametrize("is_guided", [True, False])
def test_predictions_turn_with_the_world(is_guided):
    trim = DroneTrim(GAIN, (0.01, -0.02), (1e-6, 2e-6, -1e-6))
    errors = []
    for course in (0.0, 2.0):
        windows = FlightWindows(made_up_flight(course=course), np.array([60, 120, 200]))
        states = predict_windows(windows, AIRFRAME, trim, is_guided)
        errors.append(compute_channel_errors(windows, states, trim.tilt))
    np.testing.assert_allclose(errors[0], errors[1], atol=1e-7)
    assert errors[0][:, -1, 1].min() > 0.01


def test_held_rates_stay_and_free_rates_follow_the_torque():
    windows = FlightWindows(made_up_flight(speed=0.0), np.array([60]))
    windows.flight.rates[:] = [0.0, 0.0, 0.5]
    trim = DroneTrim(GAIN, torque=(1e-5, 0.0, 0.0))
    held = predict_windows(windows, hold_rates(AIRFRAME), trim, False)[0, -1]
    np.testing.assert_allclose(held[10:], [0.0, 0.0, 0.5], atol=1e-6)
    angle = Rotation.from_quat(held[3:7]).magnitude()
    assert angle == pytest.approx(0.25, abs=1e-4)
    undamped = replace(AIRFRAME, damping=(0.0, 0.0, 0.0))
    free = predict_windows(windows, undamped, trim, False)[0, 9]
    assert free[10] == pytest.approx(1e-5 / AIRFRAME.inertia[0] * 0.1, rel=0.02)


def test_gain_and_tilt_of_a_drone_are_found_again():
    flights = [
        made_up_flight(speed=speed, course=course, tilt=(0.02, -0.01))
        for speed, course in ((0.5, 0.0), (0.5, np.pi))
    ]
    # Backwards and forwards, so that drag does not look like a tilt
    flights[1].quaternion[:] = flights[0].quaternion
    trim = calibrate_trim([find_flown_windows(flight, 10) for flight in flights], AIRFRAME)
    assert trim.gain == pytest.approx(GAIN, rel=2e-3)
    assert trim.tilt == pytest.approx((0.02, -0.01), abs=2e-3)


def test_the_torque_of_a_drone_is_found_again():
    airframe = replace(AIRFRAME, damping=(0.0, 0.0, 0.0))
    flight = made_up_flight(speed=0.0)
    flight.rates[:, 0] = 0.2 * (flight.time - flight.time[0])
    windows = find_flown_windows(flight, 10)
    trim = calibrate_trim([windows], airframe)
    end = flight.rates[windows.starts + RATE_ROWS]
    for one, expected in ((DroneTrim(trim.gain), 0.02), (trim, 0.0)):
        free = predict_windows(windows, airframe, one, is_guided=False)
        error = np.median(end - free[:, RATE_ROWS - 1, 10:], axis=0)
        # The rotors damp the rates, so that the error without torque is larger
        assert expected - 1e-6 < error[0] < 2 * expected + 1e-6
        np.testing.assert_allclose(error[1:], 0.0, atol=1e-6)
    assert trim.torque[0] > 0.2 * AIRFRAME.inertia[0]


def made_up_log():
    """A circle at 1 m/s, 0.2 s behind its target; estimates are turned by 0.5 rad about z."""
    time = np.arange(0.0, 4.0, 0.01)
    path, target = (
        np.stack([np.cos(t), np.sin(t), np.ones(len(t))], axis=1) for t in (time, time + 0.2)
    )
    log = np.zeros((len(time), len(ONBOARD_COLUMNS)))
    log[:, 0], log[:, 1:4], log[:, 19:22], log[:, -1] = time + 1e9, path, target, 5e4
    log[:, 4:6] = np.stack([-path[:, 1], path[:, 0]], axis=1)
    log[:, 7:10] = [0.1, 0.2, 0.3]
    log[:, 10:13] = Rotation.from_euler("z", 0.5).apply(path) + [3.0, 2.0, 1.0]
    log[:, 13:16] = log[:, 4:7] + [0.03, 0.04, 0.0]
    log[:, 16:19] = np.degrees([0.1, -0.2, 0.3])
    return log


def test_errors_of_estimates_are_those_of_their_definitions():
    log = made_up_log()
    # Rows on the ground do not count
    log[:50, -1], log[:50, 10:19] = 0.0, 99.0
    errors = compute_estimate_errors(log)
    np.testing.assert_allclose(errors[:2], 0.0, atol=1e-9)
    # A turn by 0.5 rad moves the chord of an arc of 1 m by 2 sin(0.25) of its length 2 sin(0.5)
    assert errors[2] == pytest.approx(474.5, rel=0.01)
    assert errors[3] == pytest.approx(0.05)
    # 5.7296 - 0.1, -11.4592 - 0.2 and 17.1887 - 0.3
    assert errors[4] == pytest.approx(12.2863, abs=1e-3)
    assert compute_estimate_errors(log, is_same_unit=True)[4] == pytest.approx(0.0, abs=1e-9)
    log[::2, 12] += 0.006
    assert compute_estimate_errors(log)[:2] == pytest.approx([3.0, 3.0], abs=0.01)


def test_positions_are_aligned_without_reflection():
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]])
    turned = Rotation.from_rotvec([0.3, -2.0, 1.0]).apply(corners) + 5.0
    np.testing.assert_allclose(align_positions(turned, corners), corners, atol=1e-12)
    assert np.abs(align_positions(-corners, corners) - corners).max() > 0.1


def test_tracking_errors_are_those_of_their_definitions():
    log = made_up_log()
    # Rows without target, before and after the flight, do not count
    log[:30, 19:22] = log[-30:, 19:22] = 0.0
    log[:, 9] += 2.0 * np.pi
    errors = compute_tracking_errors(log)
    # The chord of an arc of 0.2 m
    assert errors[:3] == pytest.approx([0.199667] * 3, abs=1e-6)
    # Differences of targets are velocities half a row later: 2 sin(0.205 / 2)
    assert errors[3] == pytest.approx(0.20464, abs=1e-4)
    assert errors[4] == pytest.approx(np.degrees(0.3))
    assert errors[5:] == pytest.approx([0.0, 0.2], abs=1e-9)


@pytest.mark.parametrize(("gap", "rows"), [(20, 400), (100, 201), (250, 201)])
def test_flights_end_at_long_gaps_of_their_estimates(gap, rows):
    log = made_up_log()
    end = min(200 + gap, 399)
    part = np.linspace(0.0, 1.0, end - 199)[:, None]
    log[200 : end + 1, 10:13] = (1 - part) * log[200, 10:13] + part * (log[end, 10:13] + 9.0)
    assert len(drop_interpolated_rows(log)) == rows


def test_onboard_logs_without_flight_end_in_one_clear_error(tmp_path):
    log = made_up_log()
    with pytest.raises(LogError, match="task 3 is shorter than 1 m"):
        compute_estimate_errors(log[:90])
    with pytest.raises(LogError, match="task 2 has 190 rows with a target"):
        compute_tracking_errors(log[:190])
    with pytest.raises(LogError, match="no B9_a.csv, B9_b.csv; is it a clone"):
        find_onboard_logs(tmp_path, ["B9_a.csv", "B9_b.csv"])


def write_onboard_logs(folder):
    """Write one flight of each group of tasks 2 and 3."""
    task = folder / "benchmarks" / "task3_stateEst" / "pid_trefoil"
    task.mkdir(parents=True)
    paths = [task / f"B9_trefoil_{speed}_rep1.csv" for speed in nanobench.ESTIMATES]
    for _, speed, flights in nanobench.TRACKING:
        name = f"B9_trefoil_{speed}_rep{flights[0]}.csv"
        paths.append(folder / "datasets" / "dataset" / name)
    for path in paths:
        np.savetxt(path, made_up_log(), "%.9f", ",", header=",".join(ONBOARD_COLUMNS), comments="")


@pytest.fixture
def clone(tmp_path):
    for k, course in enumerate((0.0, np.pi / 2, np.pi, -np.pi / 2, 0.5, 2.5)):
        flight = made_up_flight(course=course, speed=0.5 + 0.1 * k, name=f"B2_{k}")
        write_flight(tmp_path, flight)
    write_flight(tmp_path, made_up_flight(name="B3_low", speed=0.7), lambda t: t["pz"].__imul__(0))
    write_flight(
        tmp_path, made_up_flight(name="B3_spun"), lambda t: t["imu_gyro_x"].__setitem__(3, 99.0)
    )
    write_onboard_logs(tmp_path)
    return tmp_path


def compute(folder, size=0.05):
    return find_reproduction("nanobench").compute(Settings(size=size, data=folder))


def test_the_table_of_made_up_flights(clone):
    outcome = compute(clone, size=1.0)
    rows = {row.name: row for row in outcome.rows}
    assert len(rows) == 4 * (5 * 4 + 2) + 6 * 7 + 3 * 5 * 3
    assert outcome.extra["gain"] == pytest.approx(GAIN, rel=5e-3)
    refused = [reason.split(":")[0] for reason in outcome.extra["refused"]]
    assert [name for name in refused if not name.startswith("B9_")] == ["B3_low", "B3_spun"]
    naive = rows["naive: position after 0.5 s"]
    assert naive.published == 0.2866
    # Speeds from 0.5 to 1.0 m/s, and 1 m/s, that fall within 4 s
    assert 0.1 < naive.low < naive.ours < naive.high < 0.5
    flown = rows["naive, windows of the predictions: position after 0.5 s"]
    assert flown.published == 0.2866
    assert flown.goal == naive.goal == "equal"
    given = rows["attitude given: position after 0.5 s"]
    assert given.verdict == "unpublished"
    assert given.ours < 0.01
    nominal = rows["rates held, not calibrated: position after 0.5 s (published: physics)"]
    assert nominal.published == 0.6364
    held = rows["rates held: position after 0.5 s (published: best, residual)"]
    assert (held.published, held.verdict) == (0.2282, "better")
    # The thrust of the made-up drone is less than that of the airframe
    assert nominal.ours > 2 * held.ours
    total = rows["rates held: position summed over 50 steps (published: best, physics + residual)"]
    assert total.published == 4.4071
    assert held.ours < total.ours < 50 * held.ours
    estimate = rows["task 3, fast: attitude error, root mean square"]
    assert (round(estimate.ours, 3), estimate.published) == (12.286, 29.67)
    assert rows[estimate.name + ", standard deviation"].ours == 0.0
    assert rows[estimate.name + ", corrected"].ours == pytest.approx(0.0, abs=1e-6)
    tracking = rows["task 2, Mellinger, medium: position error, mean"]
    assert (round(tracking.ours, 6), tracking.published) == (0.199667, 0.269968)
    assert rows["task 2, PID, slow: best delay"].verdict == "unpublished"
    assert outcome.figure.axes[0].get_xlabel() == "prediction horizon, s"
    again = compute(clone, size=1.0)
    assert [(row.ours, row.low, row.high) for row in again.rows] == [
        (row.ours, row.low, row.high) for row in outcome.rows
    ]


def test_a_smaller_size_keeps_the_halves(clone, monkeypatch):
    halves = []

    def keep(flights, refused):
        halves.append({flight.name for flight in flights})
        return list(flights)

    monkeypatch.setattr(nanobench, "_keep_valid_rates", keep)
    compute(clone, size=1.0)
    compute(clone, size=0.05)
    training, tested, some, few = halves
    assert not training & tested
    assert some < training
    assert few < tested


def flat_errors(free, own):
    """Errors of two flights that are the same at all times."""
    sizes = dict.fromkeys((nanobench.NAIVE, nanobench.FLOWN_NAIVE, nanobench.GIVEN), 0.001)
    sizes |= {nanobench.HELD: 1e-3, nanobench.NOMINAL: 1e-3}
    sizes |= {nanobench.FREE: free, nanobench.OWN_TORQUE: own}
    return {name: np.full((2, HORIZON, 4), size) for name, size in sizes.items()}


def test_free_errors_are_explained_only_if_the_torque_of_the_flight_removes_most():
    # Three quarters of the excess over 0.0915 are 0.75
    for own, verdict in ((0.33, "explained"), (0.35, "outside")):
        rows = {row.name: row for row in nanobench._list_rows(flat_errors(1.0915, own))}
        free = rows["free: attitude after 0.5 s (published: best, naive)"]
        assert (free.published, free.verdict) == (0.0915, verdict)
        assert all(row.name.startswith("free: ") for row in rows.values() if row.why)
    rows = nanobench._list_rows(flat_errors(1e-5, 1e-6))
    assert not any(row.why for row in rows)


def test_columns_are_errors_after_steps_and_their_sum():
    values = np.tile(np.arange(1.0, HORIZON + 1)[:, None], (3, 1, 4))
    assert nanobench._sum_up(values)[2, :, 3].tolist() == [1.0, 10.0, 50.0, 1275.0]
    assert len(nanobench.COLUMNS) == 4
    assert nanobench.COLUMNS[1] == "after 0.1 s"


def test_the_best_published_model_of_each_column_is_found():
    velocity = [nanobench.find_best_model(1, column) for column in range(4)]
    assert velocity == ["naive"] * 4
    position = [nanobench.find_best_model(0, column) for column in range(4)]
    assert position == ["physics", "physics + residual", "residual", "physics + residual"]


def test_one_readable_flight_ends_in_one_clear_error(clone):
    for path in sorted((clone / "datasets" / "dataset").glob("*.csv"))[1:]:
        path.write_text("t,px\n0,0\n")
    message = r"in one half of the data, every second readable flight \(none\); fetch"
    with pytest.raises(LogError, match=message):
        compute(clone)


def test_data_without_flight_ends_in_one_clear_error(clone):
    for path in (clone / "datasets" / "dataset").glob("*.csv"):
        path.write_text("t,px\n0,0\n")
    with pytest.raises(LogError, match=r"no flight of half a second .*\(none\).* again"):
        compute(clone)


def test_the_table_agrees_with_the_text_of_the_paper():
    """Section IV-B repeats some of the numbers, rounded."""
    position, velocity, _, rates = (
        {model: channels[k] for model, channels in nanobench.PUBLISHED.items()} for k in range(4)
    )
    assert round(position["physics"][2] / position["naive"][2], 1) == 2.2
    assert round(1e3 * position["physics + residual"][1], 1) == 12.1
    assert round(position["residual"][1] / position["physics + residual"][1], 1) == 3.7
    assert round(position["LSTM"][1] / position["physics + residual"][1], 1) == 2.7
    assert (round(1e3 * velocity["physics"][0]), round(velocity["physics"][2], 2)) == (51, 2.57)
    assert min(position.values(), key=lambda errors: errors[3]) == position["physics + residual"]
    assert (round(rates["LSTM"][2], 2), round(rates["naive"][2], 2)) == (5.15, 0.45)
    assert rates["physics"] == rates["naive"]
