"""What tasks, infos and callers are told of contacts, and of drones at rest."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

import bulletuav
from bulletuav.tasks import end, find_task, reward
from bulletuav.tasks.frame import Frame
from bulletuav.vehicle.airframe import STANDARD_GRAVITY
from bulletuav.vehicle.airframes import load_airframe
from bulletuav.vehicle.swarm import FIRST_OBSTACLE, GROUND, Contacts, Swarm

OFF = np.full((1, 1, 4), -1.0)
"""Rotors that stand still"""
START = ((0.0, 0.0, 0.2),)


@end
def landed(resting: bool) -> bool:
    return resting


@reward
def knock(impulse: float) -> float:
    return impulse


class Land(find_task("hover")):
    """Come down on the ground and stay there."""

    name = "land"
    reward = {"knock": (knock, -2.0)}  # noqa: RUF012
    ends = (landed,)


def contacts(*rows):
    """Contacts of (world, drone, other, impulse), whose points tell their rows."""
    world, drone, other, impulse = (np.array(column) for column in zip(*rows, strict=True))
    point = np.arange(3.0 * len(rows)).reshape(-1, 3)
    depth = np.arange(len(rows)) / 10
    return Contacts(world, drone, other, impulse, point, point + 100, point + 200, depth)


def frame(swarm, touched):
    """A frame of two worlds of three drones."""
    rest = dict.fromkeys(("before", "action", "scene", "time", "last", "goal_before"))
    alive = np.ones((2, 3), dtype=bool)
    return Frame(
        after=swarm, read_contacts=lambda: touched, alive=alive, d_safe=1.0, zone=2.0, **rest
    )


def test_a_drone_rests_that_touches_and_hardly_moves():
    swarm = Swarm.zeros(2, 3, 4)
    swarm.velocity[0, 1] = 0.0028, 0.0042, 0.0084  # 0.0098 in all
    swarm.rates[0, 1] = 0.028, 0.042, 0.084  # 0.098
    swarm.velocity[0, 2] = 0.003, 0.0045, 0.009  # 0.0105
    swarm.rates[1, 0] = 0.03, 0.045, 0.09  # 0.105
    touched = contacts(
        (0, 0, GROUND, 0.5), (0, 1, GROUND, 0.1), (0, 2, GROUND, 0.1), (1, 0, GROUND, 0.1)
    )
    told = frame(swarm, touched).resting
    assert told.tolist() == [[True, True, False], [False, False, False]]
    assert told.dtype == bool
    assert not frame(swarm, Contacts.none()).resting.any()  # in the air at the top of a climb


def test_the_impulse_is_the_greatest_of_a_contact():
    touched = contacts(
        (0, 1, FIRST_OBSTACLE, 0.25), (0, 1, GROUND, 0.75), (0, 1, 2, 0.5), (0, 2, 1, 0.5)
    )
    told = frame(Swarm.zeros(2, 3, 4), touched).impulse
    assert told.tolist() == [[0.0, 0.75, 0.5], [0.0, 0.0, 0.0]]
    assert not frame(Swarm.zeros(2, 3, 4), Contacts.none()).impulse.any()


def test_joined_contacts_are_sorted_and_tell_each_touch_once():
    first = contacts((0, 1, GROUND, 0.25), (1, 0, GROUND, 0.5))
    both = first.joined(contacts((1, 0, GROUND, 0.0), (0, 1, FIRST_OBSTACLE, 1.0)))
    assert both.world.tolist() == [0, 0, 1]
    assert both.other.tolist() == [FIRST_OBSTACLE, GROUND, GROUND]
    assert both.impulse.tolist() == [1.0, 0.25, 0.5]
    np.testing.assert_array_equal(both.normal[1:], first.normal)


@pytest.fixture(scope="module", params=["rigid_body", "bullet"])
def fallen(request):
    """A cf2x without air that fell from 0.2 m above its place on the ground: its last decision."""
    aviary = bulletuav.Aviary(Land, dynamics=request.param, effects=(), start=START)
    aviary.reset(seeds=0)
    height = aviary.swarm.position[0, 0, 2]
    while not len(aviary.contacts.world):
        before = aviary.swarm.copy()
        step = aviary.step(OFF)
    yield SimpleNamespace(aviary=aviary, step=step, before=before, height=height)
    aviary.close()


def test_a_fall_is_told_as_mechanics_say(fallen):
    airframe = load_airframe("cf2x")
    (row,) = zip(*fallen.aviary.contacts, strict=True)
    world, drone, other, impulse, point, normal, velocity, depth = row
    assert (world, drone, other) == (0, 0, GROUND)
    np.testing.assert_allclose(normal, (0, 0, 1), atol=1e-12)
    assert depth == 0  # they met at their surfaces
    # Met at the speed of the fall, sqrt(2 g h), where its underside was above the ground
    middle = fallen.aviary.swarm.position[0, 0]
    speed = math.sqrt(2 * STANDARD_GRAVITY * (fallen.height - middle[2]))
    substep = STANDARD_GRAVITY / fallen.aviary.options.physics_hz
    np.testing.assert_allclose(velocity, (0, 0, -speed), rtol=0, atol=substep)
    assert np.linalg.norm(point[:2] - middle[:2]) <= airframe.collision_radius
    assert 0 <= point[2] <= 1e-4
    # What momentum changed, beside what weight gave in the decision, came from the ground
    weight = STANDARD_GRAVITY / fallen.aviary.options.decision_hz
    change = fallen.aviary.swarm.velocity[0, 0, 2] - fallen.before.velocity[0, 0, 2]
    assert impulse == pytest.approx(airframe.mass * (change + weight), rel=1e-6)
    info = fallen.step.info
    assert info["impulse"].tolist() == [[impulse]]
    assert info["resting"].tolist() == info["collision"].tolist() == [[True]]
    assert fallen.step.rewards[0, 0] == -2 * impulse
    assert fallen.step.terminated.tolist() == [[True]]


def test_contacts_are_copies(fallen):
    for column in fallen.aviary.contacts:
        column[:] = 7
    assert (fallen.aviary.contacts.other == GROUND).all()


def test_a_reset_forgets_the_contacts_of_its_worlds_alone():
    options = {"num_drones": 2, "start": (*START, (1.0, 0.0, 0.2)), "effects": ()}
    aviary = bulletuav.Aviary("hover", 3, dynamics="rigid_body", **options)
    with pytest.raises(RuntimeError, match="call reset"):
        aviary.contacts  # noqa: B018
    aviary.reset(seeds=0)
    assert not len(aviary.contacts.world)
    action = np.ones((3, 2, 4))
    action[0, 1] = action[2, 0] = -1.0
    while not len(aviary.contacts.world):
        aviary.step(action)
    before = aviary.contacts
    assert before.world.tolist() == [0, 2]
    assert before.drone.tolist() == [1, 0]
    aviary.reset(np.array([True, False, False]))
    after = aviary.contacts
    assert after.world.tolist() == [2]
    for ours, theirs in zip(after, before, strict=True):
        np.testing.assert_array_equal(ours[0], theirs[1])
    info = aviary.first_info()
    assert info["collision"].tolist() == [[False, False], [False, False], [True, False]]
    assert info["impulse"][2, 0] == before.impulse[1]
    aviary.close()


def test_all_environment_classes_tell_rest_and_impulse():
    options = {"dynamics": "rigid_body", "effects": (), "start": START}
    aviary = bulletuav.Aviary(Land, **options)
    aviary.reset(seeds=0)
    batch = bulletuav.batch_env(Land, 1, **options)
    parallel = bulletuav.parallel_env(Land, **options)
    batch.reset(seed=0)
    parallel.reset(seed=0)
    while aviary.alive.any():
        told = aviary.step(OFF).info
        infos = (batch.step(OFF)[-1], parallel.step({"drone_0": OFF[0, 0]})[-1]["drone_0"])
        for name in ("resting", "impulse"):
            assert [np.asarray(info[name]).item() for info in infos] == [told[name].item()] * 2
    assert told["resting"].all()
    assert parallel.aviary.contacts.other.tolist() == [GROUND]
    for env in (aviary, batch, parallel):
        env.close()


@pytest.mark.parametrize("name", ["resting", "impulse"])
def test_a_task_cannot_tell_them_itself(name):
    class Telling(Land):
        def info(self, frame):
            return {**super().info(frame), name: frame.impulse}

    aviary = bulletuav.Aviary(Telling)
    with pytest.raises(ValueError, match=f"'{name}', which is a standard info"):
        aviary.reset()
    aviary.close()
