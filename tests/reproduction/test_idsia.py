"""IDSIA's benchmark against numbers computed elsewhere, and against flights with known truth."""

import csv
import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bulletuav import load_airframe
from bulletuav.adapters.parquet import write_table
from bulletuav.identification.rollout import Legs, Track, roll_out
from bulletuav.reproduction import find_reproduction
from bulletuav.reproduction import nanodrone_data as data
from bulletuav.reproduction import nanodrone_protocol as protocol
from bulletuav.reproduction.nanodrone_model import (
    FIT_HORIZONS,
    MEASUREMENT_UNITS,
    FitObjective,
    NanodroneModel,
    fit_nanodrone_model,
    predict_states,
    shift_speeds,
    to_body_state,
    to_measured_state,
)
from bulletuav.reproduction.rotation_vectors import from_rotation_vectors, to_rotation_vectors
from bulletuav.reproduction.table import Settings
from bulletuav.reproduction.tables import idsia
from bulletuav.vehicle.airframe import STANDARD_GRAVITY
from bulletuav.vehicle.parameters import parameter_rows
from bulletuav.vehicle.wakes import Wakes

DRONE = load_airframe("cf21B")
STATES = (*data.POSITIONS, *data.QUATERNIONS, *data.VELOCITIES, *data.RATES_BODY)


def simulate(airframe, speed, torque=(0.0, 0.0, 0.0), lift=0.0, measured=True, start=None):
    """Simulate rotor speeds (n, 4) from rest at 5 m; return the n - 1 states after the first."""
    steps = len(speed) - 1
    first = np.zeros((len(speed), 13))
    first[:, 2], first[:, 6] = 5.0, 1.0
    if start is not None:
        first[0] = start
    states = np.empty((1, steps, 13))
    roll_out(
        Legs(np.array([0]), steps, 1, False, measured),
        Track(
            *(first[:, k].copy() for k in (slice(3), slice(3, 7), slice(7, 10), slice(10, 13))),
            np.zeros((0, 3)),
        ),
        speed,
        speed,
        (0.0, 0.0, 0.0, 1.0),
        torque,
        parameter_rows([airframe])[None],
        0.0,
        STANDARD_GRAVITY,
        0.01,
        Wakes.of(1, 1),
        states,
        lift,
    )
    return states[0]


def wobble(count, seed, airframe=DRONE):
    """Return rotor speeds (count, 4) about hover, by sines of several frequencies, rad/s."""
    rng = np.random.default_rng(seed)
    time = 0.01 * np.arange(count)[:, None]
    speed = np.full((count, 4), airframe.hover_speed())
    for frequency in (0.7, 1.9, 3.1):
        speed += rng.uniform(2, 6, 4) * np.sin(2 * np.pi * frequency * time + rng.uniform(0, 6, 4))
    return speed


def make_flight(seed, count=160, airframe=DRONE, **options):
    speed = wobble(count, seed, airframe)
    states = simulate(airframe, speed, **options)
    return data.NanodroneFlight(f"flight {seed}", states[:-1], speed[1:-1])


def test_best_published_errors_are_those_of_the_issue():
    expected = [
        [0.0013, 0.0126, 0.1119, 2.3223],
        [0.0080, 0.0570, 0.5556, 10.4033],
        [0.0011, 0.0205, 0.2268, 5.1013],
        [0.0796, 0.3596, 0.5979, 28.9873],
    ]
    np.testing.assert_array_equal(idsia.best_published(), expected)


def test_rotation_vectors_are_those_of_scipy():
    turns = Rotation.random(20, random_state=1)
    signs = np.where(np.arange(20) % 2, 1.0, -1.0)[:, None]
    np.testing.assert_allclose(
        to_rotation_vectors(signs * turns.as_quat()), turns.as_rotvec(), atol=1e-12
    )
    again = Rotation.from_quat(from_rotation_vectors(turns.as_rotvec()))
    np.testing.assert_allclose(again.as_matrix(), turns.as_matrix(), atol=1e-12)
    np.testing.assert_array_equal(from_rotation_vectors(np.zeros(3)), [0, 0, 0, 1])
    np.testing.assert_array_equal(to_rotation_vectors(np.array([0.0, 0, 0, 1])), [0, 0, 0])


