"""IDSIA's benchmark against numbers computed elsewhere, and against flights with known truth."""

import csv
import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bulletuav import load_airframe
from bulletuav.adapters.parquet import write_table
from bulletuav.identification.rollout import Legs, make_track, predict_legs
from bulletuav.reproduction import find_reproduction
from bulletuav.reproduction import nanodrone_data as data
from bulletuav.reproduction import nanodrone_protocol as protocol
from bulletuav.reproduction.nanodrone_model import (
    AIRFRAME_CONSTANTS,
    DELAY,
    FIT_HORIZONS,
    FitObjective,
    NanodroneModel,
    fit_nanodrone_model,
    predict_states,
    shift_speeds,
    weigh_errors,
)
from bulletuav.reproduction.table import Settings
from bulletuav.reproduction.tables import idsia
from bulletuav.vehicle.parameters import parameter_rows

DRONE = load_airframe("cf21B")
STATES = (*data.POSITIONS, *data.QUATERNIONS, *data.VELOCITIES, *data.RATES_BODY)


def simulate(airframe, speed, measured=True):
    """Simulate rotor speeds (n, 4) from rest at 5 m; return the n - 1 states after the first."""
    steps = len(speed) - 1
    first = np.zeros((len(speed), 13))
    first[:, 2], first[:, 6] = 5.0, 1.0
    legs = Legs(np.array([0]), steps, 1, False, measured)
    row = parameter_rows([airframe])[None]
    return predict_legs(legs, make_track(first), speed, speed, row, 0.01)[0]


def wobble(count, seed, airframe=DRONE):
    """Return rotor speeds (count, 4) about hover, by sines of several frequencies, rad/s."""
    rng = np.random.default_rng(seed)
    time = 0.01 * np.arange(count)[:, None]
    speed = np.full((count, 4), airframe.hover_speed())
    for frequency in (0.7, 1.9, 3.1):
        speed += rng.uniform(2, 6, 4) * np.sin(2 * np.pi * frequency * time + rng.uniform(0, 6, 4))
    return speed


def make_flight(seed, count=160, airframe=DRONE):
    speed = wobble(count, seed, airframe)
    states = simulate(airframe, speed)
    return data.NanodroneFlight(f"flight {seed}", states[:-1], speed[1:-1])


def test_best_published_errors_are_those_of_the_issue():
    expected = [
        [0.0013, 0.0126, 0.1119, 2.3223],
        [0.0080, 0.0570, 0.5556, 10.4033],
        [0.0011, 0.0205, 0.2268, 5.1013],
        [0.0796, 0.3596, 0.5979, 28.9873],
    ]
    np.testing.assert_array_equal(idsia.best_published(), expected)


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
    errors = protocol.score_windows(protocol.hold_state(windows), windows)
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
    predicted = protocol.hold_state(windows)
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


def test_intervals_contain_the_mean_of_all_windows():
    rng = np.random.default_rng(1)
    errors = rng.uniform(0, 2, (4000, 50, 4))
    run = np.repeat([0, 1], 2000)
    # Windows before the border of the runs have the errors of another flight, and count
    errors[1951:2000] += 10.0
    errors[-49:, 40:] = np.nan
    low, high = np.moveaxis(idsia.estimate_intervals(errors, run), -1, 0)
    mean = protocol.summarise_errors(errors)
    assert (low < mean).all()
    assert (mean < high).all()
    # One of 8 blocks is 10 * 49 / 500 = 0.98 higher: a deviation of 0.32, of 8 blocks 0.115
    assert (high - low)[0, 0] == pytest.approx(3.92 * 0.115, rel=0.2)


def test_blocks_of_equal_errors_have_intervals_without_width():
    errors = np.ones((2000, 50, 4)) * [1.0, 2.0, 3.0, 4.0]
    # Windows that are left out do not lower the mean
    errors[-49:, 40:] = np.nan
    ends = idsia.estimate_intervals(errors, np.repeat([0, 1], 1000))
    np.testing.assert_allclose(ends[..., 0], protocol.summarise_errors(errors))
    np.testing.assert_allclose(ends[..., 1], protocol.summarise_errors(errors))


def test_models_are_compared_in_the_same_windows():
    # Some windows are far more difficult than others, for both models
    physics = np.repeat(np.arange(1.0, 9.0), 500)[:, None, None] * np.ones((1, 50, 4))
    ours = physics - 0.01
    low, high = np.moveaxis(idsia.compare_intervals(ours, physics, np.zeros(4000, int)), -1, 0)
    is_best = idsia.published_errors("physics") == idsia.best_published()
    assert is_best.sum() == 10
    np.testing.assert_allclose(low[:, :3][is_best[:, :3]], 4.5 - 0.01)
    np.testing.assert_allclose(high[:, :3][is_best[:, :3]], 4.5 - 0.01)
    assert ((high - low)[~is_best] > 2.0).all()


