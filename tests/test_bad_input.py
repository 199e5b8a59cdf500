"""What cannot be is refused fast, by its name and with a remedy; what is accepted flies."""

import dataclasses
import functools
import itertools
import json
import math
import re
import time
from decimal import Decimal
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import bulletuav
from bulletuav.city.generator import generate
from bulletuav.city.imports import from_geojson, from_obj
from bulletuav.city.statistics import Statistics
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.options import EnvOptions
from bulletuav.envs.randomization import known_uncertainties
from bulletuav.errors import finite, naming, numbers_of, shown
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.rotation import exp_map
from bulletuav.network.mobility import find_mobility
from bulletuav.policies import find_policy
from bulletuav.policies.base import Policy
from bulletuav.registry import names
from bulletuav.sensors.suite import known_sensors
from bulletuav.tasks import find_task, list_tasks
from bulletuav.tasks.base import Task
from bulletuav.tasks.hover import Hover

NAN, INF = float("nan"), float("inf")


class Evil:
    """Raises whatever is done with it."""

    def __repr__(self):
        raise KeyError("evil repr")

    def __eq__(self, other):
        raise KeyError("evil eq")

    __hash__ = None


BAD = {
    "nan": NAN,
    "inf": INF,
    "huge": 1e300,
    "digits": 10**400,
    "more digits": 10**5000,
    "64 bits": 2**63,
    "many": 10**9,
    "minus": -1,
    "half": 1.5,
    "true": True,
    "fraction": Fraction(-1, 2),
    "decimal": Decimal("1.5"),
    "complex": 1j,
    "text": "zzz",
    "no text": "",
    "long text": "x" * 10**5,
    "nul": "a\0.obj",
    "bytes": b"x",
    "list": [],
    "long list": [0] * 10**5,
    "nested": [[1], [2, 3]],
    "nans": (NAN, NAN, NAN),
    "pair": (1e300, 1e300),
    "bools": (True, True),
    "0-d": np.array(3),
    "0-d text": np.array("hover"),
    "array": np.array([1, 2]),
    "matrix": np.zeros((2, 2)),
    "dict": {"a": 1},
    "function": lambda: 0,
    "class": int,
    "object": object(),
    "evil": Evil(),
}
LONGEST = 2000
OWN = {
    task: [field.name for field in dataclasses.fields(find_task(task).Config)]
    for task in list_tasks()
}
COMMON = [field.name for field in dataclasses.fields(EnvOptions)]
CASES = [("hover", name) for name in COMMON] + [
    (task, name)
    for k, task in enumerate(OWN)
    for name in OWN[task]
    if all(name not in OWN[other] for other in list(OWN)[:k])
]


def refusal(call, limit=30.0):
    """Give the message of the refusal, or None where the call was accepted.

    Either must take less than `limit` seconds of the processor: what grows without end takes more.
    """
    begin, told = time.process_time(), None
    try:
        call()
    except (ValueError, FileNotFoundError) as error:
        told = str(error)
    taken = time.process_time() - begin
    assert taken < limit, f"{taken:.1f} s"
    assert told is None or 10 < len(told) < LONGEST, f"{len(told)} letters"
    return told


@pytest.mark.filterwarnings("ignore:controller 'pid'")
@pytest.mark.parametrize(("task", "name"), CASES, ids=lambda value: value)
def test_every_option_names_what_it_cannot_be(task, name):
    few = (
        {"num_layouts": 1, "area": 250.0}
        if "num_layouts" in OWN[task] and name not in ("num_layouts", "area")
        else {}
    )
    EnvSpec(task, 1, few)  # may compile
    for kind, value in BAD.items():
        told = refusal(lambda value=value: EnvSpec(task, 1, {**few, name: value}))
        assert told is None or name in told, f"{kind}: {told}"


def test_what_is_accepted_is_kept_as_numbers_of_one_type():
    given = {
        "gravity": Fraction(9),
        "max_range": 10,
        "turbulence": np.int64(2),
        "wind": [1, Fraction(1, 2), 0],
    }
    plan = EnvSpec(
        "converge",
        1,
        {
            **given,
            "num_drones": np.int64(3),
            "d_safe": Fraction(3),
            "radius": 90,
            "start_speed": [1, 2],
        },
    )
    options, config = plan.options, plan.task.config
    kept = [
        options.gravity,
        options.max_range,
        options.turbulence,
        *options.wind,
        config.d_safe,
        config.radius,
    ]
    assert [type(value) for value in (*kept, *config.start_speed)] == [float] * 10
    assert type(options.num_drones) is int


