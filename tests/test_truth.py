"""The judgement by real flights: loaders, windows and splits on small made-up logs; its figures."""

import importlib
import json
import struct
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

BENCHMARKS = Path(__file__).parent.parent / "benchmarks"
G = 9.80665


@pytest.fixture
def part(monkeypatch):
    """Import a file of benchmarks/flight_data."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return lambda name: importlib.import_module(f"flight_data.{name}")


@pytest.fixture
def series(part):
    return part("series")


@pytest.fixture
def nanobench(part):
    return part("nanobench")


@pytest.fixture
def arpl(part):
    return part("arpl")


@pytest.fixture
def swarm(part):
    return part("neural_swarm")


@pytest.fixture
def model(part):
    return part("model")


@pytest.fixture(scope="module")
def measured():
    return json.loads((BENCHMARKS / "flight_data" / "measured.json").read_text())


# Series ------------------------------------------------------------------------------------------


def test_a_lag_is_the_exponential_of_a_first_order_system(series):
    step = np.ones((200, 1))
    step[0] = 0.0
    out = series.first_order_lag(step, 0.065, 0.01)[:, 0]
    assert out[0] == 0.0
    assert out[100] == pytest.approx(1.0 - np.exp(-100 * 0.01 / 0.065))
    assert series.first_order_lag(step, 0.0, 0.01) is step


def test_rotations_are_those_of_scipy(series):
    q = np.random.default_rng(0).normal(size=(20, 4))
    np.testing.assert_allclose(series.rotations(q), Rotation.from_quat(q).as_matrix(), atol=1e-12)


def test_moments_of_single_motors(series):
    # Front right, back right, back left, front left: FLU, so a push in front pitches up (negative).
    expected = [[-0.03, -0.03], [-0.03, 0.03], [0.03, 0.03], [0.03, -0.03]]
    np.testing.assert_allclose(series.moments(np.eye(4), 0.03), expected)


def test_copies_are_dropped_and_the_first_name_stays(series, tmp_path):
    for name, text in (("b", "x"), ("a", "x"), ("c", "y")):
        (tmp_path / name).write_text(text)
    assert [p.name for p in series.without_copies(list(tmp_path.iterdir()))] == ["a", "c"]


def test_the_split_takes_turns(series):
    assert series.split(["a", "b", "c", "d", "e"]) == (["a", "c", "e"], ["b", "d"])


def test_gaps_are_found(series):
    time = np.array([0.0, 0.01, 0.02, 0.09, 0.1])
    found = series.in_gap(time, np.array([0.005, 0.03, 0.08, 0.095]), 0.03)
    assert found.tolist() == [False, True, True, False]


def test_bins_hold_means_and_leave_out_what_is_rare(series):
    x = np.array([0.1, 0.2, 0.3, 1.5])
    rows = series.binned(x, (0.0, 1.0, 2.0), {"x": x, "y": 2 * x}, fewest=2)
    assert rows == [{"x": pytest.approx(0.2), "y": pytest.approx(0.4), "count": 3}]


# NanoBench ---------------------------------------------------------------------------------------


def flight_table(nanobench, seconds=3.0, acceleration=0.0):
    """A level flight at 1 m that speeds up along x, as columns of a file."""
    t = np.arange(0.0, seconds, 0.01)
    table = dict.fromkeys(nanobench.COLUMNS, np.zeros_like(t))
    table |= {"t": t + 1e9, "pz": 1.0 + 0 * t, "qw": 1.0 + 0 * t, "pwr_pm_vbat": 3.7 + 0 * t}
    table |= {"px": 0.5 * acceleration * t * t, "vx": acceleration * t}
    return table | dict.fromkeys(nanobench.MOTORS, 39000.0 + 0 * t)


def write_table(folder, name, table):
    path = folder / "datasets" / "dataset" / f"{name}.csv"
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = np.stack(list(table.values()), axis=1)
    header = ",".join(table)
    np.savetxt(path, rows, delimiter=",", header=header, comments="", fmt="%.9f")
    return path


def test_a_flight_is_read(nanobench, tmp_path):
    flight = nanobench.load(write_table(tmp_path, "B2_a", flight_table(nanobench)))
    assert flight.name == "B2_a"
    assert flight.pwm[0, 0] == pytest.approx(39000 / 65535)
    assert flight.attitude[0] == pytest.approx(np.eye(3))
    assert nanobench.window_starts(flight).tolist() == [0, 50, 100, 150, 200]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.pop("vx"), "no column vx"),
        (lambda t: t["qx"].__setitem__(7, np.nan), "not finite, the first in qx, row 7"),
        (lambda t: t["t"].__setitem__(5, 0.0), "do not rise"),
        (
            lambda t: t["motor_motor_m3"].__setitem__(9, 200000.0),
            "motor commands from 0.60 to 3.05",
        ),
        (lambda t: t["pz"].__imul__(0.2), "never above 0.5 m"),
    ],
)
def test_broken_flights_are_refused(nanobench, series, tmp_path, change, message):
    table = {name: values.copy() for name, values in flight_table(nanobench).items()}
    change(table)
    path = write_table(tmp_path, "B2_broken", table)
    with pytest.raises(series.LogError, match=f"B2_broken: .*{message}"):
        nanobench.load(path)
    write_table(tmp_path, "B2_good", flight_table(nanobench))
    write_table(tmp_path, "B2_same", flight_table(nanobench))
    write_table(tmp_path, "C4_not_of_a_family_that_is_used", flight_table(nanobench))
    flights, refused = nanobench.load_all(tmp_path)
    assert [flight.name for flight in flights] == ["B2_good"]
    assert len(refused) == 1


@pytest.mark.parametrize("fault", ["jump", "gap", "low", "idle"])
def test_windows_leave_out_what_was_not_flown_or_not_seen(nanobench, tmp_path, fault):
    table = flight_table(nanobench)
    if fault == "jump":
        table["px"][70:] += 0.02
    elif fault == "gap":
        table["t"][70:] += 0.05
    elif fault == "low":
        table["pz"][70] = 0.4
    else:
        table["motor_motor_m1"][70] = 0.0
    starts = nanobench.window_starts(nanobench.load(write_table(tmp_path, "B2_a", table)))
    assert 0 in starts
    assert not [s for s in starts if s <= 70 < s + 50]
    assert len(starts) >= 3


def test_a_flight_by_the_law_itself_is_foretold(nanobench, part, tmp_path):
    predictors = part("predictors")
    now = predictors.NOW
    # Level, pushed by nothing but its drag: v falls with the rate of drag at hover.
    rate = now.rotor_drag[0] * now.hover_speed() / now.mass
    table = flight_table(nanobench)
    t = table["t"] - 1e9
    table |= {"vx": 2.0 * np.exp(-rate * t), "px": 2.0 / rate * (1.0 - np.exp(-rate * t))}
    flights = [nanobench.load(write_table(tmp_path, "B2_a", table))]
    without = replace(now, rotor_drag=(0.0, 0.0, 0.0))
    cut = nanobench.windows(flights, now)
    told = nanobench._fly(
        now,
        cut,
        now.thrust(cut.speed).sum(axis=2) / now.mass,
        cut.speed.sum(axis=2),
        np.array([G * now.mass / now.thrust(cut.speed[0, 0]).sum()]),
        np.zeros((1, 2)),
    )
    assert nanobench.errors(cut, *told)[1] < 1e-3
    assert nanobench.errors(cut, *nanobench.constant_velocity(cut))[1] > 0.2
    # Calibration of tilt cannot hide a missing drag wholly: it differs from window to window.
    assert nanobench.errors(cut, *nanobench.predict(without, cut))[1] > 0.03


def test_the_moment_of_drag_is_found_again(nanobench, part, tmp_path):
    now = part("predictors").NOW
    table = {name: x.copy() for name, x in flight_table(nanobench, 20.0).items()}
    t = table["t"] - 1e9
    table["vx"], table["px"] = np.sin(0.3 * t), -np.cos(0.3 * t) / 0.3
    slope = now.drag_height * now.rotor_drag[0] * now.hover_speed()
    # Pitch down is positive: the rear motors (2, 3) push more where it flies forward.
    per_motor = slope * table["vx"] / (4.0 * now.half_arm)
    rear, front = (now.mass * G / 4.0 + sign * per_motor for sign in (1.0, -1.0))
    for name, thrust in zip(nanobench.MOTORS, (front, rear, rear, front), strict=True):
        rpm = np.sqrt(thrust / 2.1885e-8) * 30.0 / np.pi
        table[name] = (rpm - 1900.0) / 6980.0 / 3.7 * 65535.0
    flights = [nanobench.load(write_table(tmp_path, "B2_a", table))]
    velocity, flown, told = nanobench.tilting_moments(flights, now)
    assert np.abs(told).max() == pytest.approx(1e3 * slope * np.abs(velocity).max())
    assert np.abs(flown - told).max() < 0.03 * np.abs(told).max()


# ARPL --------------------------------------------------------------------------------------------


def sd_log_2(columns, rows, events=1):
    head = struct.pack("<BHHH", 0xBC, 2, events, 65535) + b"fixedFrequency\0"
    head += struct.pack("<H", len(columns))
    head += b"".join(f"{name}({kind})".encode() + b"\0" for name, kind in columns)
    body = "<HQ" + "".join(kind for _, kind in columns)
    return head + b"".join(
        struct.pack(body, 65535, 1000 * index + 1, *row) for index, row in enumerate(rows)
    )


@pytest.fixture
def sd_columns(arpl):
    return [(name, "I" if name.startswith("motor") else "f") for name in arpl.COLUMNS]


def hover_rows(count, pwm=40000):
    return [[0.0, 0.0, 1.0, 180.0, 0.0, 0.0, *[pwm] * 4] for _ in range(count)]


def test_a_log_of_a_card_is_read(arpl, sd_columns, tmp_path):
    (tmp_path / "log10").write_bytes(sd_log_2(sd_columns, hover_rows(5)))
    log = arpl.load(tmp_path / "log10")
    assert log.time.tolist() == pytest.approx([0.0, 0.001, 0.002, 0.003, 0.004])
    assert log.force[0].tolist() == pytest.approx([0.0, 0.0, G])
    assert log.rates[0].tolist() == pytest.approx([np.pi, 0.0, 0.0])
    assert log.pwm[0, 0] == pytest.approx(40000 / 65535)


def test_broken_logs_of_a_card_are_refused(arpl, series, sd_columns, tmp_path):
    good = sd_log_2(sd_columns, hover_rows(5))
    not_finite = hover_rows(5)
    not_finite[3][4] = np.nan
    cases = {
        "no log of an SD card": b"\0" + good[1:],
        "version 2 with 3 events": sd_log_2(sd_columns, hover_rows(5), events=3),
        "header cannot be read": good[:60],
        "no column motor.m4": sd_log_2(sd_columns[:-1], [row[:-1] for row in hover_rows(5)]),
        "first in gyro.y, row 3": sd_log_2(sd_columns, not_finite),
        "up to 1.53 of full": sd_log_2(sd_columns, hover_rows(5, pwm=100000)),
        "times of 1 rows": sd_log_2(sd_columns, hover_rows(1)),
    }
    for message, content in cases.items():
        (tmp_path / "log10").write_bytes(content)
        with pytest.raises(series.LogError, match=f"log10: .*{message}"):
            arpl.load(tmp_path / "log10")


def made_up_log(arpl, seconds=12.0):
    time = np.arange(0.0, seconds, 0.001)
    force = np.tile([0.0, 0.0, G], (len(time), 1))
    pwm = np.full((len(time), 4), 0.6)
    return arpl.Log("log10", time, force, np.zeros((len(time), 3)), pwm)


def test_blocks_take_turns_and_gaps_are_left_out(arpl, part, monkeypatch):
    monkeypatch.setattr(arpl, "FLIGHTS", (("log10", 0.5, 11.5),))
    log, now = made_up_log(arpl), part("predictors").NOW
    fit, kept = arpl.windows({"log10": log}, now)
    # Of 11 s: 18 windows end within a block of 5 s, and 2 within the last second.
    assert (len(fit.log), len(kept.log)) == (18 + 2, 18)
    seen = np.ones(len(log.time), dtype=bool)
    seen[2000:2050] = False
    torn = replace(log, **{k: v[seen] for k, v in vars(log).items() if k != "name"})
    fewer, same = arpl.windows({"log10": torn}, now)
    assert len(fit.log) - len(fewer.log) in (2, 3)
    assert len(same.log) == len(kept.log)


def test_rates_follow_torque_and_bias_is_found_again(arpl, part, monkeypatch):
    monkeypatch.setattr(arpl, "FLIGHTS", (("log10", 0.5, 11.5),))
    predictors = part("predictors")
    now = replace(predictors.NOW, rate_damping=(0.0, 0.0, 0.0))
    cut, _ = arpl.windows({"log10": made_up_log(arpl)}, now)
    torque = np.zeros_like(cut.torque)
    torque[:, :, 0] = 1e-5
    cut = replace(cut, torque=torque)
    told = arpl.predict(now, cut, np.zeros((1, 3)))
    np.testing.assert_allclose(told[:, 0], 1e-5 / now.inertia[0] * 0.5, rtol=1e-9)
    turned = replace(cut, torque=0 * torque, end=0 * told + np.array([0.0, 0.2, 0.0]))
    np.testing.assert_allclose(arpl.fitted_bias(now, turned), [[0.0, 0.4, 0.0]], atol=1e-9)
    # Drag that is felt towards -x, above the centre, pitches the nose up: about -y.
    force = np.zeros_like(cut.force)
    force[:, :, 0] = -0.1
    tipped = arpl.predict(now, replace(cut, force=force), np.zeros((1, 3)))
    expected = -0.1 * now.mass * now.drag_height / now.inertia[1] * 0.5
    np.testing.assert_allclose(tipped[:, 1], expected, rtol=1e-3)


def test_the_likeliest_damping_is_found_again_and_sharper_windows_count_more(arpl, part):
    predictors, rng = part("predictors"), np.random.default_rng(0)

    def flown(damping, steps, noise):
        true = replace(predictors.NOW, rate_damping=(damping, damping, 3.0))
        zero = np.zeros((200, steps // arpl.COARSE, 3))
        spin = np.ones((200, steps // arpl.COARSE, 1))
        start = rng.normal(scale=5.0, size=(200, 3))
        cut = arpl.Windows(start, start, zero, zero[..., :2], spin, np.zeros(200, dtype=int))
        end = arpl.predict(true, cut, np.zeros((1, 3))) + rng.normal(scale=noise, size=(200, 3))
        return replace(cut, end=end)

    long = flown(4.0, 200, 0.02)
    assert arpl.likeliest_damping([long], predictors.NOW) == pytest.approx(4.0, abs=0.1)
    # Of two kinds that contradict each other, the one with errors 500 times as small decides.
    sharp = flown(7.0, 100, 0.001)
    found = arpl.likeliest_damping([flown(4.0, 100, 0.5), sharp], predictors.NOW)
    assert found == pytest.approx(7.0, abs=0.1)


# Neural-Swarm ------------------------------------------------------------------------------------


def with_checksum(block):
    return block + struct.pack("<I", zlib.crc32(block) ^ 0xFFFFFFFF)


def sd_log_1(columns, rows, per_set=25):
    head = struct.pack("B", len(columns))
    head += b"".join(f"{name}({kind}),".encode() for name, kind in columns)
    content = with_checksum(head)
    layout = "<" + "".join(kind for _, kind in columns)
    for start in range(0, len(rows), per_set):
        some = rows[start : start + per_set]
        block = struct.pack("B", len(some)) + b"".join(struct.pack(layout, *row) for row in some)
        content += with_checksum(block)
    return content


def swarm_rows(count, height=1000):
    level = 3 << 30
    return [
        [9900 * i + 1, 0, 0, height, 0, 0, 9807, 0, 0, 0, level, *[40000] * 4, 3700]
        for i in range(count)
    ]


@pytest.fixture
def swarm_columns(swarm):
    kinds = {"tick": "I", swarm.STATE + "quat": "I", "pm.vbatMV": "H"}
    return [(name, kinds.get(name, "I" if "pwm" in name else "h")) for name in swarm.COLUMNS]


def test_a_log_of_the_swarm_is_read(swarm, swarm_columns, tmp_path):
    (tmp_path / "cf50_00").write_bytes(sd_log_1(swarm_columns, swarm_rows(60)))
    log = swarm.load(tmp_path / "cf50_00")
    assert log.position[0].tolist() == [0.0, 0.0, 1.0]
    assert log.load[0] == pytest.approx(9.807 / G)
    np.testing.assert_allclose(log.attitude[0], np.eye(3), atol=1e-12)
    assert not log.gap.any()
    u, v = 40000 / 65535, 3.7 / 4.2
    grams = 11.093358 - 39.081042 * u - 9.525647 * v + 20.573302 * u * u + 38.428851 * v * u
    assert log.lift() == pytest.approx(4 * grams, rel=1e-6)


def test_broken_logs_of_the_swarm_are_refused(swarm, series, swarm_columns, tmp_path):
    good = sd_log_1(swarm_columns, swarm_rows(60))
    flipped = bytearray(good)
    flipped[-20] ^= 1
    backwards = swarm_rows(60)[::-1]
    cases = {
        "checksum": bytes(flipped),
        "ends early": good[:-9],
        "header cannot be read": good[:100],
        "no rows": sd_log_1(swarm_columns, []),
        "no column pm.vbatMV": sd_log_1(swarm_columns[:-1], [r[:-1] for r in swarm_rows(60)]),
        "do not rise": sd_log_1(swarm_columns, backwards),
    }
    for message, content in cases.items():
        (tmp_path / "cf50_00").write_bytes(content)
        with pytest.raises(series.LogError, match=f"cf50_00: .*{message}"):
            swarm.load(tmp_path / "cf50_00")


def compress(q):
    """The firmware's quatcompress.h: the largest component is left out, and made positive."""
    largest = int(np.argmax(np.abs(q)))
    packed = largest
    for index in range(4):
        if index != largest:
            negative = (q[index] < 0) != (q[largest] < 0)
            size = int(511 * np.sqrt(2.0) * abs(q[index]) + 0.5)
            packed = (packed << 10) | (int(negative) << 9) | size
    return packed