def test_objective_is_chosen_on_trajectories_that_were_left_out(monkeypatch):
    """Errors are a known share of those of the physical model; heights mark trajectories."""
    base = make_flight(5)
    training = {
        name: [dataclasses.replace(base, state=base.state + height * (np.arange(13) == 2))]
        for name, height in (("a", 100.0), ("b", 200.0), ("c", 300.0))
    }
    fitted, tested = [], []

    def marks(windows):
        return set(np.round(windows.state[:, 0, 2], -2))

    def fit(windows, start, names, objective, unit, iterations):
        assert names == (*AIRFRAME_CONSTANTS, DELAY)
        fitted.append(marks(windows))
        return NanodroneModel(start.airframe, objective.scale)

    def predict(model, windows, horizons):
        tested.append(marks(windows))
        true = windows.state[:, 1:]
        return true + model.delay * (protocol.predict_benchmark_physics(windows) - true)

    monkeypatch.setattr(idsia, "fit_nanodrone_model", fit)
    monkeypatch.setattr(idsia, "predict_states", predict)
    objectives = [FitObjective(scale, 1.0, 0.0) for scale in (0.5, 0.2, 0.8)]
    monkeypatch.setattr(idsia, "OBJECTIVES", objectives)
    chosen = idsia.select_objective(training, Settings(0.1), lambda: None)
    assert chosen.objective == objectives[1]
    for one in objectives:
        assert chosen.scores[one] == pytest.approx(one.scale, rel=0.02)
    others = [{200.0, 300.0}, {100.0, 300.0}, {100.0, 200.0}]
    assert fitted == [one for one in others for _ in range(3)]
    assert tested == [{height} for height in (100.0, 200.0, 300.0) for _ in range(3)]


def test_objectives_weigh_velocities_and_late_horizons():
    unit = np.tile([0.5, 1.0, 2.0, 4.0], (len(FIT_HORIZONS), 1))
    plain = weigh_errors(FitObjective(0.3, 3.0, 0.0), unit)
    np.testing.assert_allclose(plain, np.tile([2.0, 3.0, 0.5, 0.25], (len(FIT_HORIZONS), 1)))
    # Horizons of 10 and 50 samples: weights decrease by 5 to the power of the decay
    decaying = weigh_errors(FitObjective(0.3, 1.0, 0.5), unit)
    late, early = [decaying[list(FIT_HORIZONS).index(h), 0] for h in (50, 10)]
    assert early / late == pytest.approx(5**0.5)


def test_drag_explains_only_what_training_flights_do_not_show():
    found = idsia.explain_drag(0.35, 0.1)
    assert found.keys() == {(1, 0), (1, 1)}
    assert "by 0.35 1/s, against 0.10 1/s" in found[1, 0]
    assert idsia.explain_drag(0.2, 0.1) == {}
    assert idsia.explain_drag(-0.1, -0.3) == {}


@pytest.mark.parametrize(("ratio", "has_reason"), [(3.0, True), (2.0, False)])
def test_inertia_explains_only_if_it_is_far_from_the_shipped_one(ratio, has_reason):
    x, y, z = DRONE.inertia
    models = {
        idsia.FREE: NanodroneModel(dataclasses.replace(DRONE, inertia=(ratio * x, 4 * y, z))),
        idsia.SHIPPED: NanodroneModel(dataclasses.replace(DRONE, damping=(44.0, 31.0, 2.0))),
    }
    found = idsia.explain_inertia(models)
    assert found.keys() == ({(2, 0), (2, 1), (3, 0), (3, 1)} if has_reason else set())
    for why in found.values():
        assert "3.0 and 4.0 times the shipped one" in why
        assert "by 44 and 31 1/s" in why