def steady_flight(rates=(0.0, 0.0, 0.5), velocity=(1.0, 0.0, 0.0), count=120):
    """Return a flight with constant velocity and rates, and thrust equal to the weight."""
    time = 0.01 * np.arange(count)[:, None]
    state = np.concatenate(
        [
            time * velocity,
            Rotation.from_rotvec(time * rates).as_quat(),
            np.tile([*velocity, *rates], (count, 1)),
        ],
        axis=1,
    )
    weight = protocol.BENCHMARK_MASS * protocol.BENCHMARK_GRAVITY
    speed = np.full((count, 4), np.sqrt(weight / 4 / protocol.BENCHMARK_THRUST))
    return data.NanodroneFlight("steady", state, speed)


def test_errors_of_the_plain_models_in_steady_flight():
    windows = protocol.cut_windows([steady_flight()])
    assert windows.state.shape == (70, 51, 13)
    assert windows.speed.shape == (70, 50, 4)
    errors = protocol.score_windows(protocol.predict_constant(windows), windows)
    # 1 m/s and 0.5 rad/s: 0.01 m and 0.005 rad a sample; 1 + ... + 50 = 1275
    np.testing.assert_allclose(
        protocol.summarise_errors(errors),
        [[0.01, 0.1, 0.5, 12.75], [0, 0, 0, 0], [0.005, 0.05, 0.25, 6.375], [0, 0, 0, 0]],
        atol=1e-9,
    )
    physics = protocol.predict_benchmark_physics(windows)
    np.testing.assert_allclose(protocol.score_windows(physics, windows)[0], 0.0, atol=1e-6)


def test_physical_model_in_free_fall_and_at_its_maximum_thrust():
    flight = steady_flight(rates=(0, 0, 0), velocity=(0, 0, 0))
    for speed, acceleration in ((0.0, -9.81), (1e5, 9.81)):
        fast = dataclasses.replace(flight, speed=np.full((120, 4), speed))
        found = protocol.predict_benchmark_physics(protocol.cut_windows([fast]))
        assert found[0, 49, 2] == pytest.approx(0.5 * acceleration * 0.25)
        assert found[0, 49, 9] == pytest.approx(acceleration * 0.5)


def test_notebook_compares_across_runs():
    flights = [steady_flight(), steady_flight(velocity=(2.0, 0.0, 0.0))]
    windows = protocol.cut_windows(flights)
    predicted = protocol.predict_constant(windows)
    notebook = protocol.score_windows(predicted, windows)
    apart = protocol.score_runs_apart(predicted, windows)
    # The last windows of the first run meet the start of the second one; of the second, nothing
    across = np.arange(21, 70)
    assert (notebook[across, 49, 1] == 1.0).all()
    np.testing.assert_array_equal(notebook[:21], apart[:21])
    assert np.isnan(notebook[-49:, 49]).all()
    assert np.isfinite(apart).all()


def test_rotations_beyond_half_a_turn_count_as_in_the_benchmark():
    turned = np.zeros((1, 13))
    turned[0, 3:7] = Rotation.from_rotvec([0, 0, 1.0]).as_quat()
    still = np.zeros((1, 13))
    still[0, 6] = 1.0
    assert protocol.compute_state_errors(turned, still)[0, 2] == pytest.approx(1.0)
    turned[0, 3:7] *= -1
    assert protocol.compute_state_errors(turned, still)[0, 2] == pytest.approx(2 * np.pi - 1.0)


def test_intervals_contain_the_mean_of_all_blocks():
    rng = np.random.default_rng(1)
    errors = rng.uniform(0, 2, (2049, 50, 4))
    ends = idsia.estimate_intervals(errors, np.zeros(2049, int))
    low, high = np.moveaxis(ends, -1, 0)
    mean = protocol.summarise_errors(errors[:-49])
    assert (low < mean).all()
    assert (mean < high).all()
    # Sums of 50 errors with a deviation of 0.58, of 2,000 windows
    assert (high[:, 3] - low[:, 3] < 8 * 0.58 * np.sqrt(50 / 2000)).all()


def test_drag_that_is_too_strong_is_measured():
    windows = protocol.cut_windows([steady_flight(rates=(0, 0, 1.0), velocity=(1.0, 0.5, 0.2))])
    predicted = windows.state[:, 1:].copy()
    assert idsia.measure_drag_excess(predicted, windows) == pytest.approx(0.0, abs=1e-12)
    # All velocities decay by 0.4 1/s
    predicted[..., 7:10] *= 1.0 - 0.4 * 0.01 * np.arange(1, 51)[:, None]
    still = dataclasses.replace(windows, state=windows.state.copy())
    still.state[:, :, 3:7] = [0, 0, 0, 1]
    assert idsia.measure_drag_excess(predicted, still) == pytest.approx(0.4)


