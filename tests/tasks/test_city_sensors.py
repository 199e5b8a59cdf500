"""Sensors in cities: their options, what they measure, and resets and processes."""

import numpy as np
import pytest
from urban import FLIGHTS, WALL

import bulletuav
from bulletuav.envs.env_spec import EnvSpec

NAN = float("nan")
BAD = [
    *(
        ({"num_beams": value}, f"num_beams is {value!r}: a whole number, at least 1")
        for value in (0, -1, 2.5, NAN, "x", None)
    ),
    *(
        ({"max_range": value}, f"max_range is {value:g} m: it must be above 0")
        for value in (0, -1.0)
    ),
    *(
        ({"max_range": value}, f"max_range is {value!r}: a finite number")
        for value in (NAN, float("inf"), "x", None)
    ),
    ({"lidar_elevations": ()}, "lidar_elevations is empty: give at least one"),
    ({"lidar_elevations": 30.0}, "lidar_elevations is 30.0: a list or tuple"),
    ({"lidar_elevations": (0.0, 91.0)}, "lidar_elevations has 91 degrees: from -90"),
    ({"lidar_elevations": (-91.0,)}, "lidar_elevations has -91 degrees"),
    ({"lidar_elevations": (0.0, NAN)}, "lidar_elevations is nan"),
    ({"lidar_elevations": ("x",)}, "lidar_elevations is 'x'"),
    ({"lidar_frame": "yw"}, "unknown lidar_frame 'yw': did you mean 'yaw'"),
    ({"lidar_frame": "body"}, "unknown lidar_frame 'body': choose from world, yaw"),
    ({"lidar_frame": ""}, "unknown lidar_frame ''"),
    *(
        ({"battery_capacity": value}, f"battery_capacity is {value:g} W h: it must be above 0")
        for value in (0, -1.0)
    ),
    *(
        ({"battery_capacity": value}, f"battery_capacity is {value!r}: a finite number")
        for value in (NAN, float("inf"))
    ),
    ({"energy": "zen"}, "unknown energy 'zen': did you mean 'zeng'"),
    ({"energy": ""}, "unknown energy ''"),
    ({"observation": ("lidr",)}, "did you mean 'lidar'"),
]


@pytest.mark.parametrize(("options", "message"), BAD, ids=[str(options) for options, _ in BAD])
def test_options_that_cannot_be(options, message):
    with pytest.raises(ValueError, match=message):
        EnvSpec("lidar_navigation", 1, {"city": WALL, **options})


def test_beams_are_as_many_and_as_high_as_asked_for(put_urban):
    """10 m up and 5 m before the wall: two beams at each of three elevations.

    The lower ones end on the ground.
    """
    options = {"num_beams": 2, "lidar_elevations": (0.0, 30.0, -30.0), "max_range": 25.0}
    aviary = put_urban("lidar_navigation", WALL, [(5, 0, 10)], **options)
    ahead = 5 / np.cos(np.radians(30))
    expected = (5, 25, ahead, 25, ahead, 20)  # ahead, behind; 10 m down at 30 degrees are 20 m
    np.testing.assert_allclose(aviary.reset(seeds=0)[0, 0, -6:], expected, atol=1e-4)
    names = [
        "beam 0",
        "beam 180",
        "beam 0 up 30",
        "beam 180 up 30",
        "beam 0 up -30",
        "beam 180 up -30",
    ]
    assert [label.name for label in aviary.observer.labels[-6:]] == names
    assert {label.high for label in aviary.observer.labels[-6:]} == {25.0}


@pytest.mark.parametrize(("frame", "expected"), [("yaw", 60.0), ("world", 5.0)])
def test_beams_turn_with_the_nose_or_do_not(put_urban, frame, expected):
    aviary = put_urban(
        "lidar_navigation",
        WALL,
        [(5, 0, 10)],
        lidar_frame=frame,
        action="attitude",
        dynamics="rigid_body",
    )
    half = np.pi / 4  # of a turn to the north
    aviary.swarm.quaternion[0, 0] = (0, 0, np.sin(half), np.cos(half))
    aviary.worlds.measure(aviary.swarm, aviary.swarm, aviary.alive)
    ranges = aviary.readings["lidar"][0, 0]
    assert ranges[0] == pytest.approx(expected, abs=1e-4)
    # 270 degrees to the left.
    assert ranges[12 if frame == "yaw" else 0] == pytest.approx(5.0, abs=1e-4)


