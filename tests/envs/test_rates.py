"""Decisions of more than a second, and limits of climbs."""

import numpy as np
import pytest
from placing import OPEN

import bulletuav
from bulletuav.envs.rates import decision_rate, picture_rate

SINGLE = {"dynamics": "single_integrator", "num_drones": 1, "num_users": 2, "city": OPEN}
EAST, UP = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)


@pytest.mark.parametrize(
    ("rate", "physics_hz", "substeps"), [(0.5, 240, 480), (0.1, 240, 2400), (1 / 3, 240, 720)]
)
def test_decisions_of_whole_substeps_can_be_long(rate, physics_hz, substeps):
    assert decision_rate(rate, physics_hz) == rate
    aviary = bulletuav.Aviary("los", decision_hz=rate, **SINGLE)
    assert aviary.options.substeps == substeps
    aviary.reset(seeds=0)
    before = aviary.swarm.position.copy()
    speed = aviary.options.max_speed
    step = aviary.step(np.broadcast_to((0.0, 0.0, 0.01), (1, 1, 3)))
    way = aviary.swarm.position - before
    np.testing.assert_allclose(way, [[(0, 0, 0.01 * speed / rate)]], rtol=1e-9)
    assert aviary.worlds.frame.time[0] == pytest.approx(1 / rate)
    assert np.isfinite(step.rewards).all()
    aviary.close()


@pytest.mark.parametrize(
    ("rate", "said"),
    [
        (0.05, "decision_hz is 0.05: at least 0.1 is needed"),
        (0.7, "342.857 substeps of physics_hz 240: a whole number is needed, try 240/343"),
        (0, "decision_hz is 0: a whole number, at least 1"),
        (-0.5, "decision_hz is -0.5: a whole number"),
        (1.5, "decision_hz is 1.5: a whole number"),
        (7, r"decision_hz 7 does not divide physics_hz 240: try \[5, 6, 8\]"),
        ("1", "decision_hz is '1': a whole number"),
    ],
)
def test_other_rates_are_refused(rate, said):
    with pytest.raises(ValueError, match=said):
        decision_rate(rate, 240)


def test_pictures_divide_decisions():
    assert picture_rate(5, 10) == 5
    with pytest.raises(ValueError, match="camera_hz 3 does not divide decision_hz 10"):
        picture_rate(3, 10)
    with pytest.raises(ValueError, match="camera_hz is 1, and decision_hz 0.5: leave it out"):
        picture_rate(1, 0.5)


@pytest.mark.parametrize("dynamics", ["rigid_body", "bullet"])
def test_a_decision_of_two_seconds_is_two_of_one(dynamics):
    """The same commands: the same flight, but for where decisions end."""
    ends = []
    for rate, decisions in ((0.5, 1), (1, 2)):
        options = {"dynamics": dynamics, "decision_hz": rate, "max_speed": 5.0}
        aviary = bulletuav.Aviary("hover", action="velocity", **options)
        aviary.reset(seeds=0)
        for _ in range(decisions):
            aviary.step(np.broadcast_to((0.2, 0.0, 0.2), (1, 1, 3)))
        ends.append(aviary.swarm.position.copy())
        aviary.close()
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)


def aviary(**options):
    given = {**SINGLE, "max_speed": 10.0, "max_climb": 4.0, "decision_hz": 10, **options}
    made = bulletuav.Aviary("los", **given)
    made.reset(seeds=0)
    return made


def commanded(made, action):
    made.step(np.broadcast_to(np.array(action, dtype=float), made.given.shape))
    return made.commanded[0, 0]


@pytest.mark.parametrize(
    ("action", "given", "expected"),
    [
        ("velocity", UP, (0, 0, 4)),
        ("velocity", EAST, (10, 0, 0)),
        ("velocity", (0.6, 0, -0.5), (6, 0, -2)),
        ("velocity", (1, 0, 1), np.array((10, 0, 4)) * 10 / 116**0.5),
        ("velocity_increment", UP, (0, 0, 1)),
        ("heading_speed", (0.0, -1, -1), (0, 0, -4)),
        ("turn_speed", (0.0, -1, -1), (0.01, 0, -4)),
        ("discrete", (5,), (0, 0, 4)),
        ("discrete", (1,), (10, 0, 0)),
    ],
)
def test_climbs_are_limited(action, given, expected):
    made = aviary(action=action)
    np.testing.assert_allclose(commanded(made, given), expected, atol=1e-9)
    made.close()


def test_increments_stop_at_the_limit():
    made = aviary(action="velocity_increment")
    for k in range(1, 8):
        assert commanded(made, UP)[2] == pytest.approx(min(k, 4))
    made.close()


@pytest.mark.parametrize("action", ["velocity", "velocity_increment"])
def test_what_is_encoded_is_flown_or_keeps_its_direction(action):
    rng = np.random.default_rng(0)
    for _ in range(20):
        made = aviary(action=action, decision_hz=1)
        wanted = rng.normal(size=3)
        wanted *= rng.uniform(0, 10) / np.linalg.norm(wanted)
        code = made.action.encode(wanted[None, None], made.commanded)
        flown = commanded(made, code[0, 0])
        share = min(1.0, 4 / abs(wanted[2]))
        np.testing.assert_allclose(flown, share * wanted, atol=1e-9)
        made.close()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"max_climb": 0.0}, "max_climb is 0 m/s: it must be above 0"),
        ({"max_climb": float("nan")}, "max_climb is nan"),
        ({"max_climb": 3.0, "action": "rates"}, "commands? velocities, and 'rates' does not"),
    ],
)
def test_limits_that_cannot_be_are_refused(options, said):
    with pytest.raises(ValueError, match=said):
        bulletuav.Aviary("hover", **options)


def test_no_limit_is_max_speed():
    plain = bulletuav.Aviary("los", max_speed=10.0, **SINGLE)
    plain.reset(seeds=0)
    np.testing.assert_allclose(commanded(plain, UP), (0, 0, 10))
    plain.close()
