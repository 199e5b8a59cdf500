"""What all sensors keep to, and how an environment works with them."""

from typing import ClassVar

import numpy as np
import pytest
import sensing

import bulletuav
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.solids import Solids
from bulletuav.registry import names
from bulletuav.sensors.base import Image, Label, Sensor, SensorSetup, Uncertain, vector_labels
from bulletuav.sensors.gps import Gps
from bulletuav.sensors.lidar import make_beams
from bulletuav.sensors.optical_flow import OpticalFlow
from bulletuav.sensors.suite import (
    ORDER,
    SensorSuite,
    find_sensor,
    known_sensors,
    provider,
    reading_labels,
    uncertain_parameters,
)

ALL = names("sensor")
WORLDS, DRONES, TARGETS = 2, 3, 4
SOME = {
    "noise": 0.5,
    "walk": 0.3,
    "dropout": 0.2,
    "delay": 0.13,
    "loss": 0.2,
    "range": 40.0,
    "bias": 3.0,
    "iron": 2.0,
    "fov": 60.0,
    "step": 0.003,
    "colours": 0.5,
}
"""Values of uncertain parameters, by the ends of their names"""
CHECKED = {
    "gps": {"observation": ("position", "velocity"), "randomization": {"gps_noise": 1.0}},
    "radio": {"observation": ("velocity", "neighbours"), "randomization": {"radio_loss": 0.3}},
    "camera": {"camera_size": (16, 12)},
    "sight": {"observation": "velocity"},  # `hover` has no targets
    "sight_ahead": {"observation": "velocity"},
    "detector": {"observation": "velocity"},
}
"""Options with which sensors are checked whose readings are not all observed by their names"""
CITY = {"area": 250.0, "num_layouts": 1, "num_users": TARGETS, "camera_size": (16, 12)}
FAR = {"optical_flow": (OpticalFlow(max_distance=500.0),)}
"""Sensors that see the ground from where drones of `los` fly, in place of those that do not"""
SHOWN = [(name, reading) for name in ALL for reading in find_sensor(name).labels(SensorSetup())] + [
    ("gps", "position"),
    ("gps", "velocity"),
]
"""Sensors and the names by which their readings are observed"""


def usual(parameter):
    """A value of an uncertain parameter."""
    return SOME[parameter.rpartition("_")[2]]


@pytest.fixture
def make_aviary():
    """Builds two worlds with a city, users in it, and sensors, and flies some decisions."""
    made = []

    def make(task="los", decisions=3, **options):
        options = {**(CITY if task == "los" else {}), "num_drones": DRONES, **options}
        aviary = bulletuav.Aviary(task, WORLDS, dynamics="point_mass", **options)
        made.append(aviary)
        observations = aviary.reset(seeds=0)
        rng = np.random.default_rng(1)
        for _ in range(decisions):
            observations = aviary.step(rng.uniform(-1, 1, (WORLDS, DRONES, 3))).observations
        return aviary, observations

    yield make
    for one in made:
        one.close()


@pytest.fixture
def make_engine():
    """Builds worlds with a tower and a ball among the drones."""
    made = []

    def make(worlds=WORLDS):
        tower = Solids(np.array([[(20.0, -5, 0), (40, 5, 60)]]))
        ball = (Obstacle("sphere", (1.0,)),)
        made.append(sensing.open_world((tower,), worlds, DRONES, obstacles=ball))
        return made[-1]

    yield make
    for one in made:
        one.close()


# The contract of sensors


@pytest.mark.parametrize("name", ALL)
def test_it_passes_the_check_of_sensors(name):
    bulletuav.check_sensor(name, **CHECKED.get(name, {}))


