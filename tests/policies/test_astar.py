import itertools

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

import bulletuav
import bulletuav.policies.planner as planner
from bulletuav.geometry.solids import Solids
from bulletuav.policies.astar import plan_path, shorten_path, shortest_path
from bulletuav.policies.planner import (
    PathLimits,
    PathPlanner,
    braking_speed,
    corner_speed,
    follow_paths,
    tube_surfaces,
)
from bulletuav.policies.voxels import Voxels, build_voxels, is_segment_free, nearest_free

LIMITS = PathLimits(speed=15.0, acceleration=5.0, delay=0.6, half_width=2.0)
NOTHING = np.zeros((0, 2, 3))
WALL = np.array(
    [[(40.0, 0.0, 0.0), (45.0, 70.0, 60.0)]]
)  # from the south, with a gap of 30 m in the north
LOW, HIGH = np.zeros(3), np.array((100.0, 100.0, 60.0))


def random_grid(seed, shape=(6, 7, 5), share=0.35):
    occupied = np.ones(np.array(shape) + 2, dtype=bool)
    occupied[1:-1, 1:-1, 1:-1] = np.random.default_rng(seed).random(shape) < share
    return occupied


def length(points):
    return np.linalg.norm(np.diff(points, axis=0), axis=1).sum()


def distance(points, boxes):
    """(M,) from points (M, 3) to the nearest of boxes (P, 2, 3)."""
    points = points[:, None]
    return np.linalg.norm(
        np.maximum(0, np.maximum(boxes[:, 0] - points, points - boxes[:, 1])), axis=-1
    ).min(axis=1)


def along(way, apart=0.05):
    """Points (M, 3) of a way, a little apart."""
    legs = itertools.pairwise(way)
    return np.concatenate(
        [np.linspace(a, b, 2 + int(np.linalg.norm(b - a) / apart)) for a, b in legs]
    )


def test_cells_are_occupied_where_their_centre_is_too_near():
    boxes = np.array(
        [[(10, 12, 0), (20, 14, 9)], [(-50, 20, 3), (3, 21, 5)], [(27, 5, 8), (60, 6, 70)]], float
    )
    low, high = np.array((-2.0, 0, 0)), np.array((31.0, 28, 22))
    grid = build_voxels(boxes, low, high, 2.0, 3.5)
    assert grid.occupied.shape == (18, 16, 13)  # whole cells in the arena, and the rim
    for cell in np.ndindex(grid.occupied.shape):
        centre = grid.origin + 2.0 * (np.array(cell) + 0.5)
        near = ((boxes[:, 0] - 3.5 <= centre) & (centre <= boxes[:, 1] + 3.5)).all(axis=1).any()
        in_arena = ((centre - 1 >= low) & (centre + 1 <= high)).all()
        assert grid.occupied[cell] == (near or not in_arena or centre[2] <= 3.5)


def test_the_ground_is_where_height_is_zero_even_in_deeper_or_higher_arenas():
    for bottom, lowest in ((-10.0, 5.0), (0.0, 5.0), (20.0, 21.0)):
        grid = build_voxels(
            NOTHING, np.array((0, 0, bottom)), np.array((10, 10, bottom + 30)), 2.0, 3.5
        )
        free = np.argwhere(~grid.occupied)[:, 2].min()
        assert grid.origin[2] + 2.0 * (free + 0.5) == lowest


def test_an_arena_smaller_than_a_cell_has_no_way():
    grid = build_voxels(NOTHING, np.array((0.0, 0, 5)), np.array((20.0, 20, 7)), 4.0, 1.0)
    assert plan_path(grid, np.array((1.0, 1, 6)), np.array((19.0, 1, 6))).shape == (0, 3)


def graph(occupied):
    """Steps between free cells, by their Euclidean length."""
    cells = np.argwhere(~occupied)
    gap = np.abs(cells[:, None] - cells)
    return cells, csr_array(np.where(gap.max(axis=-1) == 1, np.linalg.norm(gap, axis=-1), 0.0))


