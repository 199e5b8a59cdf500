"""A rate, a delay, noise and losses for any sensor."""

import itertools
import math
from typing import ClassVar

import numpy as np
import pytest
import sensing

import bulletuav
from bulletuav.sensors.base import Image, Label, Sensor, Uncertain
from bulletuav.sensors.gps import Gps
from bulletuav.sensors.imperfect import MAX_DELAY, Imperfect
from bulletuav.sensors.imu import Imu
from bulletuav.sensors.suite import find_sensor

PERIOD = 0.1
NAN, INF = float("nan"), float("inf")


class Place(Sensor):
    """Where a drone is on the level."""

    name = "place"
    numbers = (Label("east", "m", -1e3, 1e3), Label("north", "m", -1e3, 1e3))

    def measure(self, moment):
        return {"place": moment.after.position[..., :2].copy()}


class Counter(Sensor):
    """A picture, a whole number and a truth, which tell the time that its own episode takes."""

    name = "counter"
    gives = ("frame", "ticks", "odd")
    uncertain: ClassVar = {"tick": Uncertain(0.0, 10.0, usual=1.0)}

    def labels(self, setup):
        whole = (Label("ticks", "1", 0.0, 1e3),)
        odd = (Label("odd", "1", 0.0, 1.0),)
        return {"frame": Image(0, 20, np.uint8, ()), "ticks": whole, "odd": odd}

    def attach(self, setup, engine):
        super().attach(setup, engine)
        self.ticks = np.zeros(setup.shape)

    def reset(self, world, swarm, known, rng):
        self.ticks[world] = self.tick[world]

    def measure(self, moment):
        self.ticks += moment.flying[:, None] * self.tick
        whole = self.ticks.astype(np.int64)
        frame = np.repeat(whole[..., None], 6, axis=-1).reshape(*whole.shape, 2, 3)
        return {"frame": frame.astype(np.uint8), "ticks": whole, "odd": whole % 2 == 1}


class Worlds:
    """W worlds of N drones with a sensor, in which drones are at (decision, world) m."""

    def __init__(self, sensor, worlds=1, drones=1, period=PERIOD, seed=0):
        self.sensor = sensing.sensor_of(sensor, (worlds, drones), period=period)
        self.rngs = [np.random.default_rng(seed + k) for k in range(worlds)]
        self.steps = np.zeros(worlds, dtype=int)
        self.drones = drones

    def read(self, mask=None):
        worlds = len(self.steps)
        position = np.zeros((worlds, self.drones, 3))
        position[..., 0], position[..., 1] = self.steps[:, None], np.arange(worlds)[:, None]
        swarm = sensing.swarm_of(worlds, self.drones, position)
        moment = {"mask": mask, "steps": self.steps, "rngs": self.rngs}
        return swarm, sensing.measure(self.sensor, swarm, **moment)

    def reset(self, *chosen):
        """Begin an episode of some worlds, by default of all."""
        chosen = chosen or tuple(range(len(self.steps)))
        self.steps[list(chosen)] = 0
        mask = np.zeros((len(self.steps), self.drones), dtype=bool)
        mask[list(chosen)] = True
        for world in chosen:
            sensing.start(self.sensor, world, sensing.swarm_of(*mask.shape), self.rngs[world])
        return self.read(mask)[1]

    def step(self, *chosen):
        """Fly a decision of some worlds, by default of all."""
        chosen = chosen or tuple(range(len(self.steps)))
        self.steps[list(chosen)] += 1
        mask = np.zeros((len(self.steps), self.drones), dtype=bool)
        mask[list(chosen)] = True
        return self.read(mask)[1]

    def fly(self, decisions, name="place"):
        """(decisions + 1, W, N, ...) readings of an episode of all worlds."""
        return np.array([self.reset()[name]] + [self.step()[name] for _ in range(decisions)])


def times(sensor, decisions=12, **worlds):
    """(decisions + 1,) when what is read after each decision was so, in decisions."""
    return Worlds(sensor, **worlds).fly(decisions)[:, 0, 0, 0]


# Rate