@pytest.mark.parametrize("name", ALL)
def test_its_description_is_whole(name):
    sensor = find_sensor(name)
    assert sensor.name == name
    assert sensor.gives
    assert set(sensor.labels(SensorSetup())) <= set(sensor.gives)
    for key, parameter in sensor.uncertain.items():
        assert parameter.least <= parameter.usual <= parameter.most
        assert parameter.per in ("drone", "world")
        attached = getattr(sensing.sensor_of(sensor, (2, 3), beams=make_beams(4, (0.0,))), key)
        expected = np.full((2, 3) if parameter.per == "drone" else 2, parameter.usual)
        np.testing.assert_array_equal(attached, expected)


@pytest.mark.parametrize("name", ALL)
def test_labels_agree_with_readings(name, make_aviary):
    aviary, _ = make_aviary(sensors=(find_sensor(name),))
    attached, readings = (
        aviary.worlds.sensors.sensors[name],
        aviary.worlds.frame.readings,
    )
    labels = attached.labels(attached.setup)
    assert set(attached.gives) <= set(readings)
    for reading, label in labels.items():
        array = readings[reading]
        if isinstance(label, Image):
            assert array.shape == (WORLDS, DRONES, 12, 16, *label.pixel)
            assert array.dtype == label.dtype
            assert label.low <= array.min() <= array.max() <= label.high
            continue
        assert label
        assert array.size == WORLDS * DRONES * len(label)
        assert array.shape[:2] == (WORLDS, DRONES)
        assert all(one.low < one.high for one in label)
        assert len({one.name for one in label}) == len(label)
        numbers = array.reshape(WORLDS, DRONES, len(label)).astype(float)
        assert (np.array([one.low for one in label]) <= numbers).all()
        assert (numbers <= np.array([one.high for one in label])).all()


@pytest.mark.parametrize(("name", "reading"), SHOWN)
def test_what_is_observed_by_its_name_is_what_the_frame_holds(name, reading, make_aviary):
    sensor = find_sensor(name)
    uncertain = {f"{sensor.prefix}{key}": usual(key) for key in sensor.uncertain}
    aviary, observations = make_aviary(
        observation=(reading,),
        observation_format="dict",
        randomization=uncertain,
        sensors=FAR.get(name, ()),
    )
    assert set(observations) == {reading}
    held = aviary.worlds.frame.readings[reading]
    attached = aviary.worlds.sensors.sensors[name]
    if uncertain:
        assert all(
            (getattr(attached, key) == usual(key)).all() for key in attached.uncertain
        )  # it measures with what was asked for
    if reading in aviary.observer.images:
        np.testing.assert_array_equal(observations[reading], held)
        assert observations[reading].dtype == held.dtype
        return
    shown = observations[reading]
    low, high = aviary.observer.low, aviary.observer.high
    expected = np.clip(held.reshape(shown.shape).astype(np.float32), low, high)
    np.testing.assert_array_equal(shown, expected)
    assert np.ptp(shown) > 0 or reading in ("sight", "detection")


class Drawing:
    """Worlds in which drones move at random and a sensor measures, each with its generator."""

    def __init__(self, name, engine, seeds):
        beams = make_beams(8, (0.0, -30.0))
        pictures = frozenset({"rgb", "depth", "segmentation", "ray_depth"})
        views = {"camera_size": (16, 12), "wanted": pictures, "radius": (0.2,) * DRONES}
        worlds = (len(seeds), DRONES)
        self.engine, self.seeds = engine, seeds
        self.rngs = [np.random.default_rng(seed) for seed in seeds]
        self.sensor = sensing.sensor_of(
            find_sensor(name),
            worlds,
            engine,
            beams=beams,
            num_targets=TARGETS,
            longest_delay=0.13,
            **views,
        )
        for key in self.sensor.uncertain:
            getattr(self.sensor, key)[:] = usual(key)

    def states(self, decision):
        """(W, N, 3) places and (W, U, 3) targets of a decision, those of a world by its seed."""
        drawn = [np.random.default_rng((seed, decision)) for seed in self.seeds]
        places = np.array([rng.uniform((-9, -9, 5), (9, 9, 50), (DRONES, 3)) for rng in drawn])
        targets = np.array([rng.uniform((0, -40, 1), (60, 40, 2), (TARGETS, 3)) for rng in drawn])
        return places, targets

    def fly(self, decisions=3, mask=None):
        """Readings after each decision, by name, of the worlds of `mask` (W, N)."""
        rows = []
        for k in range(decisions + 1):
            places, targets = self.states(k)
            before = sensing.swarm_at(self.engine, self.states(max(k - 1, 0))[0])
            swarm = sensing.swarm_at(self.engine, places)
            measuring = np.ones(places.shape[:2], dtype=bool) if mask is None else mask
            if k == 0:
                for world in np.flatnonzero(measuring.any(axis=1)).tolist():
                    sensing.start(self.sensor, world, swarm, self.rngs[world])
            given = {"before": before, "mask": measuring, "targets": targets, "rngs": self.rngs}
            readings = sensing.measure(self.sensor, swarm, steps=k, **given)
            rows.append({name: np.array(array) for name, array in readings.items()})
        return rows