@pytest.mark.parametrize("seed", range(8))
def test_paths_are_as_short_as_those_of_dijkstra(seed):
    occupied = random_grid(seed, share=0.3 + 0.07 * seed)
    cells, steps = graph(occupied)
    lengths = dijkstra(steps)
    for i, j in np.random.default_rng(seed).integers(len(cells), size=(40, 2)):
        path = shortest_path(occupied, tuple(cells[i]), tuple(cells[j]))
        if len(path) == 0:
            assert lengths[i, j] == np.inf
            continue
        np.testing.assert_array_equal(path[[0, -1]], cells[[i, j]])
        assert not occupied[tuple(path.T)].any()
        assert np.abs(np.diff(path, axis=0)).max(initial=1) == 1
        assert length(path) == pytest.approx(lengths[i, j], abs=1e-9)
        assert length(shortest_path(occupied, tuple(cells[j]), tuple(cells[i]))) == pytest.approx(
            length(path), abs=1e-9
        )


def test_path_in_empty_space_is_straight():
    occupied = random_grid(0, shape=(9, 9, 9), share=0.0)
    np.testing.assert_array_equal(
        shortest_path(occupied, (1, 4, 2), (6, 4, 2)), [(x, 4, 2) for x in range(1, 7)]
    )
    np.testing.assert_array_equal(
        shortest_path(occupied, (7, 7, 1), (3, 3, 5)), [(7 - k, 7 - k, 1 + k) for k in range(5)]
    )
    np.testing.assert_array_equal(shortest_path(occupied, (2, 2, 2), (2, 2, 2)), [(2, 2, 2)])


def test_nearest_free_cell():
    grid = Voxels(random_grid(3, share=0.9), np.array((-5.0, 2, 1)), 2.0)
    cells = np.argwhere(~grid.occupied)
    for point in np.random.default_rng(0).uniform(-15, 25, (50, 3)):
        away = np.linalg.norm(grid.origin + 2.0 * (cells + 0.5) - point, axis=1)
        assert nearest_free(grid, point) == tuple(cells[away.argmin()])
    empty = Voxels(random_grid(0, share=0.0), np.zeros(3), 1.0)
    assert nearest_free(empty, np.array((2.3, 3.9, 1.2))) == (2, 3, 1)
    empty.occupied[2, 3, 1] = True
    assert nearest_free(empty, np.array((2.5, 3.5, 1.5))) == (1, 3, 1)  # the first of five


def test_segments_are_clear_unless_they_cut_an_occupied_cell():
    grid = Voxels(random_grid(5, share=0.1), np.array((-3.0, 1, 2)), 1.5)
    low = grid.origin + 1.5 * np.argwhere(grid.occupied)
    rng, seen = np.random.default_rng(1), 0
    for _ in range(300):
        start, end = (
            grid.origin + 1.5 * (0.2 + rng.uniform(0, 1, 3) * (np.array(grid.occupied.shape) - 0.4))
            for _ in range(2)
        )
        enter, leave = np.sort(
            ((low - start) / (end - start), (low + 1.5 - start) / (end - start)), axis=0
        )
        cuts = (enter.max(axis=1).clip(0) < leave.min(axis=1).clip(None, 1)).any()
        assert is_segment_free(grid, start, end) == is_segment_free(grid, end, start) == (not cuts)
        seen += not cuts
    assert 30 < seen < 270
    assert not is_segment_free(grid, start, np.array((1e3, 3, 3)))
    assert not is_segment_free(grid, np.array((-1e3, 3, 3)), start)


def test_segments_through_edges_and_corners_end():
    grid = Voxels(random_grid(0, share=0.0), np.zeros(3), 1.0)
    assert is_segment_free(grid, np.array((1.5, 1.5, 1.5)), np.array((5.5, 5.5, 5.5)))
    assert is_segment_free(grid, np.array((4.0, 5.0, 3.0)), np.array((1.0, 2.0, 3.0)))
    assert is_segment_free(grid, np.array((1.5, 2.5, 3.5)), np.array((1.5, 2.5, 3.5)))


def test_way_around_a_wall_keeps_clear_of_it():
    """A taut rope 3 m off its edges is the shortest; what cells of 2 m allow is a little longer."""
    grid = build_voxels(WALL, LOW, HIGH, 2.0, 4.0)
    start, goal = np.array((10.3, 20.1, 40.2)), np.array((90.2, 30.4, 39.7))
    way = plan_path(grid, start, goal)
    np.testing.assert_array_equal(way[[0, -1]], [start, goal])
    assert distance(along(way), WALL).min() >= 4.0 - 1.0
    taut = np.array([start, (37, 73, 40), (48, 73, 40), goal])
    assert length(way) == pytest.approx(length(taut), rel=0.05)
    assert length(way) > length(taut)
    assert len(way) <= 7