@pytest.mark.parametrize("value", BAD.values(), ids=BAD)
def test_any_value_can_be_shown_in_a_line(value):
    assert 0 < len(shown(value)) < 500
    assert "\n" not in shown(value)


def test_numbers_are_no_texts_nor_dates_nor_imaginary():
    for value in (
        "0",
        ["1", "2"],
        [1j],
        np.array(["2020-01-01"], dtype="datetime64[D]"),
        [None],
        [[1], [2, 3]],
        [10**400],
    ):
        with pytest.raises(ValueError, match="these are not numbers"):
            numbers_of("these are", value)
    assert numbers_of("these are", [Fraction(1, 2), 2**70]).tolist() == [0.5, 2**70]
    with pytest.raises(ValueError, match="x is .*True_?: a finite number"):
        finite("x", np.True_)


# Sizes


@pytest.mark.parametrize(
    ("worlds", "options", "asked"),
    [
        (10**6, {}, "1000000 worlds of 1 drones"),
        (10**6, {"num_drones": 1000, "max_distance": 50.0}, "1000000 worlds of 1000 drones"),
        (1000, {"observation": ["rgb"], "camera_size": (4096, 4096)}, "1000 worlds of 1 drones"),
    ],
)
def test_worlds_that_do_not_fit_into_the_machine_are_refused_with_both_figures(
    worlds, options, asked
):
    told = refusal(lambda: EnvSpec("hover", worlds, options))
    assert asked in told
    assert told.count(" GiB") == 2
    assert "lower num_worlds" in told


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: Aviary("hover", 2**63), "num_worlds"),
        (lambda: bulletuav.batch_env("hover", 10**7), "num_envs"),
        (lambda: bulletuav.parallel_env("hover", physics_hz=2**63), "physics_hz"),
        (lambda: bulletuav.parallel_env("hover", airframe=["cf2x"] * 10**5), "airframe"),
        (
            lambda: bulletuav.parallel_env("hover", num_beams=1000, lidar_elevations=range(90)[:9]),
            "lidar_elevations",
        ),
        (lambda: bulletuav.parallel_env("coverage", cell=0.01, num_layouts=1), "cell"),
        (lambda: bulletuav.parallel_env("mec", arrival_rate=1e5, num_layouts=1), "arrival_rate"),
        (lambda: bulletuav.parallel_env("obstacles", num_obstacles=10**9), "num_obstacles"),
        (lambda: bulletuav.evaluate("hover", "random", episodes=10**18), "episodes"),
        (lambda: bulletuav.curriculum_env("hover", window=10**30), "window"),
        (lambda: bulletuav.curriculum_env("hover", stages=[{}] * 10**5), "stages"),
    ],
)
def test_sizes_have_bounds(make, name):
    assert name in refusal(make)


def test_what_is_large_and_possible_is_planned():
    EnvSpec("hover", 1000, {})
    EnvSpec("converge", 1, {"num_drones": 1000, "radius": 1500.0, "horizon": 5_000_000})


@pytest.mark.parametrize(
    ("config", "asked"),
    [
        ({"worlds": 1000, "model": {"n_steps": 10**6}}, "n_steps 1000000 in 1000 slots"),
        ({"algo": "sac", "model": {"buffer_size": 10**11}}, "buffer_size 100000000000"),
        ({"algo": "sac", "model": {"batch_size": 10**11}}, "batch_size 100000000000"),
        ({"model": {"policy_kwargs": {"net_arch": [10**9, 10**9]}}}, "net_arch"),
    ],
)
def test_buffers_and_networks_that_do_not_fit_are_refused_with_both_figures(config, asked):
    from bulletuav.policies.run import RunConfig
    from bulletuav.training import models

    run = RunConfig("hover", **config)
    env = type("Env", (), {"num_envs": run.worlds, "num_drones": 1})()
    plan = EnvSpec("hover", run.worlds, {})
    env.observation_space, env.action_space = plan.observer.space(), plan.observer.space()
    env.labels = plan.observer.labels
    told = refusal(lambda: models.make_model(run, env), 20.0)  # torch is imported on the way
    assert asked in told
    assert told.count(" GiB") == 2


