"""Every airframe flies its manoeuvre under every controller, dynamics and action."""

import itertools
import math
import warnings

import numpy as np
import placing
import pytest
from bench import MULTIROTORS
from scipy.spatial.transform import Rotation

import bulletuav
from bulletuav.control.actions import ACTIONS
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics import DYNAMICS
from bulletuav.tasks import find_task

AIRFRAMES = MULTIROTORS
MOVE = 0.2  # share of max_speed


def thrust_share(airframe):
    return airframe.mass * 9.80665 / airframe.max_thrust


def manoeuvre(aviary, action):
    """The action to hold, and a function that tells whether it did what it should in a second.

    Its arguments are the state of the drone and its start.
    """
    airframe, speed = aviary.options.airframe[0], aviary.options.max_speed
    hover = 2 * thrust_share(airframe) - 1
    rotors = len(airframe.rotors)
    east = lambda s, p: 0.5 * MOVE * speed < s.velocity[0] < 1.3 * MOVE * speed  # noqa: E731
    north = lambda s, p: 0.5 * MOVE * speed < s.velocity[1] < 1.3 * MOVE * speed  # noqa: E731
    still = lambda s, p: np.abs(s.velocity).max() < 0.05 and np.abs(s.position - p).max() < 0.05  # noqa: E731
    tilt = lambda s: Rotation.from_quat(s.quaternion).as_euler("xyz")  # noqa: E731
    goal = aviary.scene.start[0, 0] + (1.0, 0, 0)
    return {
        "velocity": lambda: ((MOVE, 0, 0), east),
        "velocity_increment": lambda: ((1.0, 0, 0), lambda s, p: s.velocity[0] > 0.3),
        "acceleration": lambda: ((0.1, 0, 0), lambda s, p: 0.25 < s.velocity[0] < 0.55),
        "heading_speed": lambda: ((0.5, 2 * MOVE - 1, 0), north),
        "heading_speed_climb": lambda: ((0.5, 2 * MOVE - 1, 0), north),
        "turn_speed": lambda: ((0, 2 * MOVE - 1, 0), east),
        "target_position": lambda: (
            aviary.action.encode(goal),
            lambda s, p: s.position[0] - p[0] > 0.4,
        ),
        "attitude": lambda: (
            (0.1, 0, 0, hover),
            lambda s, p: abs(tilt(s)[0] - 0.1 * math.radians(55)) < 0.02,
        ),
        "rates": lambda: ((0, 0, 0.1, hover), lambda s, p: abs(s.rates[2] - 0.1 * math.pi) < 0.02),
        "rotor": lambda: ((hover,) * rotors, still),
        "rpm": lambda: ((airframe.hover_speed() * 30 / math.pi,) * rotors, still),
        "hover_rpm": lambda: ((0.0,) * rotors, still),
        "discrete": lambda: ((5,), lambda s, p: s.velocity[2] > 0.3),
        "discrete_27": lambda: ((1,), lambda s, p: (s.velocity < -0.15).all()),
    }[action]()


def build(airframe, dynamics, controller, action):
    """The aviary, or None where the setpoint levels do not fit and the combination is refused."""
    options = {
        "airframe": airframe,
        "dynamics": dynamics,
        "controller": controller,
        "action": action,
    }
    effects = ("drag", "downwash") if controller == "pid" else ("lag", "drag", "downwash")
    try:
        return bulletuav.Aviary("hover", height=10.0, max_speed=2.0, effects=effects, **options)
    except ValueError as error:
        if "is driven by" in str(error) or "controller 'pid'" in str(error):
            return None
        raise