@pytest.mark.parametrize(
    ("rate", "expected"),
    [
        (None, list(range(13))),
        (10, list(range(13))),
        (1000, list(range(13))),  # no more often than decisions
        (5, [0, 0, 2, 2, 4, 4, 6, 6, 8, 8, 10, 10, 12]),
        (2.5, [0, 0, 0, 0, 4, 4, 4, 4, 8, 8, 8, 8, 12]),
        (3, [0, 0, 0, 3, 3, 3, 6, 6, 6, 9, 9, 9, 12]),  # 3.33 decisions are 3
        (0.5, [0] * 13),
    ],
)
def test_readings_stay_between_those_of_the_rate(rate, expected):
    np.testing.assert_array_equal(times(Imperfect(Place(), rate=rate)), expected)


def test_the_rate_is_in_seconds_whatever_the_period():
    assert times(Imperfect(Place(), rate=5), period=0.02)[:12].tolist() == [0] * 10 + [10, 10]


# Delay


@pytest.mark.parametrize(
    ("delay", "late"), [(0.0, 0), (0.1, 1), (0.3, 3), (0.04, 0), (0.06, 1), (0.26, 3)]
)
def test_a_delay_is_exact_in_decisions(delay, late):
    expected = np.maximum(np.arange(13) - late, 0)
    np.testing.assert_array_equal(times(Imperfect(Place(), delay=delay)), expected)


def test_a_delay_is_in_seconds_whatever_the_period():
    expected = np.maximum(np.arange(13) - 5, 0)
    np.testing.assert_array_equal(times(Imperfect(Place(), delay=0.1), period=0.02), expected)


def test_rate_and_delay_add_up():
    """Measured at 0, 4, 8, 12, and told 2 decisions later."""
    seen = times(Imperfect(Place(), rate=2.5, delay=0.2))
    np.testing.assert_array_equal(seen, [0, 0, 0, 0, 0, 0, 4, 4, 4, 4, 8, 8, 8])


def test_delays_of_one_around_another_add_up():
    with pytest.raises(ValueError, match="'place' has its own noise"):
        Imperfect(Imperfect(Place(), rate=5), noise=0.1)
    late = Imperfect(Imperfect(Place(), delay=0.1), delay=0.2)
    np.testing.assert_array_equal(times(late), np.maximum(np.arange(13) - 3, 0))


# Noise


def test_noise_has_the_standard_deviation_asked_for():
    count, drones = 2000, 10
    rows = Worlds(Imperfect(Place(), noise=0.3), drones=drones).fly(count)[:, 0]
    error = rows - np.stack([np.arange(count + 1), np.zeros(count + 1)], axis=-1)[:, None]
    samples = error.size
    assert error.std() == pytest.approx(0.3, rel=5 / math.sqrt(2 * samples))
    assert abs(error.mean()) < 5 * 0.3 / math.sqrt(samples)
    columns = error.reshape(count + 1, -1)
    both = np.concatenate([columns[:-1], columns[1:]], axis=1)  # and from one decision to the next
    correlations = np.corrcoef(both.T) - np.eye(4 * drones)
    assert np.abs(correlations).max() < 5.5 / math.sqrt(count)


def test_each_drone_has_noise_and_loss_of_its_own():
    worlds = Worlds(Imperfect(Place()), worlds=2, drones=2)
    worlds.sensor.noise[:], worlds.sensor.loss[:] = [[0.0, 2.0], [0.0, 0.0]], [[0, 0], [1.0, 0]]
    rows = worlds.fly(4000)
    truth = np.arange(4001.0)
    np.testing.assert_array_equal(rows[:, 0, 0, 0], truth)
    assert (rows[:, 0, 1, 0] - truth).std() == pytest.approx(2, rel=0.06)
    np.testing.assert_array_equal(rows[:, 1, 0, 0], 0)
    np.testing.assert_array_equal(rows[:, 1, 1, 0], truth)


def test_readings_that_are_held_keep_their_noise():
    rows = Worlds(Imperfect(Place(), rate=5, noise=1.0)).fly(8)[:, 0, 0]
    np.testing.assert_array_equal(rows[:-1:2], rows[1::2])
    assert (np.diff(rows[::2] - [(k, 0) for k in range(0, 9, 2)], axis=0) != 0).all()