@pytest.mark.parametrize(
    ("model", "told"),
    [
        ({"gamma": 2.0}, "gamma is 2"),
        ({"features": ["symlog"]}, "features"),
        ({"policy_kwargs": {"net_arch": "a"}}, "net_arch"),
    ],
)
def test_settings_of_models_are_named(model, told):
    from bulletuav.policies.run import RunConfig
    from bulletuav.training import models

    env = type("Env", (), {"num_envs": 1, "num_drones": 1})()
    observer = EnvSpec("hover", 1, {}).observer
    env.observation_space = env.action_space = observer.space()
    env.labels = observer.labels
    with pytest.raises(ValueError, match=told):
        models.make_model(RunConfig("hover", model=model), env)


# Cities


DEGREES = 1 / 111_000
"""In a metre, about"""


def square(x, y, side=20.0, metres=False):
    unit = 1.0 if metres else DEGREES
    corners = ((0, 0), (side, 0), (side, side), (0, side), (0, 0))
    return [[x + unit * dx, y + unit * dy] for dx, dy in corners]


def collection(*rings, height=10):
    features = [
        {
            "type": "Feature",
            "properties": {"height": height},
            "geometry": {"type": "Polygon", "coordinates": [ring]},
        }
        for ring in rings
    ]
    return json.dumps({"type": "FeatureCollection", "features": features})


CUBE = (
    "o a\n"
    + "".join(f"v {x} {y} {z}\n" for x in (0, 10) for y in (0, 10) for z in (0, 10))
    + "f -1 -2 -3 -4 -5 -6 -7 -8\n"
)
FILES = {
    "far.geojson": (
        collection(square(0, 0), square(0.27, 0)),
        {},
        r"on a square of 300\d\d.* m: less than 4096 m",
    ),
    "metres.geojson": (
        collection(square(0, 0, metres=True), square(30_000, 0, metres=True)),
        {"metres": True},
        "30020 m: less than 4096 m",
    ),
    "globe.geojson": (
        collection([[-180, -80], [180, -80], [180, 80], [-180, 80], [-180, -80]]),
        {},
        "less than 4096 m",
    ),
    "giant.geojson": (
        collection(square(0, 0, 1e155, metres=True)),
        {"metres": True},
        "less than 4096 m",
    ),
    "point.geojson": (
        collection(square(0, 0, 1e-290)),
        {"strict": True},
        r"feature 0 \(from 0\): it has no area",
    ),
    "tower.geojson": (
        collection(square(0, 0), height=1e300),
        {"strict": True},
        r"feature 0 .*its height is 1e\+300 m: from",
    ),
    "digits.geojson": (
        collection(square(0, 0), height=10**400),
        {"strict": True},
        r"digits.geojson is not valid GeoJSON: .* a whole number has 1329 bits: 1000 at most",
    ),
    "flag.geojson": (collection(square(0, 0), height=True), {"strict": True}, "its height is True"),
    "deep.geojson": ("[" * 10**5, {}, "is not valid GeoJSON"),
    "long.geojson": ('{"features": ' + "1" * 5000 + "}", {}, "is not valid GeoJSON"),
    "null.geojson": (
        '{"features": [null]}',
        {"strict": True},
        r"feature 0 .*its geometry cannot be read: a Polygon",
    ),
    "empty.geojson": (collection([]), {"strict": True}, r"feature 0 .*(empty|cannot be read)"),
    "latin.geojson": (b'{"features": "\xe9"}', {}, "is no text in UTF-8"),
    "latin.obj": (b"# caf\xe9\n", {}, "is no text in UTF-8"),
    "far.obj": (
        CUBE + CUBE.replace("v 10", "v 30000").replace("o a", "o b"),
        {},
        "less than 4096 m",
    ),
    "scaled.obj": (CUBE, {"scale": 1e4}, "less than 4096 m"),
    "more.obj": (CUBE, {"scale": 1e300}, "scale is 1e"),
    "wide.obj": (CUBE, {"side": 1e300}, r"side is 1e\+300 m: less than 4096 m"),
    "high.obj": (CUBE.replace(" 10\n", " 9000\n"), {}, "from 0 to 9000 m above ground"),
    "face.obj": (CUBE + "f\n", {}, "line 11 cannot be read: a face needs at least three corners"),
    "words.obj": (CUBE + "f a b c\n", {}, "line 11 cannot be read: 'a' is not a vertex index"),
    "flags.obj": (CUBE, {"y_up": 1}, "y_up is 1: True or False"),
    "flags.geojson": (
        collection(square(0, 0)),
        {"metres": "zzz"},
        "metres is 'zzz': True or False",
    ),
    "property.geojson": (
        collection(square(0, 0)),
        {"height": []},
        r"height is \[\]: the name of a property",
    ),
}


