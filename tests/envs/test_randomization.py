import numpy as np
import pytest

import bulletuav
from bulletuav.envs.randomization import Randomization, known_uncertainties
from bulletuav.sensors.suite import known_sensors
from bulletuav.tasks import find_task

KNOWN = known_uncertainties(known_sensors())

EVERYTHING = {
    "mass": (0.8, 1.2),
    "thrust": (0.9, 1.1),
    "drag": (0.3, 1.7),
    "motor_lag": (0.5, 2.0),
    "battery": (0.0, 0.1),
    "gps_noise": (0.5, 5.0),
    "gps_walk": (0.0, 0.1),
    "gps_dropout": (0.0, 0.1),
    "wind": (-3.0, 3.0),
    "radio_delay": (0.005, 0.1),
    "radio_loss": (0.0, 0.3),
    "radio_range": (100.0, 200.0),
}


def test_it_is_off_unless_a_difficulty_says_so():
    for task in bulletuav.list_tasks():
        aviary = bulletuav.Aviary(task, difficulty="easy")
        assert aviary.options.randomization == Randomization(None, KNOWN)
        assert not aviary.options.randomization.active
        aviary.close()
    aviary = bulletuav.Aviary("converge", difficulty="extreme", num_drones=4)
    assert set(aviary.options.randomization.active) == set(EVERYTHING)
    aviary.reset(seeds=0)
    assert {name for name in aviary.first_info() if name.startswith("random/")} == {
        f"random/{name}" for name in (*EVERYTHING, "wind_x", "wind_y", "wind_z") if name != "wind"
    }
    aviary.close()


def test_what_is_drawn_is_within_its_range_and_told_and_changes_with_the_episode():
    aviary = bulletuav.Aviary(
        "converge", 30, randomization=EVERYTHING, num_drones=3, dynamics="rigid_body"
    )
    aviary.reset(seeds=0)
    first = aviary.first_info()
    for name, (low, high) in EVERYTHING.items():
        for key in (
            [f"random/wind_{axis}" for axis in "xyz"] if name == "wind" else [f"random/{name}"]
        ):
            values = first[key]
            assert values.shape == (30, 3)
            assert (low <= values).all()
            assert (values <= high).all()
            assert (
                values.min() < low + 0.2 * (high - low) < high - 0.2 * (high - low) < values.max()
            )
            assert (np.ptp(values, axis=1) == 0).all() == name.startswith(("wind", "radio"))
    step = aviary.step(np.zeros((30, 3, 3)))
    np.testing.assert_array_equal(step.info["random/mass"], first["random/mass"])
    aviary.reset()
    assert (aviary.first_info()["random/mass"] != first["random/mass"]).all()
    aviary.reset(seeds=0)
    for name, values in aviary.first_info().items():
        np.testing.assert_array_equal(values, first[name])
    aviary.close()


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body"])
def test_same_seed_same_bits_whatever_was_before_and_whoever_flies_beside(dynamics):
    options = {
        "randomization": EVERYTHING,
        "num_drones": 3,
        "dynamics": dynamics,
        "turbulence": "light",
    }

    def fly(aviary, seeds, world):
        observations = [aviary.reset(seeds=seeds)[world]]
        for k in range(12):
            observations.append(
                aviary.step(np.full((aviary.num_worlds, 3, 3), 0.05 * k)).observations[world]
            )
        return np.array(observations)

    one = bulletuav.Aviary("converge", 2, **options)
    alone = fly(one, [5, 6], 1)
    fly(one, [7, 8], 1)
    np.testing.assert_array_equal(fly(one, [9, 6], 1), alone)
    one.close()