def test_the_noise_of_a_delayed_reading_is_that_with_which_it_was_measured():
    at_once = Worlds(Imperfect(Place(), noise=1.0)).fly(10)
    late = Worlds(Imperfect(Place(), noise=1.0, delay=0.2)).fly(10)
    np.testing.assert_array_equal(late[2:], at_once[:-2])
    np.testing.assert_array_equal(late[:2], at_once[[0, 0]])


def test_numbers_keep_their_types_and_pictures_their_bounds():
    worlds = Worlds(Imperfect(Counter(), noise=4.0), drones=200)
    rows = [worlds.reset(), *(worlds.step() for _ in range(10))]
    frame, ticks, odd = (np.array([row[name] for row in rows]) for name in Counter.gives)
    assert (frame.dtype, ticks.dtype, odd.dtype) == (np.uint8, np.int64, bool)
    true = np.arange(1, 12).reshape(-1, 1, 1)
    error = ticks - true
    assert error.std() == pytest.approx(4, rel=0.08)
    assert abs(error.mean()) < 0.5
    assert frame.min() == 0  # of 1 - 4, clipped
    assert frame.max() == 20
    np.testing.assert_array_equal(odd, np.broadcast_to(true % 2 == 1, odd.shape))


# Losses


@pytest.mark.parametrize("loss", [0.0, 0.3, 0.9])
def test_as_many_readings_are_lost_as_asked_for_and_the_last_one_stays(loss):
    count, drones = 1000, 20
    rows = Worlds(Imperfect(Place(), loss=loss), drones=drones).fly(count)[:, 0, :, 0]
    moved = np.diff(rows, axis=0) != 0
    share = 1 - moved.mean()
    assert share == pytest.approx(loss, abs=5 * math.sqrt(loss * (1 - loss) / moved.size))
    now = np.arange(1, count + 1)[:, None]
    np.testing.assert_array_equal(rows[1:], np.where(moved, now, rows[:-1]))
    assert loss in (0.0, 1.0) or (moved.any(axis=1) & ~moved.all(axis=1)).any()  # each its own luck


def test_the_first_reading_of_an_episode_comes_and_no_other_when_all_are_lost():
    worlds = Worlds(Imperfect(Place(), loss=1.0, noise=1.0))
    first = worlds.fly(5)
    assert (first == first[0]).all()
    assert (worlds.fly(5)[1:] != first[0]).all()


# Episodes and worlds


def test_a_reset_starts_anew_in_its_own_world_only():
    """World 1 is reset after its fifth decision; world 0 goes on, with its own delay."""
    worlds = Worlds(Imperfect(Place(), delay=0.3), worlds=2)
    worlds.reset()
    for _ in range(5):
        before = worlds.step()["place"][..., 0]
    np.testing.assert_array_equal(before, [[2], [2]])
    np.testing.assert_array_equal(worlds.reset(1)["place"][..., 0], [[2], [0]])
    rows = [worlds.step()["place"][:, 0, 0] for _ in range(6)]
    np.testing.assert_array_equal(np.array(rows).T, [[3, 4, 5, 6, 7, 8], [0, 0, 0, 1, 2, 3]])


def test_a_reset_keeps_what_others_hold_and_when_they_measure():
    worlds = Worlds(Imperfect(Place(), rate=2.5), worlds=2)
    worlds.reset()
    for _ in range(6):
        worlds.step()
    np.testing.assert_array_equal(worlds.reset(0)["place"][..., 0], [[0], [4]])
    rows = [worlds.step()["place"][:, 0, 0] for _ in range(6)]
    np.testing.assert_array_equal(np.array(rows).T, [[0, 0, 0, 4, 4, 4], [4, 8, 8, 8, 8, 12]])


def test_worlds_that_do_not_fly_keep_their_readings():
    worlds = Worlds(Imperfect(Place(), delay=0.1, noise=0.5), worlds=2)
    worlds.reset()
    before = worlds.step()["place"].copy()
    for _ in range(3):
        after = worlds.step(0)["place"]
    np.testing.assert_array_equal(after[1], before[1])
    assert (after[0] != before[0]).all()