@pytest.mark.parametrize("controller", ["lee", "pid"])
@pytest.mark.parametrize("dynamics", DYNAMICS)
@pytest.mark.parametrize("airframe", AIRFRAMES)
def test_every_allowed_combination_flies_its_manoeuvre(airframe, dynamics, controller):
    flown = []
    for action in ACTIONS:
        aviary = build(airframe, dynamics, controller, action)
        if aviary is None:
            continue
        aviary.reset(seeds=0)
        start = aviary.swarm.position[0, 0].copy()
        held, arrived = manoeuvre(aviary, action)
        for _ in range(30):
            aviary.step(np.reshape(np.asarray(held, float), (1, 1, -1)))
        assert arrived(
            aviary.swarm.world(0).__class__(*(array[0, 0] for array in aviary.swarm)), start
        ), action
        flown.append(action)
        aviary.close()
    kinematic = dynamics not in ("bullet", "rigid_body")
    crazyflie = airframe in ("cf2x", "cf2p")
    velocities = [
        "velocity",
        "velocity_increment",
        "heading_speed",
        "heading_speed_climb",
        "turn_speed",
        "target_position",
        "discrete",
        "discrete_27",
    ]
    if controller == "pid":
        rotors = ["rotor", "rpm", "hover_rpm"]
        expected = [] if kinematic or not crazyflie else [*velocities, *rotors]
    else:
        accelerated = ["acceleration"] if dynamics == "double_integrator" else []
        expected = [*velocities, *accelerated] if kinematic else list(ACTIONS)
    assert sorted(flown) == sorted(expected)


def test_the_pid_warns_of_lag():
    with pytest.warns(UserWarning, match="made for motors without lag"):
        bulletuav.Aviary("hover", controller="pid", action="velocity").close()


@pytest.mark.parametrize("dynamics", DYNAMICS)
def test_an_airframe_of_ones_own_needs_a_urdf_and_nothing_else(urdf, dynamics):
    """An octocopter, by replacing the rotors of the hummingbird."""
    text = bulletuav.load_airframe("hummingbird").urdf.read_text()
    first, last = text.index("<rotor x"), text.rindex("<rotor x")
    places = [
        (math.cos(k * math.pi / 4), math.sin(k * math.pi / 4), ("cw", "ccw")[k % 2])
        for k in range(8)
    ]
    eight = "".join(
        f'<rotor x="{0.3 * x:.6f}" y="{0.3 * y:.6f}" spin="{spin}"/>' for x, y, spin in places
    )
    changes = (
        (text[first : text.index("/>", last) + 2], eight),
        ("0.716", "1.4"),
        ('radius="0.27"', 'radius="0.4"'),
    )
    own = urdf("hummingbird", *changes, ('robot name="hummingbird"', 'robot name="octo"'))
    options = {"action": "target_position", "height": 5.0, "min_in_place": 0.05}
    aviary = bulletuav.Aviary("hover", airframe=own, dynamics=dynamics, **options)
    aviary.reset(seeds=0)
    for _ in range(120):
        step = aviary.step(aviary.action.encode(aviary.scene.goal))
    assert step.info["success"].all()
    assert aviary.swarm.rotor_speed.shape[-1] == 8
    aviary.close()


@pytest.mark.parametrize("airframe", AIRFRAMES)
def test_all_dynamics_agree_on_a_gentle_flight(airframe):
    """All dynamics cover the same way in three seconds, to a few percent."""
    ways = {}
    for dynamics in DYNAMICS:
        aviary = bulletuav.Aviary(
            "hover", airframe=airframe, dynamics=dynamics, action="velocity", height=10.0
        )
        aviary.reset(seeds=0)
        start = aviary.swarm.position[0, 0].copy()
        for _ in range(90):
            aviary.step(np.array([[(0.2, 0.1, 0.05)]]))
        ways[dynamics] = aviary.swarm.position[0, 0] - start
        aviary.close()
    np.testing.assert_allclose(ways["rigid_body"], ways["bullet"], atol=0.02)
    for way in ways.values():
        np.testing.assert_allclose(way, (3, 1.5, 0.75), atol=0.75)


# Determinism over the product, a covering sample of it in every run


def product():
    for task, dynamics, airframe, action in itertools.product(
        bulletuav.list_tasks(), DYNAMICS, AIRFRAMES, ACTIONS
    ):
        if find_task(task).needs_cables and dynamics != "rigid_body":
            continue
        if (
            dynamics in ("bullet", "rigid_body")
            or ACTION_LEVELS[action] <= KINEMATIC_LEVELS[dynamics]
        ):
            yield task, dynamics, airframe, action