@pytest.mark.parametrize("seed", range(5))
def test_ways_through_random_cities_keep_clear(seed):
    rng = np.random.default_rng(seed)
    corner = np.append(rng.uniform(0, 90, (25, 2)), np.zeros((25, 1)), axis=1)
    boxes = np.stack([corner, corner + rng.uniform((4, 4, 10), (15, 15, 60), (25, 3))], axis=1)
    grid = build_voxels(boxes, LOW, HIGH, 3.0, 3.5)
    start, goal = (
        grid.origin + 3.0 * (np.array(nearest_free(grid, rng.uniform(LOW, HIGH))) + 0.4)
        for _ in range(2)
    )
    way = plan_path(grid, start, goal)
    np.testing.assert_array_equal(way[[0, -1]], [start, goal])
    assert distance(along(way), boxes).min() >= 3.5 - 1.5
    np.testing.assert_array_equal(way, plan_path(grid, start, goal))


def test_in_sight_the_way_is_straight():
    grid = build_voxels(WALL, LOW, HIGH, 2.0, 4.0)
    start, goal = np.array((10.3, 80.1, 20.2)), np.array((90.2, 85.4, 39.7))
    np.testing.assert_array_equal(plan_path(grid, start, goal), [start, goal])
    np.testing.assert_array_equal(plan_path(grid, start, start), [start, start])


def test_ends_near_walls_and_ground_are_joined_by_straight_legs():
    grid = build_voxels(WALL, LOW, HIGH, 2.0, 4.0)
    start, goal = np.array((39.5, 20.5, 30.5)), np.array((60.5, 20.5, 0.5))
    way = plan_path(grid, start, goal)
    np.testing.assert_array_equal(way[[0, -1]], [start, goal])
    np.testing.assert_allclose(way[1], (35, 21, 31))  # the nearest free centre
    np.testing.assert_allclose(way[-2], (61, 21, 5))
    assert distance(along(way[1:]), WALL).min() >= 3.0


def test_no_way_into_a_closed_room():
    lid = [[(40.0, y, 0.0), (60.0, y + 2, 58.0)] for y in (40, 60)] + [
        [(x, 40.0, 0.0), (x + 2, 62.0, 58.0)] for x in (40, 60)
    ]
    grid = build_voxels(np.array([*lid, [(40, 40, 50), (62, 62, 60)]]), LOW, HIGH, 2.0, 2.0)
    assert plan_path(grid, np.array((10.0, 10, 10)), np.array((51.0, 51, 20))).shape == (0, 3)
    assert plan_path(grid, np.array((51.0, 51, 20)), np.array((10.0, 10, 10))).shape == (0, 3)


def test_shortening_keeps_what_it_cannot_see_past():
    grid = Voxels(random_grid(0, share=0.0), np.zeros(3), 1.0)
    points = np.array([(1.5, 1.5, 1.5), (3.5, 1.5, 1.5), (3.5, 2.5, 1.5), (3.5, 3.5, 1.5)])
    np.testing.assert_array_equal(shorten_path(grid, points), points[[0, 3]])
    grid.occupied[2, 2, 1] = True
    np.testing.assert_array_equal(shorten_path(grid, points), points[[0, 1, 3]])


def test_corner_speeds_by_hand():
    """Right angle, 2 m of room: r = 2 cos 45 / (1 - cos 45) = 4.8284 m, sqrt(5 r) = 4.9135 m/s.

    On legs of 4 m, r = 2 m.
    """
    assert corner_speed(0.0, 1000.0, LIMITS) == pytest.approx(4.91346, abs=1e-5)
    assert corner_speed(0.0, 4.0, LIMITS) == pytest.approx(np.sqrt(10))
    assert corner_speed(1.0, 10.0, LIMITS) == np.inf
    assert corner_speed(-1.0, 10.0, LIMITS) == 0
    assert corner_speed(0.5, 1000.0, LIMITS) > corner_speed(0.4, 1000.0, LIMITS)