def test_quaternions_are_decompressed(swarm):
    q = np.random.default_rng(1).normal(size=(200, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    found = swarm.decompress(np.array([compress(row) for row in q], dtype=np.uint32))
    assert (1.0 - np.abs(np.sum(found * q, axis=1))).max() < 1e-5


def made_up_pair(part, count=6000):
    """An upper drone sweeps over a lower one that is pushed and tipped as by the law."""
    swarm, pairs, model = part("neural_swarm"), part("pairs"), part("model")
    time = 0.01 * np.arange(count)
    attitude = np.tile(np.eye(3), (count, 1, 1))
    gap, still = np.zeros(count, dtype=bool), np.zeros((count, 3))
    x = 0.24 * np.sin(0.4 * time)
    above = np.stack([x, 0 * x, 1.4 + 0 * x], axis=1)
    below = np.stack([0 * x, 0 * x, 1.0 + 0 * x], axis=1)
    distance, drop, upper = np.abs(x), np.full(count, 0.4), np.full(count, 33.0)
    push = model.wake_force(distance, drop, upper)
    moment = G * model.wake_moment(distance, drop, upper) * np.sign(x)
    # About +y the side at +x goes down; its motors, 1 and 4, push more against it.
    trim = moment / (4.0 * pairs.HALF_ARM * G)
    thrust = ((33.0 + push) / 4.0)[:, None] + np.stack([trim, -trim, -trim, trim], axis=1)
    level = np.ones(count)
    lower = swarm.Log(time, below, level, still, attitude, thrust, gap)
    thrust = np.full((count, 4), 33.0 / 4.0)
    return lower, swarm.Log(time, above, level, still, attitude, thrust, gap)


def test_push_and_moment_of_a_wake_are_found_again(part, monkeypatch):
    pairs = part("pairs")
    logs = dict(zip("ab", made_up_pair(part), strict=True))
    monkeypatch.setattr(pairs, "load", logs.__getitem__)
    felt = pairs.samples([("a", "b")])
    assert len(felt.push) > 3000
    assert max(pairs.errors(felt, *pairs.now(felt))) < 0.02
    none = np.zeros_like(felt.push)
    assert pairs.errors(felt, none, none)[0] > 3.0
    assert felt.moment.max() == pytest.approx(1.70, abs=0.05)


def test_folders_without_logs_are_refused(part, series, tmp_path):
    for name, find in (("pairs", "runs"), ("ground", "logs")):
        with pytest.raises(series.LogError, match="no (pairs of )?logs"):
            getattr(part(name), find)(tmp_path)


def test_the_ground_effect_is_found_again(part, model, monkeypatch):
    ground, swarm = part("ground"), part("neural_swarm")
    count = 4000
    height = 0.12 - 0.09 * np.cos(0.3 * 0.01 * np.arange(count))
    position = np.stack([0 * height, 0 * height, height + 0.03], axis=1)
    thrust = np.full((count, 4), 33.0 / 4.0) / (1.0 + model.ground_effect(height))[:, None]
    attitude, gap = np.tile(np.eye(3), (count, 1, 1)), np.zeros(count, dtype=bool)
    still = np.zeros((count, 3))
    log = swarm.Log(height, position, np.ones(count), still, attitude, thrust, gap)
    monkeypatch.setattr(ground, "load", lambda path: log)
    found, share = ground.samples(["a"])
    # Free flight, by which the mass is told, is where the law is below 0.15 %.
    assert max(ground.errors(found, share, model.ground_effect(found))) < 0.15


def test_samples_near_touches_are_left_out_unless_they_are_asked_for(part, model, monkeypatch):
    ground, swarm = part("ground"), part("neural_swarm")
    count = 1000
    height = np.where(np.arange(count) < 500, 0.3, 0.08)
    position = np.stack([0 * height, 0 * height, height + 0.03], axis=1)
    load = np.ones(count)
    load[700] = 1.5
    thrust, gap = np.full((count, 4), 33.0 / 4.0), np.zeros(count, dtype=bool)
    attitude, still = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
    log = swarm.Log(height, position, load, still, attitude, thrust, gap)
    asked = []
    monkeypatch.setattr(ground, "load", lambda path, **options: asked.append(options) or log)
    _, share = ground.samples(["a"])
    assert len(share) == 500 - 23
    assert share.max() == pytest.approx(0.0)
    _, share = ground.samples(["a"], force_rows=1, with_touches=True)
    assert len(share) == 500
    assert share.max() == pytest.approx(0.5)
    assert asked == [{}, {"force_rows": 1}]


def test_rates_are_likeliest_with_the_constants_that_made_them(arpl, monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    rates, rng = importlib.import_module("rates"), np.random.default_rng(3)
    zero = np.zeros((300, 40, 3))
    torque = zero + 1e-5 * rng.normal(size=(300, 1, 3))
    start = rng.normal(scale=2.0, size=(300, 3))
    block = np.repeat(np.arange(3), 100)
    empty = np.zeros(300, dtype=int)
    cut = arpl.Windows(start, start, torque, zero[..., :2], zero[..., :1] + 1.0, empty, block)
    true = rates.with_constants(4.0, 0.065, 1.9e-5)
    end = arpl.predict(true, cut, np.zeros((1, 3))) + rng.normal(scale=0.02, size=(300, 3))
    cut = replace(cut, end=end)
    costs = {
        constants: rates.unlikelihood([cut], rates.with_constants(*constants))
        for constants in ((4.0, 0.065, 1.9e-5), (3.0, 0.065, 1.9e-5), (4.0, 0.065, 1.7e-5))
    }
    assert min(costs, key=costs.get) == (4.0, 0.065, 1.9e-5)
    monkeypatch.setattr(arpl, "windows", lambda logs, predictor, steps: (cut, cut))
    squares, counts = rates.squares_of_blocks({}, true, 200)
    assert counts.tolist() == [100, 100, 100]
    assert squares.shape == (3, 2)
    assert np.sqrt(squares.sum(axis=0) / 300) == pytest.approx(0.02, rel=0.15)


# What was measured -------------------------------------------------------------------------------


def wake_errors(measured, law):
    rows = measured["wake"]["bins"]["fit"] + measured["wake"]["bins"]["kept"]
    where = [np.array([row[name] for row in rows]) for name in ("distance", "drop", "upper")]
    push, moment = law(*where)
    flown = [np.array([row[name] for row in rows]) for name in ("push", "moment")]
    # A bin's moment is sure to 0.3 mN m beside the wake, where the trim drifts.
    inside = where[0] < 0.15
    apart = (push - flown[0], (moment - flown[1])[inside])
    return [np.sqrt(np.mean(values**2)) for values in apart], len(rows)


def test_the_law_of_the_wake_meets_the_measured_bins(measured, model, part):
    before = part("predictors").downwash_before
    (push, moment), count = wake_errors(
        measured, lambda d, z, t: (model.wake_force(d, z, t), G * model.wake_moment(d, z, t))
    )
    assert count > 80
    assert push < 0.65
    assert moment < 0.4
    (push, moment), _ = wake_errors(measured, lambda d, z, t: (before(d, z) / G * 1e3, 0 * d))
    assert push > 8.0
    assert moment > 1.0


def test_the_law_of_the_ground_effect_meets_the_measured_bins(measured, model, part):
    rows = measured["ground_effect"]["bins"]["fit"] + measured["ground_effect"]["bins"]["kept"]
    height, share = (np.array([row[name] for row in rows]) for name in ("height", "share"))
    assert np.sqrt(np.mean((model.ground_effect(height) - share) ** 2)) < 0.009
    before = part("predictors").ground_effect_of_gain(height, 11.37)
    assert np.sqrt(np.mean((before - share) ** 2)) > 0.07


def test_the_moment_of_the_drag_meets_the_measured_bins(measured, part):
    now = part("predictors").NOW
    rows = measured["drag_moment"]["bins"]["fit"] + measured["drag_moment"]["bins"]["kept"]
    velocity, moment = (np.array([row[name] for row in rows]) for name in ("velocity", "moment"))
    slope = 1e3 * now.drag_height * now.rotor_drag[0] * now.hover_speed()
    assert np.sqrt(np.mean((slope * velocity - moment) ** 2)) < 0.02
    assert np.sqrt(np.mean(moment**2)) > 0.2


def test_predictions_are_better_than_before_and_meet_their_goals(measured):
    errors = measured["positions"]["errors"]
    assert all(np.array(errors["now"]["kept"]) < [0.015, 0.053, 0.015, 0.056])
    for test in ("positions", "rates"):
        errors = measured[test]["errors"]
        for half in ("fit", "kept"):
            assert all(np.less(errors["now"][half], np.array(errors["before"][half]) * 0.7))
    assert all(np.array(measured["rates"]["errors"]["now"]["kept"]) < [1.9, 1.8, 0.65])


def test_figures_tell_their_source(measured):
    for test in ("positions", "rates", "wake", "ground_effect"):
        source = measured[test]["source"]
        assert len(source["commit"]) == 40
        assert source["licence"]
        assert not set(source["fit"]) & set(source["kept"])


def test_the_command_writes_a_table_and_figures(monkeypatch, tmp_path, capsys):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    truth = importlib.import_module("truth")
    rows = {"none": {"fit": [2.0], "kept": [3.0]}, "now": {"fit": [0.5], "kept": [0.12345]}}
    table = truth.Table("wake", ("push, g",), (0.65,), rows)
    for name in ("positions", "drag_moment", "rates_soon", "rates", "wake", "ground"):
        monkeypatch.setattr(truth, f"judge_{name}", lambda folder, out: (table, {"errors": rows}))
    figures = tmp_path / "measured.json"
    truth.main([str(tmp_path), "--out", str(tmp_path / "out"), "--measured", str(figures)])
    assert "| now | 0.123 (0.5) |" in (tmp_path / "out" / "truth.md").read_text()
    assert "| goal | 0.65 |" in capsys.readouterr().out
    assert json.loads(figures.read_text())["wake"]["errors"] == rows