def test_torques_and_rate_changes_give_the_inertia_of_a_simulated_drone():
    drone = dataclasses.replace(DRONE, damping=(0.0, 0.0, 0.0), drag_height=0.0)
    flights = [make_flight(seed, 600, drone) for seed in (1, 2)]
    found = idsia.measure_torque_ratio(flights, drone, idsia.FAST)
    np.testing.assert_allclose(found, drone.inertia[:2], rtol=0.05)
    # Torque that turns nothing, at 1 Hz, is seen only below 2 Hz
    time = 0.01 * np.arange(len(flights[0].speed))
    push = 20 * np.sin(2 * np.pi * time)[:, None] * np.sign([one[1] for one in drone.rotors])
    held = [dataclasses.replace(one, speed=one.speed + push) for one in flights]
    slow, fast = (idsia.measure_torque_ratio(held, drone, one) for one in (idsia.SLOW, idsia.FAST))
    assert slow[0] > 2 * drone.inertia[0]
    np.testing.assert_allclose([slow[1], fast[1]], drone.inertia[1], rtol=0.05)


def test_drag_that_is_too_strong_is_measured():
    windows = protocol.cut_windows([steady_flight(rates=(0, 0, 1.0), velocity=(1.0, 0.5, 0.2))])
    predicted = windows.state[:, 1:].copy()
    assert idsia.measure_drag_excess(predicted, windows) == pytest.approx(0.0, abs=1e-12)
    # All velocities decay by 0.4 1/s
    predicted[..., 7:10] *= 1.0 - 0.4 * 0.01 * np.arange(1, 51)[:, None]
    still = dataclasses.replace(windows, state=windows.state.copy())
    still.state[:, :, 3:7] = [0, 0, 0, 1]
    assert idsia.measure_drag_excess(predicted, still) == pytest.approx(0.4)


def ramp(count=40):
    return 1000.0 + np.tile(np.arange(float(count))[:, None], (1, 4))


@pytest.mark.parametrize("spike", [4e5, 1.2e5, -4e5])
def test_spikes_are_replaced_by_the_next_speeds(tmp_path, spike):
    speed = ramp()
    speed[5, 2] = spike
    cleaned = data.remove_speed_spikes(speed, tmp_path)
    # The jumps before and after the spike remove a sample more on each side
    expected = 1000.0 + np.array([0, 1, 2, 7, 7, 7, 7, 7, 8, 9])
    np.testing.assert_array_equal(cleaned[:10, 0], expected)
    np.testing.assert_array_equal(cleaned[:, 2], cleaned[:, 0])


def test_speeds_above_the_limit_are_spikes_without_a_jump(tmp_path):
    speed = 2.2e5 + ramp()
    speed[20:23, 1] = 3.01e5
    cleaned = data.remove_speed_spikes(speed, tmp_path)
    np.testing.assert_array_equal(cleaned[20:23], np.tile(speed[23], (3, 1)))
    np.testing.assert_array_equal(cleaned[:20], speed[:20])


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


def test_delayed_speeds_stay_within_the_window():
    speed = np.tile(np.arange(50.0)[None, :, None], (1, 1, 4))
    expected = np.clip(np.arange(51) - 0.5, 0, 49)
    np.testing.assert_allclose(shift_speeds(speed, 0.005)[0, :, 0], expected)
    np.testing.assert_allclose(shift_speeds(speed, 0.0)[0, :, 0], np.minimum(np.arange(51), 49))


def test_fit_recovers_known_constants():
    true = dataclasses.replace(
        DRONE,
        thrust_coefficient=1.03 * DRONE.thrust_coefficient,
        inertia=(1.2 * DRONE.inertia[0], *DRONE.inertia[1:]),
    )
    # Speeds that are logged one sample early
    flights = [
        dataclasses.replace(one, state=one.state[:-1], speed=one.speed[1:])
        for one in (make_flight(seed, airframe=true) for seed in (1, 2))
    ]
    windows = protocol.cut_windows(flights, 6)
    unit = np.ones((len(FIT_HORIZONS), 4)) * [0.01, 0.05, 0.02, 0.1]
    names = ["thrust_coefficient", "inertia_x", DELAY]
    start = NanodroneModel(DRONE)
    found = fit_nanodrone_model(windows, start, names, FitObjective(0.3, 1.0, 0.0), unit, 10)
    assert found.airframe.thrust_coefficient == pytest.approx(true.thrust_coefficient, rel=1e-3)
    assert found.airframe.inertia[0] == pytest.approx(true.inertia[0], rel=0.02)
    assert found.airframe.inertia[1:] == DRONE.inertia[1:]
    assert found.delay == pytest.approx(0.01, abs=5e-4)
    predicted = predict_states(found, windows, np.array([50]))
    errors = protocol.compute_state_errors(predicted[:, 0], windows.state[:, 50])
    assert errors.max() < 0.02
    # Without the delay among the names it stays as it is, and fits begin at the initial one
    late = NanodroneModel(DRONE, 0.013)
    for some, iterations in ((names[:1], 5), (names, 1)):
        kept = fit_nanodrone_model(
            windows, late, some, FitObjective(0.3, 1.0, 0.0), unit, iterations
        )
        assert kept.delay == pytest.approx(0.013)