def test_braking_covers_the_distance():
    for far, speed in ((0.0, 4.0), (3.0, 0.0), (12.0, 2.5)):
        v = braking_speed(far, speed, LIMITS)
        assert v * 0.6 + (v**2 - speed**2) / (2 * 5.0) == pytest.approx(far)
    assert braking_speed(1e3, 0.0, LIMITS) == 15
    assert braking_speed(-1.0, 0.0, LIMITS) == 0


def one(way, position, velocity=(0, 0, 0), target=1):
    """The velocity of a single drone, and its waypoint."""
    args = (np.array(value, float).reshape(1, 1, -1) for value in (position, velocity))
    way = np.array(way, float)
    result, target = follow_paths(
        *args,
        way[None, None],
        np.array([[len(way)]]),
        np.array([[target]]),
        np.array([[LIMITS.half_width]]),
        LIMITS,
    )
    return result[0, 0], target[0, 0]


def test_velocity_along_a_long_leg_and_back_to_it():
    np.testing.assert_allclose(one([(0, 0, 9), (500, 0, 9)], (50, 0, 9))[0], (15, 0, 0))
    np.testing.assert_allclose(one([(0, 0, 9), (500, 0, 9)], (50, 1, 7.5))[0], (15, -1, 1.5))
    np.testing.assert_allclose(
        one([(0, 0, 9), (500, 0, 9)], (50, 0, 15))[0], (5, 0, -6)
    )  # three half widths off


def test_the_goal_is_approached_like_by_policy_straight():
    np.testing.assert_allclose(
        one([(0, 0, 9), (50, 0, 9)], (49.5, 0.2, 9))[0], (0.5, -0.2, 0), atol=1e-12
    )
    np.testing.assert_allclose(one([(0, 0, 9), (50, 0, 9)], (51, 0, 9))[0], (-1, 0, 0), atol=1e-12)
    np.testing.assert_allclose(
        one([(0, 0, 9), (0, 0, 9)], (0, 1, 9))[0], (0, -1, 0), atol=1e-12
    )  # a start at the goal


def test_waypoints_are_left_when_near_or_within_the_delay_or_passed():
    way = [(0, 0, 9), (50, 0, 9), (50, 50, 9)]
    assert one(way, (48, 0, 9))[1] == 1
    assert one(way, (49.1, 0, 9))[1] == 2
    assert one(way, (48, 0, 9), velocity=(4, 0, 0))[1] == 2
    assert one(way, (53, 1, 9), velocity=(-9, 0, 0))[1] == 2
    assert one(way, (50, 49.9, 9), target=2)[1] == 2
    assert one([*way, (50, 50.2, 9), (90, 50, 9)], (50, 49.9, 9), target=2)[1] == 4


def test_several_short_legs_ahead_are_braked_for_in_time():
    """The corner after the next one is a turn back: 2 m before it the speed is at most 2.4 m/s."""
    way = [(0, 0, 9), (50, 0, 9), (52, 0, 9), (0, 0, 9)]
    np.testing.assert_allclose(
        one(way, (48, 0, 9))[0], (braking_speed(2.0, braking_speed(2.0, 0.0, LIMITS), LIMITS), 0, 0)
    )


def test_drones_without_a_way_get_no_velocity_and_worlds_do_not_mix():
    rng = np.random.default_rng(0)
    position, velocity, way = (
        rng.normal(0, 5, (2, 3, 3)),
        rng.normal(0, 1, (2, 3, 3)),
        rng.normal(0, 20, (2, 3, 4, 3)),
    )
    count, target = np.array([(4, 0, 2), (3, 4, 4)]), np.ones((2, 3), int)
    width = np.full((2, 3), LIMITS.half_width)
    result, reached = follow_paths(position, velocity, way, count, target, width, LIMITS)
    assert (result[0, 1] == 0).all()
    assert (target == 1).all()  # as it was given
    for w, i in ((0, 0), (0, 2), (1, 0), (1, 1), (1, 2)):
        alone = one(way[w, i, : count[w, i]], position[w, i], velocity[w, i])
        np.testing.assert_array_equal(alone[0], result[w, i])
        assert alone[1] == reached[w, i]


