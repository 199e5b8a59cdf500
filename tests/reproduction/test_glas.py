"""Table `glas`: files of rooms, ORCA among squares, and the table on rooms with known ends."""

import numpy as np
import pytest
import yaml

from bulletuav.reproduction import planar_rooms
from bulletuav.reproduction.planar_rooms import (
    PlanarRoom,
    RoomFlights,
    fly_planar_rooms,
    read_planar_room,
)
from bulletuav.reproduction.table import Settings
from bulletuav.reproduction.tables import glas
from bulletuav.reproduction.tables.glas import (
    OBSTACLES,
    REPRODUCTION,
    ROBOTS,
    ROOMS,
    RVO2_ROBOTS,
)

SIZE = np.array([8.0, 8.0])


def room(start, goal, square=()):
    ends = (np.array(one, float).reshape(-1, 2) for one in (start, goal))
    return PlanarRoom(*ends, np.array(square, float).reshape(-1, 2), SIZE)


def write(path, start, goal, square=()):
    agents = [
        {"name": "a", "start": one, "goal": end} for one, end in zip(start, goal, strict=False)
    ]
    data = {"agents": agents, "map": {"dimensions": [8, 8], "obstacles": [list(q) for q in square]}}
    path.write_text(yaml.safe_dump(data))
    return path


def test_a_room_is_read_with_cells_shifted_to_their_centres(tmp_path):
    file = write(tmp_path / "room.yaml", [[0, 1], [2, 3]], [[4, 5], [6, 7]], [[3, 4]])
    read = read_planar_room(file)
    assert read.start.tolist() == [[0.5, 1.5], [2.5, 3.5]]
    assert read.goal.tolist() == [[4.5, 5.5], [6.5, 7.5]]
    assert read.square.tolist() == [[3, 4]]
    assert read.size.tolist() == [8, 8]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda data: data.pop("agents"), "agents is missing"),
        (lambda data: data.update(agents=[]), "agents is empty"),
        (lambda data: data["agents"][1].pop("goal"), "goal is missing"),
        (lambda data: data["agents"][0].update(start=[1]), "start of robot 0 is"),
        (lambda data: data["agents"][0].update(start=[1, float("nan")]), "start of robot 0"),
        (lambda data: data["map"].update(obstacles=[[1, "x"]]), "obstacle 0 is"),
        (lambda data: data["map"].update(dimensions=[0, 8]), "dimensions"),
        (lambda data: data.update(map=3), "dimensions is missing"),
    ],
)
def test_a_wrong_room_is_one_error_with_its_file(tmp_path, change, said):
    file = write(tmp_path / "room.yaml", [[0, 1], [2, 3]], [[4, 5], [6, 7]])
    data = yaml.safe_load(file.read_text())
    change(data)
    file.write_text(yaml.safe_dump(data))
    with pytest.raises(ValueError, match=said) as error:
        read_planar_room(file)
    assert str(file) in str(error.value)


@pytest.mark.parametrize("pilot", ["plain", "orca", "paths"])
def test_robots_in_an_empty_room_reach_their_goals(pilot):
    flights = fly_planar_rooms([room([(1, 1), (1, 3)], [(3, 1), (3, 3.2)])], pilot)
    assert flights.reached.all()
    assert not flights.collided.any()
    assert flights.success.tolist() == [1.0]


def test_only_paths_pass_a_wall_of_squares():
    # A pocket that is open away from the goal: a local minimum for any robot without a map
    pocket = [(4, 3), (4, 4), (4, 5), (3, 5), (3, 3)]
    here = [room([(3.2, 4.5)], [(6.5, 4.5)], pocket)]
    assert not fly_planar_rooms(here, "plain", num_steps=400).reached.any()
    flights = fly_planar_rooms(here, "paths", num_steps=400)
    assert flights.reached.all()
    assert not flights.collided.any()


def test_the_speed_is_limited():
    # 2 m away: not within 0.5 m after 2.9 s at 0.5 m/s, and within after 3.1 s
    here = [room([(1, 1)], [(3, 1)])]
    assert not fly_planar_rooms(here, num_steps=58).reached.any()
    assert fly_planar_rooms(here, num_steps=62).reached.all()