def test_a_moment_at_which_nobody_measures_is_no_error():
    worlds = Worlds(Imperfect(Place(), delay=0.2, noise=1.0), worlds=2)
    nobody = np.zeros((2, 1), dtype=bool)
    assert worlds.read(nobody)[1]["place"].shape == (2, 1, 2)
    first = worlds.reset()["place"]
    np.testing.assert_array_equal(worlds.read(nobody)[1]["place"], first)


def test_readings_are_of_the_moment_and_not_changed_later():
    worlds = Worlds(Imperfect(Place(), delay=0.1))
    first = worlds.reset()["place"]
    for _ in range(4):
        worlds.step()
    np.testing.assert_array_equal(first[0, 0], (0, 0))


def test_worlds_draw_from_their_own_generators_only():
    def fly(seeds):
        worlds = Worlds(Imperfect(Place(), noise=1.0, loss=0.3, rate=5, delay=0.1), worlds=2)
        worlds.rngs = [np.random.default_rng(seed) for seed in seeds]
        return worlds.fly(20), worlds.rngs

    (one, rngs), (other, others) = fly((1, 2)), fly((5, 2))
    np.testing.assert_array_equal(one[:, 1], other[:, 1])
    assert (one[:, 0, :, 0] != other[:, 0, :, 0]).any()
    assert rngs[1].random() == others[1].random()
    alone = Worlds(Imperfect(Place(), noise=1.0, loss=0.3, rate=5, delay=0.1), seed=2)
    np.testing.assert_array_equal(alone.fly(20)[:, 0, :, 0], one[:, 1, :, 0])


def test_without_noise_and_loss_nothing_is_drawn():
    worlds = Worlds(Imperfect(Place(), rate=5, delay=0.2), worlds=2)
    worlds.sensor.noise[1] = 1.0
    worlds.fly(10)
    assert worlds.rngs[0].random() == np.random.default_rng(0).random()
    assert worlds.rngs[1].random() != np.random.default_rng(1).random()


def test_an_object_is_a_description_of_which_each_environment_has_a_copy():
    imperfect = Imperfect(Counter(), delay=0.1)
    one, other = Worlds(imperfect), Worlds(imperfect)
    one.fly(3, "ticks")
    assert other.reset()["ticks"] == 1
    assert not hasattr(imperfect.sensor, "ticks")


# What is wrapped


def test_what_is_wrapped_runs_its_own_time_at_any_rate():
    """Its ticks are counted at each decision, though they are told at every fifth."""
    rows = Worlds(Imperfect(Counter(), rate=2)).fly(11, "ticks")[:, 0, 0]
    np.testing.assert_array_equal(rows, [1] * 5 + [6] * 5 + [11] * 2)


def test_biases_walk_as_far_at_any_rate():
    """After a second 0.3 m/s^2 by their definition, whether read ten times or twice."""
    drones, spread = 2000, {}
    for rate in (None, 2):
        worlds = Worlds(Imperfect(Imu(), rate=rate), drones=drones)
        worlds.sensor.accelerometer_walk[:] = 0.3
        spread[rate] = worlds.fly(10, "imu")[-1, 0, :, :2].std()
    assert spread[2] == pytest.approx(0.3, rel=5 / math.sqrt(4 * drones))
    assert spread[2] == spread[None]


def test_what_was_drawn_for_the_wrapped_sensor_reaches_it_before_its_first_reset():
    worlds = Worlds(Imperfect(Counter()), drones=2)
    worlds.sensor.tick = np.array([[2.0, 3.0]])  # as environments put it there
    np.testing.assert_array_equal(worlds.fly(2, "ticks")[:, 0], [(2, 3), (4, 6), (6, 9)])