@pytest.mark.parametrize("name", ALL)
def test_worlds_draw_from_their_own_generators_only(name, make_engine):
    """World 1 reads the same whatever the generator of world 0, and whether world 0 measures."""
    engine = make_engine()
    both, others = Drawing(name, engine, (1, 2)), Drawing(name, engine, (7, 2))
    rows = both.fly()
    second = np.array([[False] * DRONES, [True] * DRONES])
    without = Drawing(name, engine, (1, 2))
    without.rngs[0] = None
    for other in (others.fly(), without.fly(mask=second)):
        for mine, theirs in zip(rows, other, strict=True):
            assert set(mine) == set(theirs)
            for reading in mine:
                np.testing.assert_array_equal(mine[reading][1], theirs[reading][1])
    assert both.rngs[1].random() == others.rngs[1].random() == without.rngs[1].random()
    if both.sensor.uncertain:
        assert both.rngs[0].random() != np.random.default_rng(1).random()
    else:
        assert both.rngs[0].random() == np.random.default_rng(1).random()


@pytest.mark.parametrize("name", ALL)
def test_the_same_seed_gives_the_same_readings_again_after_a_reset(name, make_engine):
    engine = make_engine()
    one = Drawing(name, engine, (1, 2))
    first = one.fly()
    one.rngs = [np.random.default_rng(seed) for seed in one.seeds]
    for mine, theirs in zip(first, one.fly(), strict=True):
        for reading in mine:
            np.testing.assert_array_equal(mine[reading], theirs[reading])


@pytest.mark.parametrize("name", sorted(set(ALL) - {"camera"}))
def test_readings_are_not_changed_by_later_ones(name, make_engine):
    """Of the camera alone later pictures are written over, as they are large."""
    one = Drawing(name, make_engine(), (1, 2))
    swarm = sensing.swarm_at(one.engine, one.states(0)[0])
    for world in range(2):
        sensing.start(one.sensor, world, swarm, one.rngs[world])
    given = {"targets": one.states(0)[1], "rngs": one.rngs}
    readings = sensing.measure(one.sensor, swarm, steps=0, **given)
    kept = {reading: np.array(array) for reading, array in readings.items()}
    one.fly()
    for reading, array in kept.items():
        np.testing.assert_array_equal(readings[reading], array)


# Moments


def test_a_moment_draws_for_worlds_that_measure_from_their_generators():
    swarm = sensing.swarm_of(3, 2)
    rngs = [np.random.default_rng(1), None, np.random.default_rng(2)]
    moment = sensing.moment_of(swarm, mask=[[True, False], [False] * 2, [True] * 2], rngs=rngs)
    normal, uniform = moment.draw(width=4)
    for world, seed in ((0, 1), (2, 2)):
        rng = np.random.default_rng(seed)
        np.testing.assert_array_equal(normal[world], rng.standard_normal((2, 4)))
        np.testing.assert_array_equal(uniform[world], rng.random(2))
    assert not normal[1].any()
    assert not uniform[1].any()