def test_a_mirrored_room_has_the_mirrored_flights():
    # Without the right turn, ORCA prefers no side
    def mirrored(one):
        return one._replace(
            start=SIZE * (1, 0) + one.start * (-1, 1),
            goal=SIZE * (1, 0) + one.goal * (-1, 1),
            square=one.square * (-1, 1) + (7, 0),
        )

    rng = np.random.default_rng(3)
    cells = rng.permutation([(x, y) for x in range(8) for y in range(8)]).astype(float)
    one = room(cells[:6] + 0.5, cells[6:12] + rng.uniform(0.3, 0.7, (6, 2)), cells[12:20])
    flights = [fly_planar_rooms([each], num_steps=200) for each in (one, mirrored(one))]
    assert flights[0].reached.tolist() == flights[1].reached.tolist()
    assert flights[0].collided.tolist() == flights[1].collided.tolist()


def test_collisions_are_those_of_the_published_statistics():
    # Robots of 0.15 m: 0.29 and 0.31 m apart; 0.14 and 0.16 m from a square, and from a wall
    apart = [room([(1, 1), (1.29, 1), (3, 3), (3.31, 3)], np.ones((4, 2)))]
    beside = [room([(3.86, 4.5), (5.16, 4.5), (0.1, 1)], np.ones((3, 2)), [(4, 4)])]
    found = [
        planar_rooms._find_collisions(np.array([one[0].start]), one)[:, 0].tolist()
        for one in (apart, beside)
    ]
    assert found[0] == [[True, True, False, False], [False] * 4]
    assert found[1] == [[False] * 3, [True, False, False]]


@pytest.fixture
def rooms(tmp_path):
    """Rooms of the published names: all robots reach goals but those that start at a square."""
    folder = tmp_path / "results" / "singleintegrator" / "instances"
    folder.mkdir(parents=True)
    cells = [(x, y) for y in range(8) for x in range(8)]
    for obstacles in OBSTACLES:
        for robots in ROBOTS:
            # Robots move by 0.2 m; the first one overlaps a square where there are more than two
            start = [[x, y] for x, y in cells[:robots]]
            goal = [[x + 0.2, y] for x, y in start]
            square = [[-0.6, 0.0] if robots > 2 else [9.0, 9.0]]
            # The other squares are outside of the room
            square += [[9.0, 9.0]] * (obstacles - 1)
            write(
                folder / f"map_8by8_obst{obstacles}_agents{robots}_ex0000.yaml", start, goal, square
            )
    return tmp_path


def test_the_table_has_the_success_of_known_rooms(rooms):
    fractions = []
    outcome = REPRODUCTION.compute(Settings(0.01, rooms, progress=fractions.append))
    assert fractions[-1] == pytest.approx(1.0)
    assert sorted(fractions) == fractions
    assert len(outcome.rows) == len(OBSTACLES) * len(ROBOTS) + 3
    rows = {row.name: row for row in outcome.rows}
    assert rows["RVO2 and ORCA, 6 obstacles, 2 robots"].ours == 100.0
    assert rows["RVO2 and ORCA, 6 obstacles, 4 robots"].ours == 75.0
    crowd = rows["RVO2 and ORCA, 12 obstacles, 32 robots"]
    assert crowd.ours == pytest.approx(100 * 31 / 32)
    # Published numbers are of the rooms that are flown: the first one
    assert crowd.published == pytest.approx(100 * RVO2_ROBOTS[12][32][0] / 32)
    means = np.mean([100 * (1 - (robots > 2) / robots) for robots in ROBOTS])
    assert rows["RVO2 and ORCA, mean"].ours == pytest.approx(means)
    ahead = rows["above ORCA, GLAS (orca on A* paths)"]
    assert (ahead.published, ahead.unit, ahead.verdict) == (
        20.0,
        "percentage points",
        "not comparable",
    )
    # One room has no interval, and the mean over all rooms has one
    assert crowd.low is None
    assert crowd.high is None
    assert rows["RVO2 and ORCA, mean"].low is not None
    assert len(outcome.figure.axes) == len(OBSTACLES)


