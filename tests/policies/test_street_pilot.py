"""Policies that fly through cities by what they observe: maps by hand, and whole flights."""

import numpy as np
import pytest
from placing import city_of

import bulletuav
from bulletuav.policies import find_policy
from bulletuav.policies.lidar_hop import LidarHop
from bulletuav.policies.over_roofs import OverRoofs, next_phase
from bulletuav.policies.readings import cruise_height_difference, decode_goal_offset
from bulletuav.policies.street_map import EVIDENCE, inflate, level_beams, update_maps
from bulletuav.policies.street_pilot import StreetPilot
from bulletuav.tasks import find_task
from bulletuav.tasks.frame import Spawn

PILOTS = (OverRoofs, LidarHop, StreetPilot)
WALL = city_of(((10, -50, 0), (20, 50, 60)))
COMPASS = np.array([(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)])
REACH = 60.0


def look(ranges, directions=COMPASS, evidence=None):
    """The map, 20 by 20 cells of 2 m, of a drone in its cell (10, 10)."""
    evidence = np.zeros((1, 1, 20, 20), np.int8) if evidence is None else evidence
    place = np.full((1, 1, 2), 21.0)
    looks = np.ones((1, 1), dtype=bool)
    update_maps(evidence, place, np.array([[ranges]], float), directions, REACH, looks)
    return evidence


def test_a_hit_is_marked_where_it_is_and_nothing_else():
    """6 m east of (21, 21) is (27, 21), in the cell (13, 10)."""
    seen = look([6.0, REACH, REACH, REACH])[0, 0]
    assert np.argwhere(seen).tolist() == [[13, 10]]
    assert seen[13, 10] == EVIDENCE


def test_hits_of_one_wall_are_joined_and_those_of_two_are_not():
    """Beams at 0 and 45 degrees to a wall 6 m east end 6 m apart; of 20 m they end 20 m apart."""
    aside = np.sqrt(0.5)
    directions = np.array([(1.0, 0.0), (aside, aside), (-1.0, 0.0)])
    seen = look([6.0, 6.0 / aside, REACH], directions)[0, 0]
    assert np.argwhere(seen).tolist() == [[13, 10], [13, 11], [13, 12], [13, 13]]
    seen = look([16.0, 16.0 / aside, REACH], directions)[0, 0]
    assert np.argwhere(seen).tolist() == [[18, 10], [18, 18]]


def test_what_beams_pass_through_fades():
    evidence = look([6.0, REACH, REACH, REACH])
    for left in range(EVIDENCE - 1, -1, -1):
        look([14.0, REACH, REACH, REACH], evidence=evidence)
        assert evidence[0, 0, 13, 10] == left
    assert evidence[0, 0, 17, 10] == EVIDENCE


def test_walls_grow_by_two_cells_and_edges_are_walls():
    evidence = np.zeros((9, 9), np.int8)
    evidence[4, 4] = 1
    occupied = np.zeros((11, 11, 3), dtype=bool)
    inflate(evidence, occupied, np.full(2, -np.inf), np.array([np.inf, 16.0]))
    free = ~occupied[1:-1, 1:-1, 1]
    taken = {(a, b) for a, b in np.argwhere(~free).tolist() if b < 8}
    assert taken == {(a, b) for a in range(9) for b in range(9) if (a - 4) ** 2 + (b - 4) ** 2 <= 4}
    assert not free[:, 8].any()  # which ends at 18 m
    assert occupied[:, :, (0, 2)].all()


def test_the_height_of_the_crossing_by_hand():
    """5 m below the ceiling it is 2.5 m up; 55 m above the goal it is 5 m down."""
    offset = np.array([(30.0, 0.0, 2.0), (30.0, 0.0, -55.0)])
    room = np.full((2, 6), 60.0)
    room[0, 2] = 5.0
    np.testing.assert_allclose(cruise_height_difference(offset, room), (2.5, -5.0))
    pieces = next_phase(offset, np.array((2.5, -0.5)))
    np.testing.assert_allclose(pieces, [(0, 0, 2.5), (30, 0, -0.5)])
    np.testing.assert_allclose(next_phase(np.array([(1.0, 0, -9)]), np.zeros(1)), [(1, 0, -9)])
    np.testing.assert_allclose(decode_goal_offset(np.array((0.6, 0.0, -0.8, 10.0))), (6, 0, -8))


@pytest.fixture
def put():
    """Builds worlds of drones at given places that fly what they are told at once."""
    made = []

    def one(city, start, goal, worlds=1, **options):
        class Placed(find_task("lidar_navigation")):
            name = "placed"

            def spawn(self, rng):
                where, to = np.array(start, float), np.array(goal, float)
                return Spawn(position=where, goal=to, layout=0)

        given = {"dynamics": "single_integrator", "num_drones": len(start), "leg": 20.0}
        made.append(bulletuav.Aviary(Placed, worlds, city=city, **given, **options))
        return made[-1]

    yield one
    for aviary in made:
        aviary.close()