def fly_way(way, lag=0.4, dt=0.02):
    """Positions of a point whose velocity lags, until it rests at the end.

    It is told another velocity ten times a second.
    """
    position, velocity, target, flown = way[0].copy(), np.zeros(3), 1, []
    for step in range(10_000):
        if step % 5 == 0:
            wanted, target = one(way, position, velocity, target)
        velocity += dt / lag * (wanted - velocity)
        position += dt * velocity
        flown.append(position.copy())
        if np.linalg.norm(position - way[-1]) < 0.1 and np.linalg.norm(velocity) < 0.1:
            break
    return np.array(flown)


@pytest.mark.parametrize("side", [5, 12, 20, 80])
def test_zigzag_is_flown_within_the_half_width(side):
    way = np.cumsum([side * np.eye(3)[k % 3] for k in range(7)], axis=0)
    flown = fly_way(way)
    assert np.linalg.norm(flown[-1] - way[-1]) < 0.1
    points = along(way)
    assert max(np.linalg.norm(points - here, axis=1).min() for here in flown) < LIMITS.half_width
    assert np.linalg.norm(np.diff(flown, axis=0), axis=1).max() / 0.02 <= 15 + 1e-9
    assert len(flown) * 0.02 < length(way) / 2.5


BLOCK = Solids(
    np.array([[(-40.0, -40.0, 0.0), (40.0, 40.0, 100.0)]])
)  # in the middle of the crossing, higher than its arena


@pytest.fixture
def aviary(request, monkeypatch):
    options = {"num_drones": 4, "dynamics": "point_mass", "randomization": {}} | request.param
    aviary = bulletuav.Aviary("crossing", 2, **options)
    monkeypatch.setattr(aviary, "solids", lambda w: BLOCK, raising=False)
    yield aviary
    aviary.close()


def fly(aviary, policy):
    """Least distance to the block, m, and how many drones succeeded."""
    observations, least, arrived = aviary.reset(seeds=0), np.inf, 0
    policy.reset(np.ones(2, bool))
    while aviary.alive.any():
        alive = aviary.alive.copy()
        step = aviary.step(policy.act(observations, aviary.swarm))
        observations = step.observations
        least = min(least, distance(aviary.swarm.position[alive], BLOCK.bounds).min())
        arrived += (step.info["success"] & alive).sum()
    return least, arrived


@pytest.mark.parametrize(
    "aviary",
    [{"action": action, "num_drones": 2} for action in ("velocity", "velocity_increment")],
    indirect=True,
)
def test_planner_flies_around_the_block(aviary):
    least, arrived = fly(aviary, PathPlanner(aviary))
    assert least > aviary.task.context.collision_radius
    assert arrived == 4


@pytest.mark.parametrize("aviary", [{}], indirect=True)
def test_city_is_looked_at_once_and_plans_last_until_a_reset(aviary, monkeypatch):
    looked, planned = [], []
    monkeypatch.setattr(
        planner, "build_voxels", lambda **given: looked.append(given) or build_voxels(**given)
    )
    monkeypatch.setattr(
        planner, "plan_path", lambda *args: planned.append(args) or plan_path(*args)
    )
    policy, observations = PathPlanner(aviary), aviary.reset(seeds=0)
    aviary.alive[1, 3] = False
    first = policy.act(observations, aviary.swarm)
    np.testing.assert_array_equal(policy.act(observations, aviary.swarm), first)
    assert (len(looked), len(planned)) == (1, 7)
    policy.reset(np.array((False, True)))
    np.testing.assert_array_equal(policy.act(observations, aviary.swarm), first)
    assert (len(looked), len(planned)) == (1, 10)
    monkeypatch.setattr(aviary, "solids", lambda w: Solids(NOTHING))
    policy.reset(np.array((True, False)))
    after = policy.act(observations, aviary.swarm)
    assert (after[0] != first[0]).any(axis=-1).all()
    np.testing.assert_array_equal(after[1], first[1])


