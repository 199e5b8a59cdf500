"""The table of downwash on small made-up logs, whose wake is a known fraction of the law's."""

import struct
import zlib
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bulletuav import load_airframe
from bulletuav.reproduction import find_reproduction
from bulletuav.reproduction.flight_series import LogError
from bulletuav.reproduction.swarm_logs import (
    STAND_FITS,
    SWARM_COLUMNS,
    SWARM_STATE,
    SwarmLog,
    compute_stand_thrust,
    is_large_drone,
    read_swarm_log,
)
from bulletuav.reproduction.table import Settings
from bulletuav.reproduction.tables.downwash import ERRORS, _squares, compute_reduction
from bulletuav.reproduction.wake_pairs import (
    DROP_RANGE,
    PAIR_INERTIA,
    align_logs,
    find_log_pairs,
    fit_wake_share,
    measure_wake,
    predict_near_wake,
    predict_wake,
    simulate_height_error,
)
from bulletuav.vehicle.parameters import parameter_rows

ROW = parameter_rows([load_airframe("cf2x")])[0]
KINDS = {"tick": "I", SWARM_STATE + "quat": "I", "pm.vbatMV": "H"}
WEIGHT = 33.0
"""Of the lower drone, grams"""
VOLTS = 3.7


def add_checksum(block):
    return block + struct.pack("<I", zlib.crc32(block) ^ 0xFFFFFFFF)


def write_log(path, rows, columns=SWARM_COLUMNS, per_set=25):
    kinds = [KINDS.get(name, "I" if "pwm" in name else "h") for name in columns]
    head = struct.pack("B", len(columns))
    head += b"".join(f"{name}({kind}),".encode() for name, kind in zip(columns, kinds, strict=True))
    content = add_checksum(head)
    for start in range(0, len(rows), per_set):
        some = rows[start : start + per_set]
        block = struct.pack("B", len(some))
        block += b"".join(struct.pack("<" + "".join(kinds), *row) for row in some)
        content += add_checksum(block)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)


def find_command(grams, drone):
    """Invert the test stand: the command of a motor at a thrust, grams."""
    one, u, v, square, product = STAND_FITS[drone]
    volts = VOLTS / 4.2
    linear = u + product * volts
    rest = one + v * volts - grams
    return (-linear + np.sqrt(linear * linear - 4 * square * rest)) / (2 * square)


def write_pair(folder, names, strength, drop=0.4, count=3000, phase=0.0):
    """An upper drone sweeps over a lower one, which holds its place against the push."""
    time = 0.01 * np.arange(count)
    x = 0.24 * np.sin(0.4 * time + phase)
    upper = 67.0 if is_large_drone(folder / names[0]) else WEIGHT
    push, _ = predict_wake(np.abs(x), np.full(count, drop), np.full(count, upper), ROW)
    flights = (
        (names[0], x, 1.0 + drop, np.full(count, upper)),
        (names[1], np.zeros(count), 1.0, WEIGHT + strength * push),
    )
    for name, along, height, thrust in flights:
        drone = "large" if is_large_drone(folder / name) else "small"
        command = np.round(65535 * find_command(thrust / 4, drone)).astype(int)
        rows = [
            [10000 * i + 1, round(1e3 * along[i]), 0, round(1e3 * height), 0, 0, 9807, 0, i % 7, 0]
            + [3 << 30, *[command[i]] * 4, round(1e3 * VOLTS)]
            for i in range(count)
        ]
        write_log(folder / name, rows)


@pytest.fixture
def clone(tmp_path):
    training = tmp_path / "data" / "training" / "some_day"
    for k in range(2):
        write_pair(training / "swap_ss", (f"cf50_0{k}", f"cf51_0{k}"), strength=0.8, phase=0.7 * k)
        write_pair(training / "swap_sl", (f"cf101_0{k}", f"cf50_0{k}"), strength=0.6, phase=0.7 * k)
    return tmp_path


def test_the_test_stand_is_inverted_by_the_tests():
    for drone, grams in (("small", 8.0), ("large", 16.0)):
        pwm = np.full((1, 4), find_command(grams, drone))
        thrust = compute_stand_thrust(pwm, np.array([VOLTS]), drone)
        np.testing.assert_allclose(thrust, grams)


def test_the_strength_of_a_wake_is_found_again(clone):
    (paths, _) = find_log_pairs(clone, ("swap_ss",))
    first, second = (read_swarm_log(path) for path in paths)
    a, b = align_logs(first, second)
    lower = measure_wake(second, first, b, a)
    assert lower.mass == pytest.approx(WEIGHT, rel=2e-3)
    assert fit_wake_share([lower], ROW) == pytest.approx(0.8 * ROW.wake_share, rel=0.03)
    assert not measure_wake(first, second, a, b).near.any()
    push, moment = predict_near_wake(lower, ROW)
    assert push.max() > 6.0
    assert not push[~lower.near].any()
    assert not moment[~lower.near].any()