def hover_with(dynamics="bullet", effects=(), **randomization):
    """Vertical acceleration of a cf2x in one decision of 1/30 s.

    All its rotors are at the speed that would hover.
    """
    aviary = bulletuav.Aviary(
        "hover",
        dynamics=dynamics,
        action="hover_rpm",
        effects=effects,
        start_offset=0.0,
        randomization=randomization,
        horizon=10**6,
    )
    aviary.reset(seeds=0)
    aviary.step(np.zeros((1, 1, 4)))
    climb = aviary.swarm.velocity[0, 0, 2] * 30
    return aviary, climb


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body"])
def test_mass_and_thrust_change_the_acceleration_as_newton_says(dynamics):
    g = 9.80665
    for given, expected in (
        ({"mass": 1.2}, g / 1.2 - g),
        ({"thrust": 0.9}, 0.9 * g - g),
        ({"mass": 1.2, "thrust": 1.2}, 0.0),
    ):
        aviary, climb = hover_with(dynamics, **given)
        assert climb == pytest.approx(expected, abs=1e-4 * g)
        aviary.close()


def test_a_heavy_drone_pushes_a_light_one_back_by_momentum():
    """The engine knows the masses: two Crazyflies meet head on, without thrust and gravity."""

    class Meeting(find_task("hover")):
        def spawn(self, rng):
            spawn = super().spawn(rng)
            spawn.velocity[:] = [(1.0, 0, 0), (-1.0, 0, 0)]
            return spawn

    momentum = []
    for mass in (1.0, 3.0):
        aviary = bulletuav.Aviary(
            Meeting,
            num_drones=2,
            gravity=0.0,
            start=((-0.3, 0, 2), (0.3, 0, 2)),
            effects=(),
            randomization={"mass": mass},
        )
        aviary.reset(seeds=0)
        aviary.parameters["mass"][0, 1] = 0.027
        aviary.worlds.engine.set_masses(
            0, aviary.parameters["mass"][0], aviary.parameters["inertia"][0]
        )
        for _ in range(15):
            step = aviary.step(np.full((1, 2, 4), -1.0))
        assert step.info["collision"].any() or not aviary.alive.any()
        momentum.append((aviary.parameters["mass"][0] * aviary.swarm.velocity[0, :, 0]).sum())
        aviary.close()
    np.testing.assert_allclose(momentum, (0.0, 2 * 0.027), atol=2e-3)


def test_drag_and_lag_factors_reach_the_rows_that_fly():
    aviary, _ = hover_with(effects=("lag", "drag"), drag=1.5, motor_lag=2.0)
    airframe = aviary.options.airframe[0]
    assert aviary.parameters["drag_xy"][0, 0] == pytest.approx(1.5 * airframe.drag_xy)
    assert aviary.parameters["lag_up"][0, 0] == pytest.approx(2 * airframe.lag_up)
    aviary.close()


def test_a_battery_weakens_with_time_down_to_half():
    aviary, _ = hover_with(battery=0.5)
    nominal = aviary.options.airframe[0].thrust_coefficient
    aviary.steps[:] = 30 * 60
    aviary.step(np.zeros((1, 1, 4)))
    assert aviary.parameters["thrust_coefficient"][0, 0] == pytest.approx(0.5 * nominal)
    aviary.steps[:] = 30 * 600
    aviary.alive[:] = True
    aviary.step(np.zeros((1, 1, 4)))
    assert aviary.parameters["thrust_coefficient"][0, 0] == pytest.approx(0.5 * nominal)
    aviary.reset(seeds=0)
    aviary.step(np.zeros((1, 1, 4)))
    assert aviary.parameters["thrust_coefficient"][0, 0] == pytest.approx(nominal)
    aviary.close()


def test_wind_of_an_episode_adds_to_the_steady_one():
    aviary = bulletuav.Aviary(
        "hover", 20, wind=(1.0, 2.0, 0.0), randomization={"wind": (-3.0, 3.0)}
    )
    aviary.reset(seeds=0)
    info = aviary.first_info()
    drawn = np.stack([info[f"random/wind_{axis}"] for axis in "xyz"], axis=-1)
    wind = aviary.worlds.wind.sample(aviary.swarm.position, np.zeros(20))
    np.testing.assert_allclose(wind, drawn + (1.0, 2.0, 0.0))
    aviary.close()