def test_intervals_are_of_the_difference_in_each_room():
    # Rooms differ by 60 points, and ours is always 10 below: no doubt about the difference
    theirs = np.array([30.0, 60.0, 90.0, 40.0, 80.0])
    row = glas._row("paired", theirs - 10.0, theirs)
    assert (row.ours, row.published) == (50.0, 60.0)
    assert (row.low, row.high) == (50.0, 50.0)
    assert row.verdict == "outside"
    # Differences of -20 to 20 that are 0 in the mean
    row = glas._row("paired", theirs + (-20.0, 20.0, -10.0, 10.0, 0.0), theirs)
    assert row.verdict == "within"
    assert row.low < row.published - 5.0
    assert row.high > row.published + 5.0


def test_overlaps_of_squares_explain_only_what_they_cause():
    reached = np.ones((6, 4), dtype=bool)
    none, one = np.zeros_like(reached), np.zeros_like(reached)
    one[:, 0] = True
    all_of_theirs, half = np.full(6, 100.0), np.full(6, 50.0)
    why = glas._explain_squares(RoomFlights(reached, none, one), all_of_theirs)
    assert why.startswith("6 of 24 robots overlap a square")
    assert "100.0 % would succeed" in why
    assert glas._explain_squares(RoomFlights(reached, none, one), half) == ""
    assert glas._explain_squares(RoomFlights(reached, none, none), all_of_theirs) == ""


def test_the_turn_is_counted_over_all_robots():
    def flown(*reached):
        here = np.array([reached], dtype=bool)
        return RoomFlights(here, np.zeros_like(here), np.zeros_like(here))

    flights = {
        "plain": [flown(1, 1), flown(1, 0, 0)],
        "orca": [flown(0, 1), flown(0, 1, 0)],
    }
    why = glas._explain_turn(flights)
    assert "2 of all 5 robots succeed only without this turn, and 1 only with it" in why


def test_rvo2_flew_all_rooms():
    for obstacles in OBSTACLES:
        for robots in ROBOTS:
            assert len(RVO2_ROBOTS[obstacles][robots]) == ROOMS
            assert max(RVO2_ROBOTS[obstacles][robots]) <= robots


@pytest.mark.parametrize(
    ("named", "obstacles", "robots"), [((9, 2), 6, 4), ((6, 4), 6, 2), ((9, 4), 6, 4)]
)
def test_a_room_under_the_name_of_another_is_named(rooms, named, obstacles, robots):
    folder = rooms / "results/singleintegrator/instances"
    wrong = folder / f"map_8by8_obst{named[0]}_agents{named[1]}_ex0000.yaml"
    other = folder / f"map_8by8_obst{obstacles}_agents{robots}_ex0000.yaml"
    wrong.write_text(other.read_text())
    with pytest.raises(ValueError, match=f"{obstacles} obstacles and {robots} robots") as error:
        REPRODUCTION.compute(Settings(0.01, rooms))
    assert str(wrong) in str(error.value)
    assert "git clone" in str(error.value)


@pytest.mark.parametrize(
    ("start", "goal", "said"),
    [
        (
            (60, 1),
            (3, 3),
            r"start of robot 1 is at \(60.5, 1.5\) m: a place in the room of 8 m x 8 m",
        ),
        ((1, 1), (-1, 3), "goal of robot 1 is at .* in the room"),
        ((3.2, 4), (3, 3), "start of robot 1 .* within obstacle 0: a free place"),
        ((1, 1), (3.2, 4), "goal of robot 1 .* within obstacle 0: a free place"),
    ],
)
def test_starts_and_goals_are_in_the_room_and_free(tmp_path, start, goal, said):
    file = write(tmp_path / "room.yaml", [(0, 1), start], [(4, 5), goal], [(3, 4)])
    with pytest.raises(ValueError, match=said) as error:
        read_planar_room(file)
    assert str(file) in str(error.value)


def test_a_missing_room_is_named(rooms):
    file = rooms / "results/singleintegrator/instances/map_8by8_obst9_agents16_ex0000.yaml"
    file.unlink()
    with pytest.raises(FileNotFoundError, match="obst9_agents16_ex0000.*git clone"):
        REPRODUCTION.compute(Settings(0.01, rooms))