@pytest.mark.parametrize(
    ("task", "observation", "read"),
    [
        ("hover", None, set()),
        ("hover", ("lidar", "position"), {"lidar"}),
        ("hover", ("imu", "clearance"), {"imu", "clearance"}),
        ("hover", ("ray_depth",), {"ray_depth"}),
        ("default", None, {"lidar", "charge"}),
        ("lidar_navigation", ("goal",), {"lidar"}),  # whose reward needs it
        ("los", ("goal",), {"sight"}),
        ("navigation", ("goal", "battery"), {"charge"}),
    ],
)
def test_readings_hold_what_was_asked_for(make_urban, task, observation, read):
    """Charge, power and sight are always there; sight is empty for tasks without targets."""
    aviary = make_urban(task, **({} if observation is None else {"observation": observation}))
    for _ in range(2):
        readings = aviary.worlds.frame.readings
        always = {"charge", "power", "voltage", "sight"}
        assert read - always == set(readings) - always
        assert read <= set(readings)
        assert readings["sight"].size == aviary.num_drones * aviary.task.num_targets
        aviary.step(np.zeros((1, aviary.num_drones, aviary.action.low.shape[-1])))


def rolled(task, workers):
    """Everything that comes out of a rollout over two episodes of random flight."""
    options = {
        "area": 250.0,
        "num_layouts": 2,
        "dynamics": "rigid_body",
        "difficulty": "medium",
        "num_drones": 2,
    }
    options |= {"horizon": 5, "seed": 3} | ({"leg": 100.0} if task in FLIGHTS else {})
    env = bulletuav.batch_env(task, 3, workers=workers, **options)
    rng, rows = np.random.default_rng(0), [env.reset()]
    for _ in range(11):
        *arrays, infos = env.step(rng.uniform(-1, 1, (3, 2, 3)))
        rows.append(
            (np.concatenate([np.asarray(array, dtype=float).ravel() for array in arrays]), infos)
        )
    env.close()
    return rows


@pytest.mark.parametrize("task", ["lidar_navigation", "los"])
def test_the_number_of_processes_changes_no_bit(task):
    in_one, in_two = rolled(task, 1), rolled(task, 2)
    for (mine, my_infos), (theirs, their_infos) in zip(in_one, in_two, strict=True):
        np.testing.assert_array_equal(mine, theirs)
        assert set(my_infos) == set(their_infos)
        for name, info in my_infos.items():
            np.testing.assert_array_equal(info, their_infos[name])
    assert len({row[0].tobytes() for row in in_one}) == len(in_one)


def test_a_reset_of_one_world_leaves_what_others_sense_untouched(make_urban):
    """Ranges are noisy: a second scan would differ."""
    options = {"difficulty": "medium", "num_layouts": 3, "num_drones": 3}
    env = bulletuav.batch_env(
        "lidar_navigation",
        3,
        autoreset_mode="Disabled",
        area=250.0,
        leg=100.0,
        dynamics="rigid_body",
        **options,
    )
    env.reset(seed=0)
    before = env.step(np.zeros((3, 3, 3)))[0]
    ranges = env.aviary.worlds.frame.readings["lidar"].copy()
    assert (ranges < 60).any(axis=(1, 2)).all()
    after = env.reset(options={"reset_mask": np.array([False, True, False])})[0]
    now = env.aviary.worlds.frame.readings["lidar"]
    for w, same in enumerate((True, False, True)):
        assert (ranges[w].tobytes() == now[w].tobytes()) == same
        assert (before[w].tobytes() == after[w].tobytes()) == same
    env.close()