def test_spikes_are_replaced_by_the_next_speeds():
    speed = np.tile(np.arange(10.0)[:, None], (1, 4))
    speed[5, 2] = 4e5
    cleaned = data.remove_speed_spikes(speed)
    # The jumps before and after the spike remove a sample more on each side
    np.testing.assert_array_equal(cleaned[:, 0], [0, 1, 2, 7, 7, 7, 7, 7, 8, 9])
    np.testing.assert_array_equal(cleaned[:, 2], cleaned[:, 0])


def test_speeds_are_aligned_with_the_acceleration():
    rng = np.random.default_rng(2)
    thrust = data.smooth_flight(rng.normal(size=(600, 1)), 5.0)[:, 0]
    speed = np.sqrt(100.0 + np.tile(thrust[:, None], (1, 4)))
    aligned = data.align_speeds(np.roll(speed, 3, axis=0), thrust)
    np.testing.assert_allclose(aligned[10:-10], speed[10:-10])


def test_filter_keeps_slow_and_removes_fast_signals():
    time = 0.01 * np.arange(1000)[:, None]
    slow, fast = np.sin(2 * np.pi * time), np.sin(2 * np.pi * 40 * time)
    found = data.smooth_flight(slow + fast, 10.0)
    # Without phase: the slow sine stays where it is
    np.testing.assert_allclose(found[100:-100], slow[100:-100], atol=1e-3)


def test_measured_speeds_fly_as_commands_without_lag():
    drone = dataclasses.replace(DRONE, lag_up=0.0, lag_down=0.0)
    speed = np.tile(drone.hover_speed() * np.array([1.0, 1.001, 1.002, 1.0]), (51, 1))
    np.testing.assert_array_equal(simulate(drone, speed), simulate(drone, speed, measured=False))


def test_accelerating_rotors_turn_the_body():
    # All rotors hover in the mean; those that turn alike speed up together: I dw/dt about z
    rise = 20.0
    turn = np.array([one[2] for one in DRONE.rotors])
    speed = DRONE.hover_speed() + 0.01 * np.arange(3)[:, None] * rise * turn
    bare = dataclasses.replace(DRONE, torque_ratio=1e-9, damping=(0.0, 0.0, 0.0))
    rate = simulate(bare, speed)[1, 12]
    assert rate == pytest.approx(4 * DRONE.rotor_inertia * rise * 0.02 / DRONE.inertia[2], rel=1e-3)


def test_translational_lift_adds_thrust_in_proportion_to_the_square_of_the_speed():
    speed = np.full((2, 4), DRONE.hover_speed())
    gains = []
    for velocity in (1.0, 2.0):
        start = np.array([0, 0, 5.0, 0, 0, 0, 1, velocity, 0, 0, 0, 0, 0])
        rise = [simulate(DRONE, speed, lift=lift, start=start)[0, 9] for lift in (0.0, 0.02)]
        gains.append((rise[1] - rise[0]) / 0.01)
    np.testing.assert_allclose(gains, [0.02 * 9.81, 0.08 * 9.81], rtol=1e-2)
    start = np.array([0, 0, 5.0, 0, 0, 0, 1, 0, 0, 2.0, 0, 0, 0])
    climbing = [simulate(DRONE, speed, lift=lift, start=start)[0, 9] for lift in (0.0, 0.02)]
    assert climbing[0] == climbing[1]


def test_delayed_speeds_stay_within_the_window():
    speed = np.tile(np.arange(50.0)[None, :, None], (1, 1, 4))
    expected = np.clip(np.arange(51) - 0.5, 0, 49)
    np.testing.assert_allclose(shift_speeds(speed, 0.005)[0, :, 0], expected)
    np.testing.assert_allclose(shift_speeds(speed, 0.0)[0, :, 0], np.minimum(np.arange(51), 49))