def test_a_moment_tells_who_flew_and_what_drones_know():
    swarm = sensing.swarm_of(3, 2, position=1.0, velocity=2.0)
    mask = [[True, False], [True, True], [False, False]]
    moment = sensing.moment_of(swarm, mask=mask, steps=[4, 0, 5])
    assert moment.flying.tolist() == [True, False, False]  # a reset is no flight
    assert (moment.position == 1).all()
    assert (moment.velocity == 2).all()
    moment.readings.update(position=np.full((3, 2, 3), 5.0), velocity=np.full((3, 2, 3), 6.0))
    assert (moment.position == 5).all()
    assert (moment.velocity == 6).all()


# A user's own


class Anchor(Sensor):
    """How far the origin is."""

    name = "anchor"
    numbers = (Label("distance to anchor", "m", 0.0, 500.0),)
    uncertain: ClassVar = {
        "noise": Uncertain(0.0, 10.0),
        "bias": Uncertain(-5.0, 5.0, usual=1.0, per="world"),
    }

    def measure(self, moment):
        normal, _ = moment.draw()
        distance = np.linalg.norm(moment.after.position, axis=-1) + self.bias[:, None]
        return {"anchor": distance + self.noise * normal[..., 0]}

    def info(self):
        return {"anchor_bias": np.broadcast_to(self.bias[:, None], self.setup.shape)}


def test_a_class_follows_from_its_name_and_numbers():
    assert Anchor.gives == ("anchor",)
    assert Anchor.prefix == "anchor_"
    assert Anchor().labels(SensorSetup()) == {"anchor": Anchor.numbers}
    assert uncertain_parameters({"anchor": Anchor()}) == {
        "anchor_noise": Uncertain(0.0, 10.0),
        "anchor_bias": Uncertain(-5.0, 5.0, 1.0, "world"),
    }
    bounds = vector_labels("force", "N", (-1, -2, -3), (1, 2, 3))
    assert bounds[2] == Label("force z", "N", -3, 3)


def test_a_sensor_of_ones_own_is_observed_by_its_name(make_aviary):
    options = {"sensors": Anchor, "observation": ("velocity", "anchor")}
    aviary, observations = make_aviary("converge", **options)
    distance = np.linalg.norm(aviary.swarm.position, axis=-1) + 1
    np.testing.assert_allclose(observations[..., 3], distance, rtol=1e-6)
    assert aviary.observer.labels[3] == Anchor.numbers[0]
    np.testing.assert_array_equal(aviary.first_info()["anchor_bias"], 1.0)


def test_its_uncertain_parameters_are_drawn_for_each_episode(make_aviary):
    ranges = {"anchor_noise": (0.1, 2.0), "anchor_bias": (-3.0, 3.0)}
    options = {"sensors": (Anchor(),), "observation": "anchor", "randomization": ranges}
    aviary, observations = make_aviary("converge", decisions=0, **options)
    info, sensor = aviary.first_info(), aviary.worlds.sensors.sensors["anchor"]
    np.testing.assert_array_equal(info["random/anchor_noise"], sensor.noise)
    np.testing.assert_array_equal(info["random/anchor_bias"], sensor.bias[:, None].repeat(3, 1))
    assert len(np.unique(sensor.noise)) == WORLDS * DRONES
    assert sensor.bias.shape == (WORLDS,)
    off = observations[..., 0] - np.linalg.norm(aviary.swarm.position, axis=-1)
    assert (np.abs(off - sensor.bias[:, None]) < 5 * sensor.noise).all()
    before = sensor.noise.copy()
    aviary.reset()
    assert (aviary.worlds.sensors.sensors["anchor"].noise != before).all()
    for wrong in ({"anchor_noise": 11.0}, {"anchor_bias": (-6.0, 0.0)}):
        with pytest.raises(ValueError, match=f"randomization {next(iter(wrong))} is"):
            make_aviary("converge", sensors=Anchor, randomization=wrong)