@pytest.mark.parametrize("name", FILES)
def test_city_files_that_cannot_be_are_named(tmp_path, name):
    content, options, message = FILES[name]
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    begin = time.process_time()
    with pytest.raises(ValueError, match=message):
        (from_obj if name.endswith(".obj") else from_geojson)(path, **options)
    assert time.process_time() - begin < 30


@pytest.mark.parametrize("read", [from_geojson, from_obj])
def test_paths_of_cities_that_are_none(tmp_path, read):
    for path in (None, 3, [], b"x", "a\0b", "x" * 5000, tmp_path):
        told = refusal(lambda path=path: read(path))
        assert "city" in told
        assert ".geojson" in told
    with pytest.raises(FileNotFoundError, match="no city file nowhere.obj: give the path"):
        read("nowhere.obj")


def test_a_town_on_both_sides_of_the_antimeridian_is_the_town_that_it_is_elsewhere(tmp_path):
    def town(name, longitude):
        rings = [
            square((longitude + 180 + DEGREES * x) % 360 - 180, 0.001) for x in (-300, -40, 35, 280)
        ]
        path = tmp_path / f"{name}.geojson"
        path.write_text(collection(*rings))
        return from_geojson(path)

    here, there = town("here", 0.0), town("there", 180.0)
    assert there.side == pytest.approx(here.side, abs=1e-6)
    np.testing.assert_allclose(there.solids.boxes, here.solids.boxes, atol=1e-6)


def test_a_city_is_asked_for_points():
    city = generate("urban", 300.0, np.random.default_rng(0))
    assert city.roof((0, 0)) == city.roof((0.0, 0.0))
    assert city.outdoors((0, 0, 0)) == city.outdoors((0.0, 0.0, 0.0))
    assert city.clearance((0, 0), 10) == city.clearance((0.0, 0.0), 10.0)
    for points in (None, 3, [], (0,), "a", (NAN, 0)):
        with pytest.raises(ValueError, match="points are"):
            city.outdoors(points)
    with pytest.raises(ValueError, match="rng is None"):
        generate("urban", 300.0, None)
    with pytest.raises(ValueError, match="gamma is 1e"):
        Statistics(0.3, 500, 1e18)


# Airframes


@pytest.mark.parametrize(
    ("tag", "value"),
    [
        ("max_rotor_speed", "1e300"),
        ("max_rotor_speed", "1e-300"),
        ("propeller_radius", "1e300"),
        ("propeller_radius", "1e-300"),
        ("torque_ratio", "1e300"),
        ("thrust_coefficient", "1e18"),
        ("max_speed", "1e300"),
    ],
)
def test_sizes_of_airframes_are_bounded(urdf, tag, value):
    text = bulletuav.load_airframe("cf2x").urdf.read_text()
    old = text[text.index(f"<{tag} ") :].partition("/>")[0]
    path = urdf("cf2x", (old, f'<{tag} value="{value}"'))
    with pytest.raises(ValueError, match=rf"own\.urdf: <{tag}.*> is {value[:2]}"):
        bulletuav.load_airframe(path)


def test_paths_of_airframes_that_are_none():
    for source in (None, 3, [], b"x", Hover, "a\0.urdf", "~zzz/x.urdf", "z" * 5000 + ".urdf"):
        assert "airframe" in refusal(lambda source=source: bulletuav.load_airframe(source))