def test_measurement_is_inverted_to_first_order():
    own = dict.fromkeys(MEASUREMENT_UNITS, 0.0) | {
        "tilt_x": 0.02,
        "gyro_y": 0.05,
        "attitude_offset": 0.004,
        "velocity_offset": 0.003,
        "position_offset": 0.002,
    }
    parameters = parameter_rows([DRONE])[None]
    flight = make_flight(3)
    state, speed = flight.state[40:50], flight.speed[40:50]
    body = to_body_state(state, speed, own, parameters)
    moved = np.abs(body - state).max()
    again = np.abs(to_measured_state(body, speed, own, parameters) - state).max()
    assert moved > 5e-3
    assert again < 0.02 * moved


def test_fit_recovers_known_constants():
    true = dataclasses.replace(DRONE, thrust_coefficient=1.03 * DRONE.thrust_coefficient)
    flights = [make_flight(seed, airframe=true, torque=(2e-5, -1e-5, 0.0)) for seed in (1, 2)]
    biased = [
        dataclasses.replace(one, state=one.state + 0.02 * (np.arange(13) == 11)) for one in flights
    ]
    windows = protocol.cut_windows(biased, 6)
    unit = np.ones((len(FIT_HORIZONS), 4)) * [0.01, 0.05, 0.02, 0.1]
    names = ["thrust_coefficient", "torque_x", "torque_y", "gyro_y"]
    calls = []
    found = fit_nanodrone_model(
        windows,
        NanodroneModel(DRONE, {}),
        names,
        FitObjective(0.3, 1.0, 0.0),
        unit,
        10,
        lambda: calls.append(1),
    )
    assert found.airframe.thrust_coefficient == pytest.approx(true.thrust_coefficient, rel=1e-3)
    assert found.measurement["torque_x"] == pytest.approx(2e-5, rel=0.05)
    assert found.measurement["torque_y"] == pytest.approx(-1e-5, rel=0.05)
    assert found.measurement["gyro_y"] == pytest.approx(0.02, rel=0.02)
    assert len(calls) > 5
    predicted = predict_states(found, windows, np.array([50]))
    errors = protocol.compute_state_errors(predicted[:, 0], windows.state[:, 50])
    assert errors.max() < 5e-3


def write_processed(path, flight):
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["", *STATES, *(f"m{k}_rads" for k in (1, 2, 3, 4)), "is_flying"])
        for k, (state, speed) in enumerate(zip(flight.state, flight.speed, strict=True)):
            writer.writerow([k, *map(repr, map(float, [*state, *speed])), "True"])


def make_columns(flight, erpm=True):
    """Return the columns of a recording."""
    state, speed = flight.state, flight.speed
    columns = dict(zip(STATES, state.T, strict=True))
    # A setpoint by which a recording is aligned with its simulation
    columns["x_r"] = np.sin(0.05 * np.arange(len(state))) * np.arange(len(state))
    if erpm:
        thrust = (speed**2).sum(axis=1) * DRONE.thrust_coefficient / DRONE.mass
        up = Rotation.from_quat(state[:, 3:7]).apply([0, 0, 1])
        columns |= dict(zip(data.ACCELERATIONS, (thrust[:, None] * up).T, strict=True))
        columns |= {f"m{k + 1}_erpm": speed[:, k] / data.ERPM for k in range(4)}
    return {name: np.ascontiguousarray(values) for name, values in columns.items()}


def write_recording(path, columns):
    path.parent.mkdir(parents=True, exist_ok=True)
    write_table(columns, {}, path)


@pytest.fixture
def folder(tmp_path):
    """Return a folder like that of the benchmark, with simulated flights."""
    for k, name in enumerate(data.TRAINING["square"]):
        write_processed(tmp_path / data.PROCESSED / name, make_flight(k))
    recordings = (*data.TRAINING["chirp"], *data.TRAINING["random"], *data.HELD_OUT)
    seeds = {"multisine": 40, "random2": 41, "melon": 42}
    for name in recordings:
        columns = make_columns(make_flight(seeds[name.partition("_")[0]]))
        write_recording(tmp_path / data.RECORDINGS / name, columns)
    for name, path in data.SIMULATED.items():
        # The simulation begins 5 samples later, and is otherwise the recorded flight
        columns = make_columns(make_flight(seeds[name]))
        write_recording(tmp_path / path, {key: values[5:] for key, values in columns.items()})
    return tmp_path


def test_processed_flights_are_read_as_they_are(folder):
    name = data.TRAINING["square"][1]
    found, true = data.read_nanodrone_flight(folder, name), make_flight(1)
    np.testing.assert_allclose(found.state, true.state[:-1], atol=1e-12)
    np.testing.assert_array_equal(found.speed, true.speed[:-1])


