"""Resets of some worlds give what resets of all would, and leave the others as they are."""

import numpy as np
import pytest

from bulletuav import Aviary
from bulletuav.sensors.base import Label
from bulletuav.tasks.frame import Spawn
from bulletuav.tasks.ingredients import block


@block([Label("nearest before", "m", 0.0, 1e3)])
def nearest(separation):
    return min(separation, 1e3)


CASES = {
    "hover": {"num_drones": 3, "dynamics": "rigid_body"},
    "crossing": {"dynamics": "point_mass", "horizon": 7},
    "obstacles": {"dynamics": "single_integrator", "num_drones": 4, "num_moving": 6},
}


def flight(task, options, by_whole):
    """What an aviary of 5 worlds tells, some of which are reset now and then."""
    aviary = Aviary(task, 5, **options)
    told = [aviary.reset(seeds=2)]
    rng = np.random.default_rng(4)
    for k in range(16):
        step = aviary.step(rng.uniform(-1, 1, aviary.given.shape))
        told += [step.observations, step.rewards]
        if k % 4 == 3:
            if by_whole:
                aviary.simulation.start.by_world_programs = None
            assert (aviary.simulation.start.by_world_programs is None) == by_whole
            mask = np.arange(5) == k % 5
            mask[2] = k == 7
            told += [aviary.reset(mask), aviary.state(), *aviary.first_info().values()]
            told += [aviary.reset(mask), *aviary.first_info().values(), aviary.state()]
    aviary.close()
    return told


@pytest.mark.parametrize("task", CASES)
def test_fresh_worlds_alone_give_the_same_bits_as_all(task):
    alone, whole = (flight(task, CASES[task], by_whole) for by_whole in (False, True))
    for one, other in zip(alone, whole, strict=True):
        np.testing.assert_array_equal(one, other)


def test_observations_of_a_whole_decision_are_made_anew_in_all_worlds():
    aviary = Aviary("hover", 5, **CASES["hover"], observation=("goal_offset", nearest))
    aviary.reset(seeds=2)
    aviary.step(np.zeros(aviary.given.shape))
    assert aviary.simulation.start.by_world_programs is None
    aviary.close()


def test_starts_of_several_worlds_are_those_of_each_alone():
    together, alone = (Aviary("hover", 3, num_drones=2, dynamics="rigid_body") for _ in range(2))
    together.reset(seeds=5)
    for k in range(3):
        alone.reset(np.arange(3) == k, seeds=5)
    for one, other in zip(together.swarm, alone.swarm, strict=True):
        np.testing.assert_array_equal(one, other)
    assert together.state_hash() == alone.state_hash()
    together.close()
    alone.close()


@pytest.mark.parametrize("task", ["hover", "obstacles"])
def test_first_infos_of_fresh_worlds_are_those_of_all(task):
    told = []
    for of_all in (False, True):
        aviary = Aviary(task, 5, **CASES[task])
        aviary.reset(seeds=2)
        aviary.step(np.zeros(aviary.given.shape))
        fresh = np.arange(5) == 3
        aviary.reset(fresh)
        told.append(dict(aviary.first_info(None if of_all else fresh)))
        aviary.close()
    assert list(told[0]) == list(told[1])
    for name, value in told[0].items():
        np.testing.assert_array_equal(value[3], told[1][name][3])


def test_starts_are_taken_in_whatever_form_they_are_given():
    aviary = Aviary("hover", 4, num_drones=2, dynamics="rigid_body")
    rows, take = aviary.simulation.start.starts.rows, aviary.simulation.start.starts.store
    place = np.array([[0.0, 0.0, 2.0], [5.0, 0.0, 3.0]])
    usual = Spawn(place, place)
    swift = usual._replace(velocity=2.0, rates=np.array([0.0, 0.0, 1.0]))
    mixed = Spawn(place.astype(np.float32), place.tolist(), velocity=np.ones((2, 3)))
    aside = usual._replace(quaternion=np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)))
    points = [usual._replace(velocity=np.array(speed)) for speed in (0.5, 0.6)]
    shared = [usual._replace(velocity=np.full((1, 3), speed)) for speed in (0.5, 0.6)]
    various = ([usual] * 4, [swift], [usual, swift, mixed, aside], [mixed] * 3, [usual] * 2)
    for starts in (*various, points[:1], points, shared, [*points, *shared]):
        take(starts)
        for k, start in enumerate(starts):
            for name in ("position", "goal", "velocity", "quaternion", "rates", "goal_velocity"):
                given = np.broadcast_to(getattr(start, name), rows[name][k].shape)
                np.testing.assert_array_equal(rows[name][k], given)
    # Whatever comes together has to fit one by one
    wide = usual._replace(velocity=np.zeros((2, 4)))
    for starts in ([wide], [usual._replace(velocity=np.zeros((2, 3))), wide]):
        with pytest.raises(ValueError, match=r"velocity .* has shape \(2, 4\)"):
            take(starts)
    aviary.close()


def test_worlds_that_were_never_flown_keep_their_observations():
    aviary = Aviary("hover", 3, num_drones=2, dynamics="rigid_body")
    first = aviary.reset(seeds=1)
    aviary.first_info()
    again = aviary.reset(np.arange(3) == 1)
    np.testing.assert_array_equal(again[[0, 2]], first[[0, 2]])
    assert (again[1] != first[1]).any()
    aviary.close()