# What users write: starts, verdicts, tasks, wind


def hover(**methods):
    return type("Mine", (Hover,), {"name": "mine", **methods})


def starting(change, **options):
    """Give the refusal of a task of two drones whose second start is changed.

    The environment then is as it was.
    """
    changing = []

    def spawn(self, rng):
        start = Hover.spawn(self, rng)
        return change(start) if changing else start

    aviary = Aviary(hover(spawn=spawn), 2, num_drones=2, **options)
    try:
        aviary.reset(seeds=0)
        before = [array.copy() for array in (*aviary.swarm, *aviary.scene[:7], aviary.alive)]
        changing.append(True)
        told = refusal(lambda: aviary.reset(seeds=1))
        if told is not None:
            after = [*aviary.swarm, *aviary.scene[:7], aviary.alive]
            assert all(np.array_equal(one, other) for one, other in zip(before, after, strict=True))
            aviary.step(np.zeros((2, 2, 4)))
        return told
    finally:
        aviary.close()


def second(name, value):
    def change(start):
        array = np.array(getattr(start, name), dtype=float)
        array[1] = value(array[1]) if callable(value) else value
        return start._replace(**{name: array})

    return change


STARTS = {
    "below": (
        second("position", (0, 0, -5)),
        r"position of drone 1 .* is -5 m up, .*start it at z = 0.0\d+ m or more",
    ),
    "in the ground": (second("position", (0, 0, 0.01)), "is 0.01 m up, and its shape reaches"),
    "another tile": (second("position", (5000, 0, 2)), "start it less than 2047.9"),
    "parked": (second("position", (0, 0, 1e6)), "2000 m up"),
    "nowhere": (
        second("position", NAN),
        "position of the spawn of task 'mine' is .*nan.*: finite numbers",
    ),
    "no attitude": (
        second("quaternion", 0),
        "quaternion of drone 1 .* has the norm 0: a unit quaternion",
    ),
    "long attitude": (second("quaternion", lambda q: 5 * q), "has the norm 5"),
    "velocity": (second("velocity", INF), "velocity of the spawn"),
    "rates": (second("rates", NAN), "rates of the spawn"),
    "goal": (second("goal", NAN), "goal of the spawn"),
    "None": (lambda start: None, "spawn of task 'mine' gave None: a Spawn is needed"),
    "tuple": (tuple, "gave .*: a Spawn is needed"),
    "one place": (
        lambda start: start._replace(position=start.position[:1]),
        r"has shape \(1, 3\): \(2, 3\) is needed",
    ),
    "no place": (
        lambda start: start._replace(position=None),
        "position of the spawn of task 'mine' is not numbers",
    ),
    "goals run nowhere": (lambda start: start._replace(goal_velocity=NAN), "goal_velocity"),
    "obstacle": (
        lambda start: start._replace(obstacle=np.zeros((1, 3))),
        r"obstacle .* has shape \(1, 3\)",
    ),
    "layout": (lambda start: start._replace(layout=5), "layout of the spawn of task 'mine' is 5"),
    "no layout": (
        lambda start: start._replace(layout=None),
        "layout of the spawn of task 'mine' is None",
    ),
    "memory": (lambda start: start._replace(memory={"zzz": 1}), "unknown memory .*'zzz'"),
    "no memory": (lambda start: start._replace(memory=None), "memory .* is None: a dict"),
    "each other": (second("position", lambda p: 0 * p + (-1, 0, 2.0)), None),
}


@pytest.mark.parametrize("case", STARTS)
def test_starts_that_cannot_be_are_refused_before_anything_is_written(case):
    change, message = STARTS[case]
    told = starting(change)
    if message is not None:
        assert re.search(message, told), told


ROUND = [
    (math.cos(a), math.sin(a), z) for a in np.linspace(0, 2 * math.pi, 20_000) for z in (-1, 1)
]