def test_a_force_across_is_measured_in_world_axes():
    count = 400
    level, gap = np.tile(np.eye(3), (count, 1, 1)), np.zeros(count, dtype=bool)
    time = 0.01 * np.arange(count)
    position = np.tile([0.0, 0.0, 1.0], (count, 1))
    thrust, still = np.full((count, 4), WEIGHT / 4), np.zeros((count, 3))
    sideways = np.zeros((count, 2))
    sideways[200:] = [0.02, -0.01]
    me = SwarmLog(time, position, np.ones(count), still, level, thrust, gap, sideways)
    above = position + [0.0, 0.0, 0.4]
    above[:200, 0] = 2.0
    other = SwarmLog(time, above, np.ones(count), still, level, thrust, gap, sideways)
    lower = measure_wake(me, other, slice(count), slice(count))
    np.testing.assert_allclose(lower.sideways[:200], 0.0, atol=1e-12)
    np.testing.assert_allclose(lower.sideways[200:], WEIGHT * sideways[200:], atol=1e-12)
    assert lower.near.tolist() == [False] * 200 + [True] * 200
    lower = measure_wake(me, other, slice(50), slice(50))
    assert lower is None


@pytest.mark.parametrize(("apart", "sign"), [((0.0, 0.1), -1.0), ((0.0, -0.1), 1.0)])
def test_a_moment_that_lowers_the_side_towards_the_other_drone_is_positive(apart, sign):
    count = 400
    level, gap = np.tile(np.eye(3), (count, 1, 1)), np.zeros(count, dtype=bool)
    time = 0.01 * np.arange(count)
    position = np.tile([0.0, 0.0, 1.0], (count, 1))
    rates, thrust = np.zeros((count, 3)), np.full((count, 4), WEIGHT / 4)
    # Roll accelerates by 3 rad/s^2: the left side, at +y, rises
    rates[200:, 0] = 3.0 * (time[200:] - time[200])
    me = SwarmLog(time, position, np.ones(count), rates, level, thrust, gap)
    above = position + [*apart, 0.4]
    above[:200, 0] = 2.0
    other = SwarmLog(time, above, np.ones(count), 0 * rates, level, thrust, gap)
    lower = measure_wake(me, other, slice(count), slice(count))
    expected = sign * 1e3 * PAIR_INERTIA * 3.0
    np.testing.assert_allclose(lower.moment[210:390], expected, rtol=1e-9)


def test_all_errors_are_reduced_by_their_own_law(clone):
    first, second = (read_swarm_log(path) for path in find_log_pairs(clone, ("swap_ss",))[0])
    a, b = align_logs(first, second)
    lower = measure_wake(second, first, b, a)
    push, moment = predict_near_wake(lower, ROW)
    across = np.tile([0.3, -0.4], (len(push), 1))
    known = replace(lower, push=push + 1.0, sideways=across, moment=moment + 0.2)
    count = lower.near.sum()
    before = np.sum((push + 1.0)[lower.near] ** 2)
    squares = _squares([known], ROW)
    np.testing.assert_allclose(squares[0], [before, count])
    np.testing.assert_allclose(squares[1], [before + 0.25 * count, 1.25 * count])
    turned = np.sum((moment + 0.2)[lower.near] ** 2)
    np.testing.assert_allclose(squares[3], [turned, 0.04 * count])
    assert turned > 0.2 * count


def test_rows_of_two_logs_have_the_same_times():
    time = 0.01 * np.arange(100)
    empty = np.zeros(0)
    logs = [SwarmLog(t, *[empty] * 6) for t in (time, time[:80] + 0.2)]
    a, b = align_logs(*logs)
    np.testing.assert_allclose(logs[0].time[a], logs[1].time[b])
    # The second log of 80 rows lies within the first one
    assert (a, b) == (slice(20, 100), slice(0, 80))
    b, a = align_logs(*logs[::-1])
    assert (a, b) == (slice(20, 100), slice(0, 80))


def test_logs_without_common_times_end_in_one_clear_error():
    empty = np.zeros(0)
    logs = [SwarmLog(t + 0.01 * np.arange(100), *[empty] * 6) for t in (0.0, 3.0)]
    with pytest.raises(LogError, match=r"0.00 to 0.99 s and 3.00 to 3.99 s; fetch them again"):
        align_logs(*logs)