def test_recordings_are_aligned_with_the_simulation(folder):
    name, true = data.HELD_OUT[0], make_flight(18)
    write_recording(folder / data.RECORDINGS / name, make_columns(true))
    found = data.read_nanodrone_flight(folder, name)
    assert len(found.state) == len(true.state) - 6
    np.testing.assert_allclose(found.speed[20:-20], true.speed[25:-21], rtol=2e-3)
    # The mean of the simulated flight replaces the recording's own
    shift = (make_flight(42).state - true.state)[5:].mean(axis=0)
    wanted = true.state[25:-21] + shift
    np.testing.assert_allclose(found.state[20:-20, :3], wanted[:, :3], atol=1e-3)
    np.testing.assert_allclose(found.state[20:-20, 10:], wanted[:, 10:], atol=0.05)
    np.testing.assert_allclose(np.linalg.norm(found.state[:, 3:7], axis=1), 1.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda one: one.pop("wz"), "lacks the column wz"),
        (lambda one: one.update(wz=np.full(len(one["x"]), np.nan)), "column wz is not finite"),
        (lambda one: one.update({k: v[:60] for k, v in one.items()}), "has 60 rows: at least 100"),
    ],
)
def test_damaged_recordings_raise_an_error(folder, change, message):
    columns = make_columns(make_flight(18))
    change(columns)
    path = folder / data.RECORDINGS / data.HELD_OUT[0]
    write_recording(path, columns)
    with pytest.raises(ValueError, match=message):
        data.read_nanodrone_flight(folder, data.HELD_OUT[0])


def test_damaged_parquet_files_raise_an_error(folder):
    path = folder / data.SIMULATED["melon"]
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(ValueError, match="melon_20251017.parquet is damaged: fetch the commit"):
        data.read_nanodrone_flight(folder, data.HELD_OUT[0])


def test_gaps_take_the_next_value(folder):
    columns = make_columns(make_flight(18))
    columns["wz"] = columns["wz"].copy()
    columns["wz"][:3] = np.nan
    stacked = data._stack(columns, ["wz"], folder)
    np.testing.assert_array_equal(stacked[:3, 0], columns["wz"][3])


@pytest.mark.parametrize("text", ["", "x,y\n1,2\n3\n"])
def test_damaged_tables_raise_an_error(tmp_path, text):
    path = tmp_path / data.PROCESSED / data.TRAINING["square"][0]
    path.parent.mkdir(parents=True)
    path.write_text(text)
    with pytest.raises(ValueError, match="no table of equal rows: fetch the commit"):
        data.read_nanodrone_flight(tmp_path, path.name)


def test_missing_files_raise_an_error_with_the_remedy(folder):
    (folder / data.SIMULATED["melon"]).unlink()
    with pytest.raises(FileNotFoundError, match="fetch the commit"):
        data.read_nanodrone_flight(folder, data.HELD_OUT[0])
    with pytest.raises(ValueError, match="git clone"):
        find_reproduction("idsia").compute(Settings())


@pytest.mark.slow
def test_table_from_simulated_flights(folder, monkeypatch):
    monkeypatch.setattr(idsia, "OBJECTIVES", idsia.OBJECTIVES[:1])
    monkeypatch.setattr(idsia, "CONSTANT_SETS", {"few": ("thrust_coefficient", "inertia_x")})
    seen = []
    outcome = idsia.REPRODUCTION.compute(Settings(0.02, folder, progress=seen.append))
    again = idsia.REPRODUCTION.compute(Settings(0.02, folder))
    assert outcome.rows == again.rows
    assert len(outcome.rows) == 64
    assert seen == sorted(seen)
    assert seen[-1] == 1.0
    assert outcome.extra["selection"].keys() == {"few, (0.3, 1.0, 0.0)"}
    shipped = outcome.extra["constants"]["inertia as shipped"]
    assert shipped.keys() >= {"thrust_coefficient", "inertia_x"}
    assert shipped["inertia_x"] == DRONE.inertia[0]
    # The flights follow the laws of the model, so that its errors are far below the plain ones
    apart = outcome.extra["errors_runs_apart"]
    assert (apart["inertia as shipped"][:2, 1:] < 0.1 * apart["naive"][:2, 1:]).all()
