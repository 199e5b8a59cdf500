"""Table `quadswarm`: rooms with cylinders, flights in them, and the table."""

import numpy as np
import pytest

from bulletuav.reproduction.cylinder_rooms import (
    CYLINDER_RADIUS,
    DRONE_RADIUS,
    HEIGHTS,
    MIN_HEIGHT_DIFFERENCE,
    CylinderRoom,
    draw_cylinder_room,
    find_common_cell,
    find_cylinder_collisions,
    fly_cylinder_rooms,
)
from bulletuav.reproduction.table import Settings
from bulletuav.reproduction.tables.quadswarm import DENSITIES, EPISODES, PILOTS, REPRODUCTION


def room(start, goal, cylinder=()):
    ends = (np.array(one, float).reshape(-1, 3) for one in (start, goal))
    return CylinderRoom(*ends, np.array(cylinder, float).reshape(-1, 2))


@pytest.mark.parametrize(("density", "count"), [(0.0, 0), (0.2, 12), (0.4, 25), (0.8, 51)])
def test_cylinders_starts_and_goals_are_in_different_cells(density, count):
    drawn = draw_cylinder_room(np.random.default_rng(1), 8, density, "random")
    assert drawn.cylinder.shape == (count, 2)
    for place in (drawn.start, drawn.goal):
        cells = np.concatenate([drawn.cylinder, place[:, :2]])
        assert len(np.unique(cells, axis=0)) == count + 8
        # Centres of the cells of 1 m in an area of 8 m
        assert set(np.unique(np.abs(cells))) <= {0.5, 1.5, 2.5, 3.5}
        assert ((place[:, 2] >= HEIGHTS[0]) & (place[:, 2] <= HEIGHTS[1])).all()


def test_more_drones_than_cells_are_above_each_other():
    drawn = draw_cylinder_room(np.random.default_rng(2), 32, 0.8, "random")
    cells, count = np.unique(drawn.start[:, :2], axis=0, return_counts=True)
    assert len(cells) == 64 - 51
    assert set(count) == {2, 3}
    for cell in cells:
        heights = np.sort(drawn.start[(drawn.start[:, :2] == cell).all(axis=1), 2])
        assert (np.diff(heights) >= MIN_HEIGHT_DIFFERENCE).all()


@pytest.mark.parametrize(
    ("rows", "cell"),
    [
        # Found by hand. Row 0 and column 0 count as free where they have a cylinder (#)
        # 3 x 3 free cells at rows 2 to 4 and columns 1 to 3
        ((".....", ".#..#", ".....", ".....", "....#"), (3, 2)),
        # 2 x 2: the first by row at rows 1 and 2 and columns 2 and 3; its centre is the lower right
        ((".....", ".#..#", ".....", "#....", "...#."), (2, 3)),
        # Cylinders of row 0 make 2 x 3 free cells below to a square
        ((".###.", ".....", ".....", "#####", "....."), (1, 2)),
        # Single cells: free ones of row 0 and column 0 do not count
        ((".....", ".####", ".####", ".##.#", ".####"), (3, 3)),
        ((".....", ".####", ".####", ".####", ".####"), (0, 0)),
        # Even size: 4 x 4
        ((".....", ".....", ".....", ".....", "....."), (3, 3)),
    ],
)
def test_a_common_goal_is_in_the_largest_free_square(rows, cell):
    occupied = np.array([[mark == "#" for mark in row] for row in rows])
    assert find_common_cell(occupied) == cell


@pytest.mark.parametrize("density", [0.2, 0.6, 0.8])
def test_a_common_goal_is_in_the_cell_of_its_map(density):
    for seed in range(20):
        drawn = draw_cylinder_room(np.random.default_rng(seed), 8, density, "common")
        assert (drawn.goal == drawn.goal[0]).all()
        # Rows run against y, columns along x
        occupied = np.zeros((8, 8), dtype=bool)
        for x, y in drawn.cylinder:
            occupied[round(3.5 - y), round(x + 3.5)] = True
        row, column = find_common_cell(occupied)
        assert drawn.goal[0, :2].tolist() == [column - 3.5, 3.5 - row]
        assert not occupied[row, column]


def test_a_common_goal_is_reached_from_a_larger_distance():
    random, common = (
        draw_cylinder_room(np.random.default_rng(4), 2, 0.2, goals)
        for goals in ("random", "common")
    )
    assert (random.reach_distance, common.reach_distance) == (0.5, 1.0)
    # 4 m at 1 m/s: between 0.5 and 1 m are left after 3.4 s
    near = room([(-2, 0, 1.5)], [(2, 0, 1.5)])
    both = [near, near._replace(reach_distance=1.0)]
    flights = fly_cylinder_rooms(both, "orca", duration=3.4)
    assert flights.reached.tolist() == [[False], [True]]