KINEMATIC_LEVELS = {
    "single_integrator": SetpointLevel.VELOCITY,
    "point_mass": SetpointLevel.VELOCITY,
    "double_integrator": SetpointLevel.ACCELERATION,
}
ACTION_LEVELS = {
    "velocity": SetpointLevel.VELOCITY,
    "velocity_increment": SetpointLevel.VELOCITY,
    "acceleration": SetpointLevel.ACCELERATION,
    "heading_speed": SetpointLevel.VELOCITY,
    "heading_speed_climb": SetpointLevel.VELOCITY,
    "turn_speed": SetpointLevel.VELOCITY,
    "target_position": SetpointLevel.POSITION,
    "attitude": SetpointLevel.ATTITUDE,
    "rates": SetpointLevel.RATES,
    "rotor": SetpointLevel.ROTOR,
    "rpm": SetpointLevel.ROTOR,
    "hover_rpm": SetpointLevel.ROTOR,
    "discrete": SetpointLevel.VELOCITY,
    "discrete_27": SetpointLevel.VELOCITY,
}


def covering(cases):
    """A greedy sample in which every pair of values that occurs, occurs."""
    columns = [np.unique(column, return_inverse=True)[1] for column in zip(*cases, strict=True)]
    numbers = []
    for one, other in itertools.combinations(columns, 2):
        _, number = np.unique(one * len(cases) + other, return_inverse=True)
        numbers.append(number + (numbers[-1].max() + 1 if numbers else 0))
    pairs = np.stack(numbers, axis=-1)
    missing = np.ones(pairs.max() + 1, dtype=bool)
    while missing.any():
        best = missing[pairs].sum(axis=-1).argmax()
        missing[pairs[best]] = False
        yield cases[best]


PRODUCT = list(product())
SAMPLE = dict.fromkeys(covering(PRODUCT))
BESIDES = itertools.groupby((case for case in PRODUCT if case not in SAMPLE), lambda case: case[:3])


@pytest.mark.parametrize(
    "cases",
    [
        *(pytest.param([case], id="-".join(case)) for case in SAMPLE),
        *(
            pytest.param(list(cases), id="-".join(case), marks=pytest.mark.slow)
            for case, cases in BESIDES
        ),
    ],
)
def test_same_seed_same_bits(cases):
    for case in cases:
        check_same_bits(*case)


OWN_OPTIONS = {
    "pad_landing": {"d_safe": 0.8, "observation": ("velocity", "pad_clue", "claimed_pads")},
    "transport": {"d_safe": 0.8, "load_mass": 0.005},
}
"""Options with which tasks suit all airframes, and have no pictures"""


def check_same_bits(task, dynamics, airframe, action):
    # Crazyflies are slower than the usual queue
    slow = {"speed": (4.0, 6.5), "horizon": 3000}
    slow = slow if task == "pursuit" and airframe.startswith("cf") else {}
    runs = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        aviary = bulletuav.Aviary(
            task,
            2,
            num_drones=2,
            dynamics=dynamics,
            airframe=airframe,
            action=action,
            turbulence="light",
            **slow,
            **OWN_OPTIONS.get(task, {}),
            **placing.small_cities(task),
        )
    for past in (0, 1):
        if past:
            aviary.reset(seeds=99)
            aviary.step(_random(aviary, 5))
        bits = [aviary.reset(seeds=0).tobytes()]
        for k in range(8):
            step = aviary.step(_random(aviary, k, other=past))
            bits += [
                array[0].tobytes() for array in (*step[:4], *step.info.values(), *aviary.swarm)
            ]
        runs.append(b"".join(bits))
    assert runs[0] == runs[1]
    aviary.close()


def _random(aviary, seed, other=0):
    """Random actions of world 0 from `seed`, of world 1 from another stream."""
    rngs = (np.random.default_rng(seed), np.random.default_rng(1000 + seed + 100 * other))
    actions = np.array([rng.uniform(aviary.action.low, aviary.action.high) for rng in rngs])
    return np.floor(actions) if aviary.action.choices else actions