@pytest.mark.parametrize("aviary", [{}], indirect=True)
def test_without_a_way_it_flies_straight_to_the_goal(aviary, monkeypatch):
    everywhere = Solids(np.array([[(-500.0, -500.0, 0.0), (500.0, 500.0, 500.0)]]))
    monkeypatch.setattr(aviary, "solids", lambda w: everywhere)
    observations = aviary.reset(seeds=0)
    aviary.alive[:, 1:] = False  # nobody pushes
    action = PathPlanner(aviary).act(observations, aviary.swarm)[:, 0]
    gap = (aviary.scene.goal - aviary.swarm.position)[:, 0]
    straight = gap / np.linalg.norm(gap, axis=-1, keepdims=True)
    # All preferred velocities are turned right a little
    np.testing.assert_allclose((action * straight).sum(axis=-1), np.cos(0.05), atol=1e-4)


def test_tube_around_a_leg_by_hand():
    """A leg east at 9 m; the drone is 1 m south and 0.5 m above it, 3 m before its start."""
    way = np.array([[[[0.0, 0, 9], [50, 0, 9]]]])
    one, width = np.array([[2]]), np.array([[2.0]])
    surface = tube_surfaces(np.array([[[-3.0, -1, 9.5]]]), way, one, np.array([[1]]), width)
    expected = {
        (0.0, -1.0, 0.0): 3.0,  # to the northern side
        (0.0, 1.0, 0.0): 1.0,
        (0.0, 0.0, 1.0): 2.5,
        (0.0, 0.0, -1.0): 1.5,
        (1.0, 0.0, 0.0): -1.0,  # behind the rear end
    }
    found = {tuple(row[:3].round(12) + 0.0): row[3] for row in surface[0, 0]}
    assert found == pytest.approx(expected)


def test_there_is_no_tube_without_a_leg():
    way = np.array([[[[0.0, 0, 9], [0, 0, 9]]]])
    for count in (0, 2):
        surface = tube_surfaces(
            np.zeros((1, 1, 3)), way, np.array([[count]]), np.array([[1]]), np.array([[2.0]])
        )
        assert (surface[..., 3] == np.inf).all()


@pytest.mark.parametrize("aviary", [{"num_drones": 2}], indirect=True)
def test_drones_that_meet_on_their_paths_pass_each_other(aviary):
    observations = aviary.reset(seeds=0)
    aviary.swarm.velocity[:] = 0.0
    aviary.swarm.position[:] = (-60.0, 70.0, 60.0), (60.0, 70.0, 60.0)
    aviary.scene.goal[:] = aviary.swarm.position[:, ::-1]
    policy, nearest, aside = PathPlanner(aviary), np.inf, 0.0
    policy.reset(np.ones(2, bool))
    while aviary.alive.all():
        observations = aviary.step(policy.act(observations, aviary.swarm)).observations
        place = aviary.swarm.position
        nearest = min(nearest, np.linalg.norm(place[:, 0] - place[:, 1], axis=-1).min())
        aside = max(aside, np.abs(place[..., 1:] - (70.0, 60.0)).max())
    assert (place[:, 0, 0] > 50).all()
    assert nearest > aviary.task.config.d_safe
    assert 0.5 < aside < 2 * policy.parameters.separation


def street(width):
    """Two houses 100 m long with a street between them, and a way around them of 400 m."""
    return Solids(
        np.array(
            [
                [(-50.0, width / 2, 0.0), (50.0, 150.0, 100.0)],
                [(-50.0, -150.0, 0.0), (50.0, -width / 2, 100.0)],
            ]
        )
    )


@pytest.mark.parametrize(
    ("width", "half_width", "longest"), [(20.0, 2.0, 125.0), (7.0, 1.0, 125.0), (3.0, 2.0, 500.0)]
)
@pytest.mark.parametrize("aviary", [{"num_drones": 2, "half_length": 300.0}], indirect=True)
def test_narrow_streets_are_flown_where_wide_ones_are_long(
    aviary, monkeypatch, width, half_width, longest
):
    monkeypatch.setattr(aviary, "solids", lambda w: street(width))
    policy = PathPlanner(aviary)
    path, found = policy._plan(0, np.array((-60.0, 0, 40)), np.array((60.0, 0, 40)))
    assert found == half_width
    assert 120.0 <= length(path) <= longest
    assert (length(path) > 300) == (width == 3.0)
    assert distance(along(path), street(width).bounds).min() >= half_width


def test_an_empty_path_is_infinitely_long():
    assert planner.path_length(np.zeros((0, 3))) == np.inf
    assert planner.path_length(np.array([[0.0, 0, 0], [3, 4, 0], [3, 4, 12]])) == 17.0