def test_an_object_is_a_description_of_which_each_environment_has_a_copy(make_aviary):
    given = Anchor()
    one, _ = make_aviary("converge", sensors=given, observation="anchor")
    other, _ = make_aviary("converge", sensors=given, observation="anchor")
    attached = [aviary.worlds.sensors.sensors["anchor"] for aviary in (one, other)]
    assert len({id(given), *map(id, attached)}) == 3
    assert not hasattr(given, "noise")
    assert given.__dict__ == {}


def test_a_class_is_made_a_sensor_once_for_an_environment(make_aviary):
    made = []

    class Counted(Anchor):
        def __init__(self):
            made.append(self)

    aviary, _ = make_aviary("converge", decisions=0, sensors=Counted, randomization={})
    assert len(made) == 1
    assert made[0] is not aviary.worlds.sensors.sensors["anchor"]  # which is a copy of it


def test_it_may_stand_in_place_of_the_packages_own(make_aviary):
    class Level(Sensor):
        """A range finder that tells the height."""

        name = "lidar"
        numbers = (Label("height", "m", 0.0, 100.0),)

        def measure(self, moment):
            return {"lidar": moment.after.position[..., 2]}

    aviary, observations = make_aviary("converge", sensors=Level, observation="lidar")
    np.testing.assert_allclose(observations[..., 0], aviary.swarm.position[..., 2], rtol=1e-6)
    assert list(known_sensors((Level,))) == list(known_sensors())
    assert isinstance(known_sensors((Level,))["lidar"], Level)
    with pytest.raises(ValueError, match="unknown randomization 'lidar_noise'"):
        make_aviary("converge", sensors=Level, randomization={"lidar_noise": 1.0})


# Which sensors work


def working(aviary):
    return list(aviary.worlds.sensors.sensors)


def test_only_sensors_that_are_needed_work_in_their_order(make_aviary):
    certain, _ = make_aviary("converge", observation="velocity", randomization={})
    assert working(certain) == []  # sight works where there are targets
    asked, _ = make_aviary(observation=("clearance", "lidar"))
    assert working(asked) == ["lidar", "clearance", "sight"]
    everything = make_aviary(sensors=(Anchor(), *map(find_sensor, reversed(ALL))))[0]
    assert working(everything) == [*ORDER, "anchor"]
    assert set(ORDER) == set(ALL)


def test_gps_and_radio_work_unobserved_where_they_are_uncertain(make_aviary):
    for name, parameter in (("gps", "gps_walk"), ("radio", "radio_range")):
        options = {"observation": "velocity", "randomization": {parameter: 0.5}}
        assert working(make_aviary("converge", **options)[0]) == [name]
    options = {"observation": "velocity", "randomization": {"lidar_noise": 0.5}}
    assert working(make_aviary("converge", **options)[0]) == []


def test_all_infos_of_sensors_are_told(make_aviary):
    aviary, _ = make_aviary("converge", sensors=Anchor, randomization={"radio_range": 1e3})
    step = aviary.step(np.zeros((WORLDS, DRONES, 3)))
    np.testing.assert_array_equal(step.info["anchor_bias"], 1.0)
    np.testing.assert_array_equal(step.info["messages"], DRONES - 1)


def test_what_others_measured_is_known_to_those_that_follow(make_aviary):
    """The radio tells the positions that the satellites gave, from the first moment on."""
    options = {"gps_noise": 3.0, "radio_delay": 1e-9}
    for decisions in (0, 1, 2):
        aviary, _ = make_aviary("converge", decisions=decisions, randomization=options)
        readings = aviary.worlds.frame.readings
        known = readings["position"][:, None].repeat(DRONES, axis=1)
        others = ~np.eye(DRONES, dtype=bool)
        heard = readings["heard_position"][:, others]
        np.testing.assert_allclose(heard, known[:, others], atol=1e-6)
        assert np.abs(known[:, 0] - aviary.swarm.position).max() > 1