@pytest.mark.parametrize(
    ("shape", "extremes"),
    [
        ('<cylinder radius="0.06" length="0.03"/>', ROUND),
        ('<box size="0.1 0.08 0.03"/>', list(itertools.product((-1, 1), repeat=3))),
        ('<sphere radius="0.06"/>', None),
    ],
)
@pytest.mark.parametrize("turn", [(0, 0, 0), (0.7, -0.4, 1.0), (math.pi, 0, 0)])
def test_a_drone_may_stand_on_the_ground_and_no_deeper(urdf, shape, extremes, turn):
    path = urdf("cf2x", ('<cylinder radius="0.0691" length="0.03"/>', shape))
    airframe, attitude = bulletuav.load_airframe(path), exp_map(np.array(turn, dtype=float))
    x, y, z, w = attitude
    up = np.array(
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]
    )  # in body axes
    lowest = 0.06 if extremes is None else -(np.array(extremes) * airframe.shape.half @ up).min()

    def at(height):
        return lambda start: start._replace(
            position=np.array([[-1, 0, 3.0], [1, 0, height]]),
            quaternion=np.array([[0, 0, 0, 1.0], attitude]),
        )

    assert starting(at(lowest + 1e-7), airframe=path) is None
    assert "start it at z" in starting(at(lowest - 1e-5), airframe=path)


@functools.cache
def compile_hover():
    """Compile the kernels of `hover`, whose time is not to count."""
    aviary = Aviary(hover(), 2)
    aviary.reset(seeds=0)
    aviary.step(np.zeros((2, 1, 4)))
    aviary.close()


def judged(change):
    compile_hover()

    def evaluate_step(self, frame):
        return change(Hover.evaluate_step(self, frame))

    # Named as its own terms, so that a task which evaluates by itself has them, too.
    given = Hover.reward.items()
    reward = {name: one if isinstance(one, tuple) else (name, one) for name, one in given}
    aviary = Aviary(hover(evaluate_step=evaluate_step, reward=reward), 2)
    try:
        return refusal(lambda: (aviary.reset(seeds=0), aviary.step(np.zeros((2, 1, 4)))))
    finally:
        aviary.close()


def term(value):
    return lambda result: result._replace(terms={**result.terms, "speed": value})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda result: None, "evaluate_step of task 'mine' gave None: a StepResult"),
        (lambda result: result._replace(terms=None), "the terms None"),
        (lambda result: result._replace(terms={}), "no reward term 'alive'"),
        (
            lambda result: result._replace(terms={**result.terms, "zzz": 1}),
            "unknown reward term .*'zzz'",
        ),
        (lambda result: result._replace(terminated=None), r"None as terminated: an array \(2, 1\)"),
        (
            lambda result: result._replace(success=result.success.astype(float)),
            "float64 as success: an array .* of bool",
        ),
        (term(np.zeros((3, 5))), r"\(3, 5\) of float64 as reward term 'speed'"),
        (term(np.zeros(1)), "reward term 'speed'"),
        (term(np.zeros((2, 1), dtype=complex)), "complex128 as reward term 'speed'"),
        (term("a"), "'a' as reward term 'speed'"),
        (
            term(np.full((2, 1), NAN)),
            "the reward of drone 0 in world 0 is nan: "
            "evaluate_step of task 'mine' gave {'speed': nan}",
        ),
    ],
)
def test_verdicts_that_cannot_be_are_named(change, message):
    told = judged(change)
    assert told is not None
    assert re.search(message, told), told


@dataclasses.dataclass(frozen=True)
class Bare:
    d_safe: float = 1.0


@pytest.mark.parametrize(
    ("task", "message"),
    [
        (Task, "task Task has no spawn"),
        (hover(Config=None), "Config of task Mine has no field d_safe"),
        (hover(Config=Bare), "Config of task Mine has no field weights"),
        (hover(defaults=None), "defaults of task Mine is None: a dict"),
        (hover(defaults={**Hover.defaults, "zzz": 1}), "unknown option among the defaults .*'zzz'"),
        (hover(difficulties=None), "difficulties of task Mine is None: a dict"),
        (hover(difficulties={}), "difficulties of task Mine are empty"),
        (hover(reward=None), "task Mine has no reward"),
        (hover(reward={"alive": "much"}), "reward of task Mine has 'alive': 'much'"),
        (hover(observation=None), "task Mine has no observation"),
        (hover(required_sensors=("zzz",)), "unknown reading .*'zzz'"),
        (hover(name=3), "name of task Mine is 3"),
        (hover(rebound=NAN), "rebound of task 'mine' is nan"),
        (hover(obstacles=lambda self: ["a"]), "obstacles of task 'mine' gave"),
        (hover(layouts=lambda self: None), "layouts of task 'mine' gave None"),
        (hover(memory=lambda self: {**Hover.memory(self), "a": None}), "shape of memory 'a'"),
        (hover(memory=lambda self: Hover.memory(self) and None), "memory of task 'mine' gave None"),
    ],
)
def test_task_classes_name_what_they_lack(task, message):
    with pytest.raises(ValueError, match=message):
        EnvSpec(task, 1, {})


