"""Table `glas`: files of rooms, ORCA among squares, and the table on rooms with known ends."""

import numpy as np
import pytest
import yaml

from bulletuav.reproduction import planar_rooms
from bulletuav.reproduction.planar_rooms import (
    PlanarRoom,
    fly_planar_rooms,
    read_planar_room,
)
from bulletuav.reproduction.table import Settings
from bulletuav.reproduction.tables.glas import OBSTACLES, REPRODUCTION, ROBOTS, RVO2_SUCCESS

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
        planar_rooms._find_collisions(np.array([one[0].start]), one)[0].tolist()
        for one in (apart, beside)
    ]
    assert found == [[True, True, False, False], [True, False, False]]


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
            square = [[-0.6, 0.0]] if robots > 2 else []
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
    assert rows["ORCA, 6 obstacles, 2 robots"].ours == 100.0
    assert rows["ORCA, 6 obstacles, 4 robots"].ours == 75.0
    assert rows["ORCA, 12 obstacles, 32 robots"].ours == pytest.approx(100 * 31 / 32)
    assert rows["ORCA, 12 obstacles, 32 robots"].published == RVO2_SUCCESS[12][4]
    assert rows["points above ORCA, GLAS (orca on A* paths)"].published == 20.0
    means = np.mean([100 * (1 - (robots > 2) / robots) for robots in ROBOTS])
    assert rows["ORCA, mean"].ours == pytest.approx(means)
    assert len(outcome.figure.axes) == len(OBSTACLES)


def test_a_missing_room_is_named(rooms):
    file = rooms / "results/singleintegrator/instances/map_8by8_obst9_agents16_ex0000.yaml"
    file.unlink()
    with pytest.raises(FileNotFoundError, match="obst9_agents16_ex0000.*git clone"):
        REPRODUCTION.compute(Settings(0.01, rooms))