def test_errors_without_weight_do_not_count():
    true = dataclasses.replace(DRONE, inertia=(1.2 * DRONE.inertia[0], *DRONE.inertia[1:]))
    windows = protocol.cut_windows([make_flight(1, airframe=true)], 6)
    # Rates that turn less than the attitude would ask for more inertia
    windows.state[:, 1:, 10:] *= 0.7
    unit = np.ones((len(FIT_HORIZONS), 4)) * [1e9, 0.05, 0.02, 1e9]
    start, names = NanodroneModel(DRONE), ["inertia_x"]
    by_rotation = fit_nanodrone_model(windows, start, names, FitObjective(0.3, 0, 0), unit, 10)
    assert by_rotation.airframe.inertia[0] == pytest.approx(true.inertia[0], rel=0.01)
    unit[:, 3] = 0.1
    by_rates = fit_nanodrone_model(windows, start, names, FitObjective(0.3, 0, 0), unit, 10)
    assert by_rates.airframe.inertia[0] > 1.05 * true.inertia[0]


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


def test_processing_halves_signals_at_the_cut_off_frequencies(tmp_path):
    """A Butterworth filter that runs forwards and backwards has a gain of 1/2 there."""
    time = 0.01 * np.arange(600)

    def tone(frequency):
        return np.sin(2 * np.pi * frequency * time)

    vectors = np.zeros((600, 3))
    vectors[:, 1] = 0.1 * tone(12)
    state = np.concatenate(
        [
            0.2 * np.stack([tone(10), tone(5), tone(10)], axis=1),
            Rotation.from_rotvec(vectors).as_quat(),
            np.tile(tone(18), (3, 1)).T,
            np.tile(tone(18), (3, 1)).T,
        ],
        axis=1,
    )
    speed = 1500.0 + np.tile(10.0 * tone(20), (4, 1)).T
    columns = make_columns(data.NanodroneFlight("tones", state, speed))
    simulated = dict(columns)
    simulated["vx"] = np.full(600, 0.7)
    found = data.process_recording(columns, tmp_path / "tones", simulated, tmp_path / "simulated")
    turned = Rotation.from_quat(found.state[:, 3:7]).as_rotvec()

    def amplitude(values, frequency):
        wave = np.exp(2j * np.pi * frequency * time)
        return abs((wave * values)[100:-100].mean()) * 2

    assert amplitude(found.state[:, 0], 10) == pytest.approx(0.1, rel=0.01)
    # Order 4: 1 / (1 + (tan(0.05 pi) / tan(0.1 pi)) ** 8)
    assert amplitude(found.state[:, 1], 5) == pytest.approx(0.2 * 0.99682, rel=1e-3)
    assert amplitude(turned[:, 1], 12) == pytest.approx(0.05, rel=0.01)
    assert amplitude(found.state[:, 7] - 0.7, 18) == pytest.approx(0.5, rel=0.01)
    assert amplitude(found.state[:, 12], 18) == pytest.approx(0.5, rel=0.01)
    assert amplitude(found.speed[:, 0] - 1500.0, 20) == pytest.approx(5.0, rel=0.01)
    # The mean of the simulated velocity replaces that of the recording, which is 0
    assert found.state[100:-100, 7].mean() == pytest.approx(0.7, abs=1e-3)


def test_gaps_of_recordings_are_filled_and_counted(folder):
    columns = make_columns(make_flight(18))
    columns["wz"][10:12] = np.nan
    stacked = data._stack(columns, ["wz"], folder)
    np.testing.assert_array_equal(stacked[10:12, 0], columns["wz"][12])


def put(name, rows, value):
    """Return a change of columns: a value in some rows of a column."""

    def change(columns):
        columns[name] = columns[name].astype(object if isinstance(value, str) else float)
        columns[name][rows] = value

    return change


def turn_off(columns):
    for name in data.QUATERNIONS:
        columns[name][7] = 0.0


def move_setpoint(columns):
    columns["x_r"] = np.zeros(len(columns["x"]))
    columns["x_r"][0] = 1.0


def shorten(columns):
    columns.update({name: values[:60] for name, values in columns.items()})