class Bodies(Anchor):
    needs_bodies: ClassVar = True


class MoreBodies(Bodies):
    name = "more_bodies"
    numbers = (Label("distance", "m", 0.0, 500.0),)

    def measure(self, moment):
        return {"more_bodies": super().measure(moment)["anchor"]}


@pytest.mark.parametrize(
    ("sensors", "times"), [((Anchor,), 0), ((Bodies,), 1), ((Bodies, MoreBodies), 1)]
)
def test_bodies_are_put_where_drones_are_once_and_only_if_a_sensor_needs_them(sensors, times):
    made = {one.name: one() for one in sensors}
    setup = SensorSetup(shape=(1, 2), wanted=frozenset(made))
    suite, shown = SensorSuite(made, setup, None, {}), []
    swarm = sensing.swarm_of(1, 2)
    moment = sensing.moment_of(swarm, mask=[[True, False]], rngs=[np.random.default_rng(0)])
    suite.measure(moment, lambda swarm, mask: shown.append((swarm, mask)))
    assert len(shown) == times
    for given, mask in shown:
        assert given is swarm
        assert mask.tolist() == [[True, False]]


def test_drawn_numbers_are_read_where_they_stand():
    drawn = {"anchor_noise": np.zeros((2, 3)), "anchor_bias": np.zeros((2, 1))}
    setup = SensorSetup(shape=(2, 3), wanted=frozenset({"anchor"}))
    suite = SensorSuite({"anchor": Anchor()}, setup, None, drawn)
    drawn["anchor_bias"][:, 0] = 2.0, 4.0
    rngs = [np.random.default_rng(k) for k in range(2)]
    readings = suite.measure(sensing.moment_of(sensing.swarm_of(2, 3), rngs=rngs), None)
    np.testing.assert_array_equal(readings["anchor"], [[2.0] * 3, [4.0] * 3])


# Names


def test_sensors_are_found_in_every_form():
    assert isinstance(find_sensor("gps"), Gps)
    assert isinstance(find_sensor(Gps), Gps)
    assert isinstance(find_sensor("bulletuav.sensors.gps:Gps"), Gps)
    one = Anchor()
    assert find_sensor(one) is one
    for wrong in (5, None, int, "gsp", "bulletuav.sensors.gps:VELOCITY_SHARE"):
        with pytest.raises(ValueError, match="sensor"):
            find_sensor(wrong)


def test_two_sensors_of_one_name_are_refused():
    with pytest.raises(ValueError, match="sensors has 'anchor' twice: unique names are needed"):
        known_sensors((Anchor(), Anchor))
    with pytest.raises(ValueError, match="sensors: unknown sensor 'gsp': did you mean 'gps'"):
        known_sensors(("gsp",))
    assert list(known_sensors((Anchor,))) == [*ORDER, "anchor"]


def test_a_reading_is_that_of_the_last_sensor_that_has_labels_for_it():
    class Echo(Sensor):
        name = "echo"
        gives = ("anchor", "echo")

        def labels(self, setup):
            return {"anchor": Anchor.numbers}

        def measure(self, moment):
            return {}

    sensors = known_sensors((Anchor, Echo))
    assert provider(sensors, "lidar").name == "lidar"
    assert provider(sensors, "anchor").name == "echo"
    for reading in ("echo", "heard", "nothing"):
        assert provider(sensors, reading) is None
        assert reading_labels(sensors, reading, SensorSetup()) is None
    assert reading_labels(sensors, "anchor", SensorSetup()) == Anchor.numbers
    assert reading_labels(sensors, "rgb", SensorSetup()) == Image(0, 255, np.uint8, (3,))
    with pytest.raises(ValueError, match="reading 'sight' of sensor 'sight' has no numbers here"):
        reading_labels(sensors, "sight", SensorSetup())