@pytest.mark.parametrize(
    ("sensor", "expected"),
    [
        ("clearance", {"clearance_noise", "clearance_loss"}),
        ("lidar", {"lidar_noise", "lidar_dropout", "lidar_loss"}),
        ("gps", {"gps_noise", "gps_walk", "gps_dropout", "gps_loss"}),
        ("radio", {"radio_delay", "radio_loss", "radio_range", "radio_noise"}),
        (
            "imu",
            {
                "accelerometer_noise",
                "accelerometer_walk",
                "gyroscope_noise",
                "gyroscope_walk",
                "imu_noise",
                "imu_loss",
            },
        ),
    ],
)
def test_parameters_keep_the_names_that_they_have_without_it(sensor, expected):
    imperfect = Imperfect(find_sensor(sensor), rate=5)
    assert {f"{imperfect.prefix}{key}" for key in imperfect.uncertain} == expected
    assert imperfect.name == sensor
    assert imperfect.gives == find_sensor(sensor).gives
    assert imperfect.needs_bodies == find_sensor(sensor).needs_bodies
    assert imperfect.always_if_uncertain == find_sensor(sensor).always_if_uncertain


# Mistakes


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"rate": 0}, "rate is 0: at least 0.001"),
        ({"rate": -5.0}, "rate is -5: at least"),
        ({"rate": INF}, "rate is inf: a finite number"),
        ({"rate": "often"}, "rate is 'often': a finite number"),
        ({"rate": True}, "rate is True: a finite number"),
        ({"delay": -0.1}, "delay is -0.1: at least 0"),
        ({"delay": NAN}, "delay is nan: a finite number"),
        ({"delay": 10 * MAX_DELAY}, "delay is 100: at most 10"),
        ({"noise": -1.0}, "noise is -1: at least 0"),
        ({"noise": NAN}, "noise is nan: a finite number"),
        ({"noise": 1e9}, "noise is 1e.09: at most"),
        ({"noise": None}, "noise is None: a finite number"),
        ({"noise": (0.1, 0.2)}, r"noise is \(0.1, 0.2\): a finite number"),
        ({"loss": 1.5}, "loss is 1.5: at most 1"),
        ({"loss": -0.1}, "loss is -0.1: at least 0"),
        ({"loss": 10**400}, "loss is .*: a finite number"),
    ],
)
def test_wrong_numbers_are_refused(given, said):
    with pytest.raises(ValueError, match=said):
        Imperfect(Place(), **given)


@pytest.mark.parametrize("sensor", [Place, "lidar", None, 5])
def test_only_sensors_are_wrapped(sensor):
    with pytest.raises(ValueError, match="an object derived from Sensor is needed"):
        Imperfect(sensor)


@pytest.mark.parametrize(
    ("sensor", "given"), [("gps", "noise"), ("lidar", "noise"), ("radio", "loss")]
)
def test_a_sensor_with_its_own_noise_or_loss_keeps_that(sensor, given):
    with pytest.raises(ValueError, match=f"sensor '{sensor}' has its own {given}: set it there"):
        Imperfect(find_sensor(sensor), **{given: 0.1})


# In environments

ALL = {"rate": 5, "delay": 0.2, "noise": 0.1, "loss": 0.2}
WRAPPED = {
    "place": (Place(), ALL, {}),
    "counter": (Counter(), ALL, {}),
    "clearance": (find_sensor("clearance"), ALL, {}),
    "imu": (find_sensor("imu"), ALL, {"randomization": {"gyroscope_walk": 0.1, "imu_noise": 0.2}}),
    "camera": (find_sensor("camera"), ALL, {"camera_size": (16, 12)}),
    "lidar": (find_sensor("lidar"), {**ALL, "noise": 0}, {"randomization": {"lidar_noise": 1.0}}),
    "gps": (
        find_sensor("gps"),
        {**ALL, "noise": 0},
        {"observation": ("position", "velocity"), "randomization": {"gps_noise": (0.5, 1.0)}},
    ),
    "radio": (find_sensor("radio"), {**ALL, "loss": 0}, {"observation": ("neighbours",)}),
    "sight": (find_sensor("sight"), ALL, {"observation": ("velocity",)}),
}


@pytest.mark.parametrize("name", WRAPPED)
def test_it_is_a_sensor_as_any_other(name):
    sensor, given, options = WRAPPED[name]
    bulletuav.check_sensor(Imperfect(sensor, **given), **options)