def spoil_motors(columns):
    for k in (1, 2, 3, 4):
        columns[f"m{k}_erpm"] = 5e5 + np.arange(len(columns["x"]))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda one: one.pop("wz"), "lacks the column wz"),
        (put("wz", slice(None), np.nan), "100 % of column wz are empty"),
        (put("wz", slice(20), np.nan), "13 % of column wz are empty"),
        (put("vx", 4, np.inf), "row 4 of column vx is inf"),
        (shorten, "has 60 rows: at least 100"),
        (turn_off, "the quaternion of row 7 has length 0, not 1"),
        (put("x_r", slice(None), 2.0), "column x_r is 2 everywhere"),
        (move_setpoint, "overlaps with .* in . samples by x_r: at least 100"),
        (put("m3_erpm", slice(None), 0.0), "column m3_erpm is 0 everywhere"),
        (spoil_motors, "100 % of the motor speeds are spikes, such as 500157 1/min"),
        (
            lambda one: one.update(qx=np.full(len(one["x"]), "a")),
            "row 0 of column qx is 'a', no number",
        ),
    ],
)
def test_damaged_recordings_raise_an_error(folder, change, message):
    columns = make_columns(make_flight(18))
    change(columns)
    path = folder / data.RECORDINGS / data.HELD_OUT[0]
    write_recording(path, columns)
    with pytest.raises(ValueError, match=f"{path.name}.*{message}"):
        data.read_nanodrone_flight(folder, path.name)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda lines: [], "is no table of equal rows: fetch the commit"),
        (lambda lines: [*lines, "1,2"], "is no table of equal rows: fetch the commit"),
        (lambda lines: lines[:1], "has 0 rows: at least 100"),
        (lambda lines: [*lines, "1," + "0," * 16 + "oops,True"], "m4_rads is 'oops', no number"),
        (lambda lines: [*lines, "1,inf," + "0," * 16 + "True"], "column x is inf: fetch"),
        (lambda lines: ["\udcff\udcfe"], "is no table in text: fetch the commit"),
    ],
)
def test_damaged_tables_raise_an_error(folder, change, message):
    path = folder / data.PROCESSED / data.TRAINING["square"][0]
    lines = change(path.read_text().splitlines())
    path.write_bytes("".join(f"{line}\n" for line in lines).encode(errors="surrogateescape"))
    with pytest.raises(ValueError, match=f"{path.name}.*{message}"):
        data.read_nanodrone_flight(folder, path.name)


def test_damaged_parquet_files_raise_an_error(folder):
    path = folder / data.SIMULATED["melon"]
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(ValueError, match="melon_20251017.parquet is damaged: fetch the commit"):
        data.read_nanodrone_flight(folder, data.HELD_OUT[0])


def test_missing_files_raise_an_error_with_the_remedy(folder):
    (folder / data.SIMULATED["melon"]).unlink()
    with pytest.raises(FileNotFoundError, match="fetch the commit"):
        data.read_nanodrone_flight(folder, data.HELD_OUT[0])
    with pytest.raises(ValueError, match="git clone"):
        find_reproduction("idsia").compute(Settings())


@pytest.mark.slow
def test_table_from_simulated_flights(folder, monkeypatch):
    monkeypatch.setattr(idsia, "OBJECTIVES", idsia.OBJECTIVES[:1])
    monkeypatch.setattr(idsia, "FITTED", ("thrust_coefficient", "inertia_x"))
    seen = []
    outcome = idsia.REPRODUCTION.compute(Settings(0.02, folder, progress=seen.append))
    again = idsia.REPRODUCTION.compute(Settings(0.02, folder))
    assert outcome.rows == again.rows
    assert len(outcome.rows) == 64
    assert seen == sorted(seen)
    assert seen[-1] == 1.0
    assert outcome.extra["selection"].keys() == {"(0.3, 1.0, 0.0)"}
    for row in outcome.rows:
        assert (row.low is not None) == row.name.startswith("inertia")
        if row.low is not None:
            assert row.low <= row.ours * (1 + 1e-9)
            assert row.ours <= row.high * (1 + 1e-9)
    excess = outcome.extra["drag_excess"]
    assert excess["inertia as shipped"] != excess["inertia free (effective)"]
    for held_out, training in excess.values():
        assert held_out != training
    assert any("with 2 fitted constants" in note for note in outcome.notes)
    shipped = outcome.extra["constants"]["inertia as shipped"]
    assert shipped.keys() >= {"thrust_coefficient", "inertia_x"}
    assert shipped["inertia_x"] == DRONE.inertia[0]
    # The flights follow the laws of the model, so that its errors are far below the plain ones
    apart = outcome.extra["errors_runs_apart"]
    assert (apart["inertia as shipped"][:2, 1:] < 0.1 * apart["naive"][:2, 1:]).all()