def test_arenas_that_are_none_are_named():
    for low in ((NAN, 0, 0), (0, 0), None, (1e3, 0, 0)):

        def make(self, config, context, low=low):
            Hover.__init__(self, config, context)
            self.arena_low = low

        with pytest.raises(ValueError, match="arena_low and arena_high of task 'mine'"):
            EnvSpec(hover(__init__=make), 1, {})


@pytest.mark.parametrize("wind", [lambda: 0, lambda p: 0, int, lambda p, t, u: 0])
def test_functions_that_are_no_wind_are_refused_at_construction(wind):
    with pytest.raises(ValueError, match="wind is"):
        EnvSpec("hover", 1, {"wind": wind})


@pytest.mark.parametrize("answer", ["a", None, [[1], [2, 3]], 1j])
def test_winds_that_are_no_numbers_are_named(answer):
    aviary = Aviary("hover", wind=lambda place, time: answer)
    aviary.reset(seeds=0)
    with pytest.raises(ValueError, match="the result of the wind function is not numbers"):
        aviary.step(np.zeros((1, 1, 4)))
    aviary.close()


# Everything else that is asked for


@pytest.mark.parametrize("kind", BAD)
def test_arguments_of_a_flying_environment(flying, kind):
    value = BAD[kind]
    assert refusal(lambda: Aviary("hover", first_world=value)) is not None or value == 10**9
    for call in (
        lambda: flying.aviary.render(value),
        lambda: flying.aviary._spec.require_world(value),
    ):
        told = refusal(call)
        assert told is None or "world is" in told
    for name, call in (
        ("seed", lambda: flying.reset(seed=value)),
        ("mask", lambda: flying.aviary.reset(mask=value)),
        ("options", lambda: flying.reset(options=value)),
    ):
        told = refusal(call)
        assert told is None or name in told, told
    told = refusal(lambda: bulletuav.batch_env("hover", 2, autoreset_mode=value))
    assert "autoreset_mode" in told
    assert "SAME_STEP" in told


@pytest.fixture(scope="module")
def flying():
    env = bulletuav.batch_env("hover", 2)
    env.reset(seed=0)
    yield env
    env.close()


def test_modes_have_names():
    env = bulletuav.batch_env("hover", 1, autoreset_mode="SAME_STEP")
    assert env.autoreset_mode is AutoresetMode.SAME_STEP
    env.close()


def test_curricula_and_evaluations_name_their_arguments(tmp_path):
    for stages in (None, 3, "easy", ["easy", "hard"], [None], [], {}, np.array(3)):
        assert "stages" in refusal(
            lambda stages=stages: bulletuav.curriculum_env("hover", stages=stages)
        )
    for name, value in itertools.product(("up", "down", "window"), (True, 10**400, NAN, "a")):
        assert name in refusal(
            lambda name=name, value=value: bulletuav.curriculum_env("hover", **{name: value})
        )
    assert refusal(lambda: bulletuav.curriculum_env("hover", up=Fraction(2))).startswith("down")
    for seed in (True, [], 1.5, -1, "a"):
        with pytest.raises(ValueError, match="seed is"):
            bulletuav.curriculum_env("hover").reset(seed=seed)
    for out in (True, 3, [], ""):
        assert "out is" in refusal(
            lambda out=out: bulletuav.evaluate("hover", "random", 1, out=out)
        )
    with pytest.raises(ValueError, match="progress is 3"):
        bulletuav.evaluate("hover", "random", 1, progress=3)
    with pytest.raises(ValueError, match="unknown agent 'zzz'"):
        bulletuav.curriculum_env("hover").observation_space("zzz")