@pytest.fixture
def aviary():
    """Builds environments and closes them."""
    made = []

    def make(task, num_worlds=1, **options):
        made.append(bulletuav.Aviary(task, num_worlds, dynamics="point_mass", **options))
        return made[-1]

    yield make
    for one in made:
        one.close()


def test_an_environment_shows_places_of_its_own_past(aviary):
    """At 5 Hz and 0.3 s late, at 10 decisions a second, also where one of two worlds is reset."""
    sensor = Imperfect(Place(), rate=5, delay=0.3)
    one = aviary("converge", 2, num_drones=3, sensors=(sensor,), observation=("place",))
    rng, past = np.random.default_rng(0), [[], []]
    observations = one.reset(seeds=0)
    for k in range(25):
        for world in (0, 1):
            past[world].append(one.swarm.position[world, :, :2].copy())
            then = max(len(past[world]) - 1 - 3, 0)
            expected = past[world][then - then % 2]
            np.testing.assert_allclose(observations[world], expected, rtol=1e-6)
        if k == 11:
            past[1] = []
            observations = one.reset(np.array([False, True]))
            past[1].append(one.swarm.position[1, :, :2].copy())
            np.testing.assert_allclose(observations[1], past[1][0], rtol=1e-6)
        observations = one.step(rng.uniform(-1, 1, (2, 3, 3))).observations


def test_noise_and_loss_are_drawn_for_each_episode(aviary):
    ranges = {"place_noise": (0.5, 2.0), "place_loss": (0.1, 0.2)}
    one = aviary(
        "hover",
        50,
        action="velocity",
        num_drones=2,
        sensors=(Imperfect(Place(), noise=9.0),),
        observation="place",
        randomization=ranges,
    )
    error = one.reset(seeds=0) - one.swarm.position[..., :2]
    info = one.first_info()
    for name, (low, high) in ranges.items():
        drawn = info[f"random/{name}"]
        assert drawn.shape == (50, 2)
        assert low <= drawn.min() < low + 0.1 * (high - low)
        assert high - 0.1 * (high - low) < drawn.max() <= high
    scaled = error / info["random/place_noise"][..., None]
    assert scaled.std() == pytest.approx(1, rel=5 / math.sqrt(2 * scaled.size))
    before = info["random/place_noise"].copy()
    one.reset()
    assert (one.first_info()["random/place_noise"] != before).all()


def test_without_randomization_noise_is_what_was_given(aviary):
    sensor = Imperfect(Place(), noise=0.5)
    one = aviary("hover", 400, action="velocity", num_drones=2, sensors=sensor, observation="place")
    error = one.reset(seeds=0) - one.swarm.position[..., :2]
    assert error.std() == pytest.approx(0.5, rel=5 / math.sqrt(2 * error.size))


def test_a_late_gps_is_what_drones_know_and_tell(aviary):
    """The radio tells at the start what the receiver says, not the truth."""
    sensor = Imperfect(Gps(), rate=5, delay=0.1)
    one = aviary(
        "converge",
        1,
        num_drones=3,
        sensors=(sensor,),
        observation=("position", "neighbours"),
        randomization={"gps_noise": 5.0, "radio_delay": 0.0001},
    )
    known = [one.reset(seeds=0)[0, :, :3]]
    heard = one.worlds.frame.readings["heard_position"][0]
    assert np.abs(known[0] - one.swarm.position[0]).min() > 1e-3
    for i, j in ((0, 1), (1, 2), (2, 0)):
        np.testing.assert_allclose(heard[i, j], known[0][j], rtol=1e-6)
    for _ in range(6):
        known.append(one.step(np.zeros((1, 3, 3))).observations[0, :, :3])
    same = [(after == before).all() for before, after in itertools.pairwise(known)]
    assert same == [True, True, False, True, False, True]


def test_sights_of_a_wrapped_sensor_are_still_sights(aviary):
    sensor = Imperfect(find_sensor("sight"), rate=5, noise=1.0)
    one = aviary("los", 2, num_drones=3, area=250.0, num_layouts=1, sensors=(sensor,))
    one.reset(seeds=0)
    first = one.sight.copy()
    assert first.dtype == bool
    one.step(np.ones((2, 3, 3)))
    np.testing.assert_array_equal(one.sight, first)