def test_single_integrators_reach_their_velocity_without_lag():
    here = [room([(-2, 0, 1.5)], [(2, 0, 1.5)])]
    length = [
        fly_cylinder_rooms(here, "orca", duration=1.0, dynamics=dynamics).length[0, 0]
        for dynamics in ("single_integrator", "rigid_body")
    ]
    assert length[0] == pytest.approx(1.0, abs=0.02)
    assert length[1] < 0.95


def test_rooms_are_those_of_their_seed():
    drawn = [draw_cylinder_room(np.random.default_rng(k), 8, 0.4, "random") for k in (5, 5, 6)]
    assert (drawn[0].start == drawn[1].start).all()
    assert not (drawn[0].start == drawn[2].start).all()


@pytest.mark.parametrize("density", [-0.1, 1.0])
def test_a_wrong_density_raises(density):
    with pytest.raises(ValueError, match=f"density is {density:g}"):
        draw_cylinder_room(np.random.default_rng(0), 8, density, "random")


def test_drones_that_do_not_fit_raise():
    with pytest.raises(ValueError, match="200 drones do not fit into 13 free cells"):
        draw_cylinder_room(np.random.default_rng(0), 200, 0.8, "random")


def test_collisions_are_those_of_the_published_code():
    both = CYLINDER_RADIUS + DRONE_RADIUS
    place = np.array(
        [
            (both - 0.001, 0, 1),
            (0, both + 0.001, 2),
            (2, 2, 1),
            (2, 2, 1 + 2 * DRONE_RADIUS - 0.001),
            (3, 3, 1),
            (3, 3, 1 + 2 * DRONE_RADIUS + 0.001),
        ]
    )
    hit = find_cylinder_collisions(place[None], np.zeros((1, 1, 2)))
    assert hit.tolist() == [[True, False, True, True, False, False]]


def test_a_free_flight_is_a_success_of_the_length_of_its_way():
    flights = fly_cylinder_rooms([room([(-2, 0, 1.5)], [(2, 0, 1.5)])], "orca", duration=8.0)
    assert flights.success.tolist() == [1.0]
    assert flights.length[0, 0] == pytest.approx(4.0, rel=0.05)
    assert flights.distance[0, 0] < 0.1


def test_the_goal_is_reached_only_after_the_way_at_the_speed_limit():
    # 4 m at 1 m/s, up to 0.5 m from the goal
    here = [room([(-2, 0, 1.5)], [(2, 0, 1.5)])]
    assert not fly_cylinder_rooms(here, "orca", duration=3.4).reached.any()


def test_paths_leave_a_pocket():
    # Cylinders 0.4 m apart are passable, overlapping ones are not
    pocket = [(1, y) for y in np.arange(-1.5, 1.6, 0.5)]
    pocket += [(x, y) for x in (0.5, 0, -0.5) for y in (-1.5, 1.5)]
    here = [room([(0, 0.2, 1.5)], [(3, 0.2, 1.5)], pocket)]
    assert not fly_cylinder_rooms(here, "orca").reached.any()
    flights = fly_cylinder_rooms(here, "paths")
    assert flights.success.tolist() == [1.0]
    assert flights.length[0, 0] > 4.0


def test_rooms_side_by_side_do_not_affect_each_other():
    rng = np.random.default_rng(7)
    rooms = [draw_cylinder_room(rng, 4, 0.2, "random") for _ in range(2)]
    both = fly_cylinder_rooms(rooms, "orca", duration=3.0)
    alone = fly_cylinder_rooms(rooms[1:], "orca", duration=3.0)
    np.testing.assert_allclose(both.length[1], alone.length[0], atol=1e-6)
    np.testing.assert_allclose(both.distance[1], alone.distance[0], atol=1e-6)


def test_flights_are_repeatable():
    drawn = [draw_cylinder_room(np.random.default_rng(8), 8, 0.4, "common")]
    first, second = (fly_cylinder_rooms(drawn, "paths", duration=4.0) for _ in range(2))
    for one, other in zip(first, second, strict=True):
        assert (one == other).all()


@pytest.mark.slow
def test_the_table_is_complete():
    fractions = []
    outcome = REPRODUCTION.compute(Settings(0.01, progress=fractions.append))
    assert fractions == sorted(fractions)
    assert fractions[-1] == pytest.approx(1.0)
    cases = len(EPISODES) * len(DENSITIES) * len(PILOTS)
    assert len(outcome.extra) == cases
    published = [row for row in outcome.rows if row.published is not None]
    assert len(outcome.rows) == len(published) + cases
    assert {row.published for row in published} >= {0.97, 0.75, 0.99, 5.3, 7.1, 0.26}
    for row in published:
        assert row.is_comparable == ("A* paths" not in row.name)
        assert row.low is None
    # The explanation has the success of this run, and not of another
    success = next(row for row in published if row.name.startswith("success, SBC"))
    assert "have a success of 1.000 and a collision rate of 0.000" in success.why
    for values in outcome.extra.values():
        parts = values["success"] + values["collided"] + values["deadlock"]
        assert parts == pytest.approx(1.0)
        assert values["deadlock"] >= -1e-9