@pytest.mark.parametrize("name", ["run.json", "episodes.csv"])
def test_damaged_files_of_a_run_are_named(tmp_path, name):
    run = {"task": "hover", "policy": "random", "episodes": 1, "out": tmp_path, "horizon": 3}
    whole = bulletuav.evaluate(**run, progress=None)
    for content in (b"\xff\xfe", b"zzz", (tmp_path / name).read_bytes().replace(b"0", b"abc")):
        kept = (tmp_path / name).read_bytes()
        (tmp_path / name).write_bytes(content)
        with pytest.raises(ValueError, match=f"holds .*run .*{name}|holds another run"):
            bulletuav.evaluate(**run)
        (tmp_path / name).write_bytes(kept)
    assert str(bulletuav.evaluate(**run).rows) == str(whole.rows)


class Nameless(Policy):
    def reset(self, mask): ...
    def act(self, observations, swarm): ...


@pytest.mark.parametrize(
    ("source", "message"),
    [
        (Policy, "policy Policy has no act"),
        (Nameless, "policy Nameless has no name"),
        ("", "policy is ''"),
        ("ppo:", "'ppo:'"),
    ],
)
def test_policies_name_what_they_lack(source, message):
    with pytest.raises(ValueError, match=message):
        find_policy(source)


@pytest.mark.parametrize("model", names("mobility"))
def test_mobility_names_what_it_cannot_be(model):
    for field in dataclasses.fields(find_mobility(model)):
        for kind, value in BAD.items():
            told = refusal(
                lambda field=field, value=value: find_mobility({"model": model, field.name: value})
            )
            assert told is None or field.name in told, f"{kind}: {told}"
    assert find_mobility(model).max_speed < 10


@pytest.mark.parametrize("name", known_uncertainties(known_sensors()))
def test_randomization_names_what_it_cannot_be(name):
    for value in BAD.values():
        told = refusal(lambda value=value: EnvSpec("hover", 1, {"randomization": {name: value}}))
        assert told is None or name in told


@pytest.mark.parametrize(
    ("kind", "size", "message"),
    [
        ("zzz", (1,), "unknown kind of obstacle 'zzz'"),
        ("sphere", (NAN,), "size of an obstacle is nan"),
        ("sphere", (-1,), "size of an obstacle is"),
        ("box", (1,), "size of an obstacle is .* of 3 values"),
        ("cylinder", (1,), "size of an obstacle is .* of 2 values"),
        ("cylinder", (1, 0), "metres above 0"),
        ("hull", (1,), "size of an obstacle is .* of 0 values"),
        ("hull", (), "corners of an obstacle is"),
    ],
)
def test_obstacles_name_what_they_cannot_be(kind, size, message):
    with pytest.raises(ValueError, match=message):
        Obstacle(kind, size)


@pytest.mark.parametrize(
    ("kind", "options", "message"),
    [
        ("hull", {"corners": ((0, 0, 0), (1, 0, 0), (0, 1, 0))}, "spans no volume"),
        ("hull", {"corners": ((0, 0, NAN),)}, "corners of an obstacle is"),
        ("sphere", {"size": (1,), "corners": ((0, 0, 0),)}, "'sphere' has no corners: use 'hull'"),
        ("sphere", {"size": (1,), "friction": 10.1}, "friction of an obstacle is 10.1"),
        ("sphere", {"size": (1,), "restitution": -0.1}, "restitution of an obstacle is -0.1"),
        ("sphere", {"size": (1,), "restitution": NAN}, "restitution of an obstacle is nan"),
    ],
)
def test_obstacles_name_other_options_that_cannot_be(kind, options, message):
    with pytest.raises(ValueError, match=message):
        Obstacle(kind, **options)


def test_a_file_in_the_current_folder_is_named(tmp_path, monkeypatch):
    """Its folder is ".", which is part of most messages, such as of 11.5 m."""
    monkeypatch.chdir(tmp_path)
    with (
        pytest.raises(ValueError, match=r"^town\.obj: a side of 11\.5 m"),
        naming(Path("town.obj")),
    ):
        raise ValueError("a side of 11.5 m is too small")
    with pytest.raises(ValueError, match="^maps/town is"), naming(Path("maps", "town.obj")):
        raise ValueError("maps/town is too small")