# Mistakes of authors


def giving(readings):
    class Wrong(Sensor):
        name = "wrong"
        numbers = (Label("one", "m", 0.0, 1.0), Label("two", "m", 0.0, 1.0))

        def measure(self, moment):
            return readings

    return Wrong()


@pytest.mark.parametrize(
    ("readings", "said"),
    [
        (np.zeros((1, 2, 2)), "array.*: a dict of arrays by name"),
        (None, "None: a dict of arrays by name"),
        ({}, "no reading 'wrong': return it, or remove it from labels"),
        ({"rong": np.zeros((1, 2, 2))}, "no reading 'wrong': return it"),
        ({"wrong": 5.0}, "5.0 as 'wrong': a NumPy array is needed"),
        ({"wrong": [[0.0]]}, "as 'wrong': a NumPy array is needed"),
        ({"wrong": np.zeros((1, 2))}, r"an array \(1, 2\) as 'wrong': \(1, 2, 2\) is needed"),
        ({"wrong": np.zeros((2, 1, 2))}, r"\(2, 1, 2\) as 'wrong': \(1, 2, 2\) is needed"),
        ({"wrong": np.full((1, 2, 2), np.nan)}, "as 'wrong': finite numbers are needed"),
        ({"wrong": np.full((1, 2, 2), np.inf)}, "as 'wrong': finite numbers are needed"),
    ],
)
def test_readings_that_labels_do_not_promise_are_refused(readings, said):
    setup = SensorSetup(shape=(1, 2), wanted=frozenset({"wrong"}))
    suite = SensorSuite({"wrong": giving(readings)}, setup, None, {})
    with pytest.raises(ValueError, match=f"measure of sensor 'wrong' returned .*{said}"):
        suite.measure(sensing.moment_of(sensing.swarm_of(1, 2)), None)


def test_numbers_of_drones_that_do_not_measure_are_not_looked_at():
    readings = np.array([[(0.5, 0.5), (np.nan, np.inf)]])
    setup = SensorSetup(shape=(1, 2), wanted=frozenset({"wrong"}))
    suite = SensorSuite({"wrong": giving({"wrong": readings})}, setup, None, {})
    swarm = sensing.swarm_of(1, 2)
    suite.measure(sensing.moment_of(swarm, mask=[[True, False]]), None)
    suite = SensorSuite({"wrong": giving({"wrong": readings})}, setup, None, {})
    with pytest.raises(ValueError, match="finite numbers are needed"):
        suite.measure(sensing.moment_of(swarm), None)


def test_a_sensor_without_numbers_cannot_be_observed(make_aviary):
    class Blank(Sensor):
        name = "blank"

        def measure(self, moment):
            return {"blank": moment.after.position}

    with pytest.raises(ValueError, match="reading 'blank' of sensor 'blank' .* has no labels"):
        make_aviary("converge", sensors=Blank, observation="blank")


class Shared(Sensor):
    """All environments draw from one generator."""

    name = "shared"
    numbers = (Label("luck", "1", 0.0, 1.0),)
    _rng = np.random.default_rng(0)

    def measure(self, moment):
        return {"shared": self._rng.random(moment.mask.shape)}


class Mixed(Sensor):
    """Worlds feel each other."""

    name = "mixed"
    numbers = (Label("height", "m", 0.0, 1e3),)

    def measure(self, moment):
        height = moment.after.position[..., 2]
        return {"mixed": np.full(height.shape, height.mean())}


def test_the_check_of_sensors_finds_generators_of_ones_own_and_worlds_that_mix():
    with pytest.raises(ValueError, match="sensor 'shared' differs at decision .* the same seed"):
        bulletuav.check_sensor(Shared)
    with pytest.raises(ValueError, match="sensor 'mixed' gives a world other results"):
        bulletuav.check_sensor(Mixed)
