"""Pairs keep their momentum, gain no energy, rebound as they should, and part again."""

import numpy as np
import pytest
from contact.pairs import HEIGHT, KINDS, meet_in_pairs
from contact.rig import Rig

from bulletuav.contact.time_of_impact import CONTACT_DISTANCE


@pytest.mark.parametrize("restitution", [0.0, 0.6, 1.0])
@pytest.mark.parametrize("kind", KINDS)
def test_pairs_keep_what_they_must(kind, restitution):
    meetings = meet_in_pairs(kind, restitution=restitution, worlds=30)
    assert not meetings.missed()


@pytest.mark.parametrize("hz", [60, 240, 1000])
@pytest.mark.parametrize("airframes", [("cf2x", "iris"), ("racer", "hummingbird")])
def test_unlike_pairs_keep_what_they_must(airframes, hz):
    meetings = meet_in_pairs("spinning", airframes, hz=hz, worlds=12, speed=(2.0, 20.0))
    assert not meetings.missed()


@pytest.mark.parametrize("restitution", [0.0, 0.25, 1.0])
def test_restitution_is_as_set(restitution):
    meetings = meet_in_pairs("head-on", restitution=restitution, worlds=12)
    np.testing.assert_allclose(meetings.rebound, restitution, atol=1e-8)


@pytest.mark.parametrize("late", [1e-2, 1e-3, 1e-4, 3e-6, 1e-7])
def test_impacts_at_the_end_of_a_substep_keep_momentum_in_the_next(late):
    """The impulse of so short a rest must not be what the next substep begins with."""
    velocity = np.array([1.9, 2.7, 0.0])
    fast = np.linalg.norm(velocity)
    with Rig(["cf2x"] * 2, gravity=0.0) as rig:
        apart = 2 * rig.airframes[0].shape.half[0] + CONTACT_DISTANCE + (2 - late) * fast * rig.dt
        rig.swarm.position[:] = 0.0, 0.0, HEIGHT
        rig.swarm.position[0, 1] += apart * velocity / fast
        rig.swarm.velocity[0, 0] = velocity
        rig.place()
        before = rig.momentum().sum(axis=1)
        recorded = [len(rig.fly().world) for _ in range(4)]
        change = rig.momentum().sum(axis=1) - before
    assert recorded[:3] == [0, 2, 2]
    assert np.abs(change).max() < 1e-12 * np.abs(before).max()


def test_a_slow_touch_in_free_fall_keeps_angular_momentum():
    """These two close slowly, like drones at rest, but nothing supports them."""
    with Rig(["cf2p"] * 2, hz=60, gravity=0.0) as rig:
        swarm = rig.swarm
        swarm.position[0] = [(-0.109209117, -0.068116194, 300), (-0.189805881, -0.103775431, 300)]
        swarm.position[0, :, 2] += -0.087341814, -0.070008565
        swarm.quaternion[0, 0] = -0.130836306, 0.348989364, 0.9246185, -0.078542434
        swarm.quaternion[0, 1] = -0.267123029, 0.600558110, -0.096346711, 0.747457394
        swarm.velocity[0] = [
            (-1.592646983, -1.432213956, -4.087225947),
            (-0.87175722, 0.018232188, 2.384102677),
        ]
        swarm.rates[0] = [
            (31.484351843, -35.024580053, 57.403995518),
            (-54.47418343, 15.796165816, -29.532969389),
        ]
        rig.place()
        speed = np.linalg.norm(swarm.velocity[0], axis=-1).sum()
        scale = rig.rows["mass"][0, 0] * speed * rig.airframes[0].collision_radius
        before = rig.spin_momentum().sum(axis=1)
        assert len(rig.fly().world) == 2
        assert np.linalg.norm(rig.spin_momentum().sum(axis=1) - before) < 1e-4 * scale


@pytest.mark.parametrize("hz", [60, 240])
@pytest.mark.parametrize("common", [(0.0, 0.0, 0.0), (5.0, 0.0, 0.0), (0.0, 3.0, -5.0)])
def test_overlaps_end_however_fast_both_fly(common, hz):
    """What parts them gives energy, which is more where they fly fast."""
    with Rig(["cf2x"] * 2, hz=hz, gravity=0.0) as rig:
        rig.swarm.position[0] = 0.0, 0.0, HEIGHT
        rig.swarm.position[0, 1, 1] += 2 * rig.airframes[0].shape.half[0] - 1e-3
        rig.swarm.velocity[:] = common
        rig.swarm.velocity[0, 1, 1] -= 1e-3
        rig.place().fly_for(1.0)
        assert rig.gaps(0, 1)[0] > 0.0