def fly(aviary, kind, seeds=0):
    observations = aviary.reset(seeds=seeds)
    policy = kind(aviary)
    policy.reset(np.ones(aviary.num_worlds, dtype=bool))
    path, success = [], np.zeros(aviary.alive.shape, dtype=bool)
    while aviary.alive.any():
        step = aviary.step(policy.act(observations, aviary.swarm))
        observations = step.observations
        path.append(aviary.swarm.position.copy())
        success |= step.info["success"]
    return np.array(path), success


def test_no_wall_is_flown_straight(put):
    aviary = put(city_of(((60, 60, 0), (70, 70, 5))), [(-60, 0, 12.5)], [(60, 0, 12.5)])
    path, success = fly(aviary, StreetPilot)
    assert success.all()
    assert np.abs(path[..., 1]).max() < 0.1


@pytest.mark.parametrize(("kind", "comes"), [(OverRoofs, False), (StreetPilot, True)])
def test_who_looks_flies_around_a_wall_higher_than_the_ceiling(put, kind, comes):
    path, success = fly(put(WALL, [(-30, 5, 10)], [(60, 0, 10)]), kind)
    assert success.all() == comes
    if comes:  # around an end of the wall, with room
        beside = path[(path[:, 0, 0, 0] > 10) & (path[:, 0, 0, 0] < 20), 0, 0, 1]
        assert (np.abs(beside) > 51).all()


def test_a_low_wall_is_hopped_over(put):
    low = city_of(((10, -50, 0), (20, 50, 20)))
    path, success = fly(put(low, [(-30, 0, 10)], [(60, 0, 10)], ceiling=40.0), LidarHop)
    assert success.all()
    assert 20 < path[..., 2].max() < 40


def test_a_map_without_a_way_is_forgotten(put):
    """Its evidence all about the goal is wrong: the drone forgets it, and comes there."""
    aviary = put(city_of(((60, 60, 0), (70, 70, 5))), [(-30, 0, 12.5)], [(60, 0, 12.5)])
    pilot = StreetPilot(aviary)
    observations = aviary.reset(seeds=0)
    pilot.reset(np.ones(1, dtype=bool))
    pilot.act(observations, aviary.swarm)
    pilot._evidence[:] = EVIDENCE
    pilot._plan(0, 0)
    assert not pilot._evidence.any()
    assert pilot._count[0, 0] == 2


@pytest.mark.parametrize("kind", PILOTS)
def test_a_world_does_not_depend_on_the_others(kind):
    """World k of four is the world of seed k alone, to the last bit, and so is a second flight."""
    town = {"area": 250.0, "leg": 100.0, "num_layouts": 2, "horizon": 60}
    options = {"dynamics": "single_integrator", **town}
    many = bulletuav.Aviary("lidar_navigation", 4, **options)
    paths, _ = fly(many, kind, 5)
    np.testing.assert_array_equal(fly(many, kind, 5)[0], paths)
    one = bulletuav.Aviary("lidar_navigation", 1, **options)
    for k in range(4):
        alone = fly(one, kind, 5 + k)[0]
        np.testing.assert_array_equal(alone[:, 0], paths[: len(alone), k])
    many.close()
    one.close()


@pytest.mark.parametrize("kind", PILOTS)
def test_form_and_scale_of_observations_change_nothing(put, kind):
    """But for the rounding of float32."""
    actions = []
    for form in ({}, {"normalise": True}, {"observation_format": "dict"}):
        aviary = put(WALL, [(-30, 5, 10)], [(60, 0, 10)], **form)
        observations = aviary.reset(seeds=0)
        actions.append(kind(aviary).act(observations, aviary.swarm))
    np.testing.assert_allclose(actions[1], actions[0], atol=1e-4)
    np.testing.assert_array_equal(actions[2], actions[0])


@pytest.mark.parametrize(
    ("kind", "block"),
    [(OverRoofs, "room"), (OverRoofs, "goal"), (LidarHop, "lidar"), (StreetPilot, "velocity")],
)
def test_a_block_that_is_not_observed_is_told_with_the_remedy(put, kind, block):
    kept = [one for one in ("velocity", "goal", "room", "lidar") if one != block]
    aviary = put(WALL, [(-30, 5, 10)], [(60, 0, 10)], observation=kept)
    with pytest.raises(ValueError, match=f"needs the observation block '{block}'"):
        kind(aviary)


def test_level_beams_are_needed(put):
    aviary = put(WALL, [(-30, 5, 10)], [(60, 0, 10)], lidar_elevations=(-45.0, 0.0), num_beams=4)
    chosen, directions = level_beams(aviary)
    assert chosen.tolist() == [4, 5, 6, 7]
    np.testing.assert_allclose(directions, COMPASS, atol=1e-15)
    aviary = put(WALL, [(-30, 5, 10)], [(60, 0, 10)], lidar_elevations=(-45.0,))
    with pytest.raises(ValueError, match="set lidar_elevations=0"):
        level_beams(aviary)


def test_they_are_found_by_their_names_and_see_observations_only():
    for kind in PILOTS:
        spec = find_policy(kind.name)
        assert spec.make is kind
        assert not spec.reads_swarm