def test_the_simulated_height_is_that_of_the_differential_equation():
    time = 0.001 * np.arange(3000)
    stiffness, damping = 39.0, 12.5
    force = np.sin(3.0 * time)
    exact = solve_ivp(
        lambda t, s: [s[1], np.sin(3.0 * t) - stiffness * s[0] - damping * s[1]],
        (0.0, 3.0),
        [0.0, 0.0],
        t_eval=time,
        rtol=1e-9,
        atol=1e-12,
    ).y[0]
    found = simulate_height_error(force, stiffness, damping, 0.001)
    np.testing.assert_allclose(found, exact, atol=4e-5)
    # Linear: half of the force gives half of the error
    np.testing.assert_allclose(simulate_height_error(0.5 * force, 39.0, 12.5, 0.001), 0.5 * found)
    rest = simulate_height_error(np.ones(3000), stiffness, damping, 0.001)[-1]
    assert rest == pytest.approx(1.0 / stiffness, rel=1e-3)


def test_reductions_are_of_root_mean_squares():
    assert compute_reduction(np.array([[4.0, 1.0], [1.0, 1.0], [1.0, 4.0]])).tolist() == [
        50.0,
        0.0,
        -100.0,
    ]


def test_the_table_of_made_up_logs(clone):
    table = find_reproduction("downwash")
    outcome = table.compute(Settings(size=0.01, data=clone))
    rows = {row.name: row for row in outcome.rows}
    assert len(rows) == 4 * len(ERRORS)
    shares = outcome.extra["wake_share"]
    assert shares["small above small"] == pytest.approx(0.8 * 0.32, rel=0.04)
    assert shares["large above small"] == pytest.approx(0.6 * 0.32, rel=0.04)
    force = "vertical force (published: vertical tracking of Smith et al.)"
    # The push that is left is 0.2 of 0.8, and 0.4 of 0.6, of the law's
    assert rows[f"small above small: {force}"].ours == pytest.approx(75.0, abs=4.0)
    assert rows[f"large above small: {force}"].ours == pytest.approx(33.3, abs=4.0)
    for name in ("small above small", "large above small"):
        row = rows[f"{name}, strength fitted: {force}"]
        assert row.ours > 90.0
        assert row.published == 56.0
        assert row.verdict == "not comparable"
        assert rows[f"{name}: moment"].verdict == "unpublished"
        height = "height, wake fed forward (published: height of Li et al.)"
        assert rows[f"{name}, strength fitted: {height}"].ours > 90.0
    assert rows[f"large above small: {force}"].low is None, "one flight is held out"
    assert not any(row.why for row in outcome.rows)
    assert outcome.extra["used"] == {"small above small": 1, "large above small": 1}
    assert outcome.extra["left_out"] == {"small above small": [], "large above small": []}
    assert outcome.figure.axes[0].get_xlabel() == "horizontal distance, m"


def test_held_out_flights_that_are_not_used_are_listed(clone):
    place = clone / "data" / "training" / "some_day" / "swap_sl"
    # Held out are the flights 01, 03 and 05
    for k, drop in ((2, 0.4), (3, DROP_RANGE[1] + 0.1), (4, 0.4)):
        write_pair(place, (f"cf101_0{k}", f"cf50_0{k}"), 0.6, drop=drop)
    write_pair(place, ("cf101_05", "cf50_05"), 0.6, count=90)
    outcome = find_reproduction("downwash").compute(Settings(data=clone))
    assert outcome.extra["used"]["large above small"] == 1
    assert outcome.extra["left_out"]["large above small"] == [
        "some_day/swap_sl, cf101_03 and cf50_03: never in the wake",
        "some_day/swap_sl, cf101_05 and cf50_05: less than a second of free flight",
    ]
    assert "1 of 3 of a larger drone and a Crazyflie" in " ".join(outcome.notes)


def test_broken_and_missing_logs_end_in_one_clear_error(clone):
    table = find_reproduction("downwash")
    settings = Settings(size=0.01, data=clone)
    training = clone / "data" / "training" / "some_day"
    broken = training / "swap_ss" / "cf50_00"
    content = broken.read_bytes()
    broken.write_bytes(content[:-9])
    with pytest.raises(LogError, match="cf50_00: a checksum is wrong, or it ends early"):
        table.compute(settings)
    broken.write_bytes(content)
    for path in (training / "swap_sl").iterdir():
        path.unlink()
    with pytest.raises(LogError, match="no pairs of logs of swap_large_small, .* again"):
        table.compute(settings)


def test_drones_that_never_meet_end_in_one_clear_error(tmp_path):
    training = tmp_path / "data" / "training" / "some_day"
    for k in range(2):
        names = (f"cf50_0{k}", f"cf51_0{k}")
        write_pair(training / "swap_ss", names, 0.8, drop=DROP_RANGE[1] + 0.1, count=900)
    with pytest.raises(LogError, match="no drone flew in the wake of another in cf50_00, .* again"):
        find_reproduction("downwash").compute(Settings(size=0.01, data=tmp_path))
    with pytest.raises(LogError, match="no drone flew in the wake"):
        fit_wake_share([], ROW)