def test_gps_noise_is_in_observations_and_not_in_the_state():
    aviary = bulletuav.Aviary(
        "converge", 50, randomization={"gps_noise": 1.5}, dynamics="point_mass"
    )
    observations = aviary.reset(seeds=0)
    error = observations[..., :3] - aviary.swarm.position
    assert error.std() == pytest.approx(1.5, rel=0.05)
    goal = aviary.scene.goal - (aviary.swarm.position + error)
    np.testing.assert_allclose(observations[..., 9], np.linalg.norm(goal, axis=-1), rtol=1e-5)
    neighbour = observations[..., 11:14]  # relative to where both think they are
    known = observations[..., :3]
    offsets = known[:, None] - known[:, :, None]
    nearest = np.argsort(np.linalg.norm(offsets, axis=-1), axis=2)[:, :, 1]
    expected = np.take_along_axis(offsets, nearest[:, :, None, None], axis=2)[:, :, 0]
    np.testing.assert_allclose(neighbour, expected, atol=1e-4)
    state = aviary.state().reshape(50, 8, 17)
    np.testing.assert_allclose(state[..., :3], aviary.swarm.position, atol=1e-4)
    aviary.close()


def test_neighbours_beyond_the_radio_are_not_seen_and_messages_counted():
    options = {
        "num_drones": 4,
        "dynamics": "point_mass",
        "observation": ("neighbours", "all_neighbours"),
    }
    aviary = bulletuav.Aviary("converge", randomization={"radio_range": 120.0}, **options)
    observations = aviary.reset(seeds=0)  # neighbours 113 m apart, antipodes 160 m
    assert aviary.communicates
    np.testing.assert_array_equal((observations[0, :, 0:21:7] > 0).sum(axis=1), 2)
    np.testing.assert_array_equal(
        (observations[0, :, 21:].reshape(4, 3, 6) != 0).all(axis=-1).sum(axis=1), 2
    )
    info = aviary.step(np.zeros((1, 4, 3))).info
    np.testing.assert_array_equal(info["messages"], 2)
    aviary.close()


BAD = [
    ({"gps": 1.0}, "did you mean 'gps_walk' or 'gps_noise'"),
    ({"mass": 0.0}, "randomization mass is 0.0: from low to high within 0.1 and 10"),
    ({"mass": (1.2, 0.8)}, "from low to high"),
    ({"mass": (0.8, 1.0, 1.2)}, "of 2 values"),
    ({"mass": "heavy"}, "randomization mass is 'heavy'"),
    ({"gps_noise": (0.0, float("nan"))}, "is nan: a finite number"),
    ({"radio_loss": 1.5}, "within 0 and 1"),
    ({"radio_range": (10.0, float("inf"))}, "is inf: a finite number"),
    (3.0, "randomization is 3.0: a dict"),
]


@pytest.mark.parametrize(("given", "said"), BAD)
def test_what_cannot_be_is_refused(given, said):
    with pytest.raises(ValueError, match=said):
        bulletuav.Aviary("converge", randomization=given)


def test_a_randomization_object_is_taken_as_it_is():
    spec = Randomization({"gps_noise": 1.0}, KNOWN)
    aviary = bulletuav.Aviary("converge", randomization=spec)
    assert aviary.options.randomization == spec
    assert aviary.options.randomization.ranges == spec.ranges
    assert aviary.options.randomization.active == spec.active == ("gps_noise",)
    aviary.close()


def test_what_is_equal_has_the_same_hash_in_any_order():
    one, other = {"mass": 1.2, "drag": (0.5, 1.5)}, {"drag": (0.5, 1.5), "mass": 1.2}
    assert Randomization(one, KNOWN) == Randomization(other, KNOWN)
    assert hash(Randomization(one, KNOWN)) == hash(Randomization(other, KNOWN))
    assert Randomization(one, KNOWN) != Randomization({"mass": 1.2}, KNOWN)
