"""Marks in pictures: where they are, what they are of, and that looking changes nothing."""

import numpy as np
import pytest

import bulletuav
from bulletuav.envs.marks import (
    BEAM,
    DRONE,
    GOAL,
    LINK,
    MISS,
    SEEN,
    UNSEEN,
    VELOCITY,
    Lens,
    marks_of,
)
from bulletuav.envs.renderer import DIRECTION, fit_camera
from bulletuav.geometry.view import projection_matrix, view_matrix

SMALL = {"area": 200.0, "num_layouts": 1, "render_mode": "rgb_array"}
COLOURS = (DRONE, VELOCITY, GOAL, SEEN, UNSEEN, LINK, BEAM, MISS)


def marks(aviary, world=0):
    return marks_of(
        aviary.task,
        aviary.current_frame(),
        world,
        aviary.worlds.sensors.sensors.values(),
    )


def flown(task, worlds=1, decisions=3, **options):
    """An aviary after some decisions at random."""
    aviary = bulletuav.Aviary(task, worlds, **options)
    aviary.reset(seeds=0)
    rng = np.random.default_rng(1)
    for _ in range(decisions):
        aviary.step(rng.uniform(-1, 1, aviary.given.shape))
    return aviary


def test_points_are_projected_as_by_hand():
    """From 10 m south, 90 degrees high: at 10 m half the picture's height is 10 m."""
    view = view_matrix(np.array((0.0, -10.0, 0.0)), np.zeros(3))
    lens = Lens(projection_matrix(2.0, 90.0) @ view, (400, 200))
    points = np.array([(0, 0, 0), (5, 0, 0), (0, 0, 5), (10, 10, -20), (0, -20, 0)], float)
    places, before = lens.project(points)
    wanted = [(200, 100), (250, 100), (200, 50), (250, 200)]
    np.testing.assert_allclose(places[:4], wanted, atol=1e-9)
    assert before.tolist() == [True] * 4 + [False]
    lines = np.stack([points[[0, 0]], points[[1, 4]]], axis=1)
    np.testing.assert_allclose(lens.lines(lines), [(200, 100, 250, 100)], atol=1e-9)


def test_a_picture_shows_all_points_and_little_more():
    points = np.random.default_rng(0).uniform((-90, -40, 0), (90, 60, 50), (60, 3))
    for width, height in ((640, 480), (300, 400)):
        target, distance = fit_camera(points, DIRECTION, (width, height))
        eye = target + distance * np.array([-0.55, -0.75, 0.5])
        matrix = projection_matrix(width / height, 60.0) @ view_matrix(eye, target)
        places, before = Lens(matrix, (width, height)).project(points)
        off = np.abs(places / (width, height) * 2 - 1).max()
        assert before.all()
        assert 0.75 < off < 1.0


def test_goals_and_ways_are_marked_where_there_are_goals():
    aviary = flown("crossing", 2, num_drones=3, lanes=3)
    found = marks(aviary, 1)
    place = aviary.swarm.position[1]
    np.testing.assert_array_equal(found.goal, aviary.scene.goal[1])
    np.testing.assert_array_equal(found.to_goal, np.stack([place, aviary.scene.goal[1]], axis=1))
    np.testing.assert_allclose(found.motion[:, 1] - place, aviary.swarm.velocity[1], atol=1e-12)
    assert not len(found.target)
    assert not len(found.beam)
    aviary.close()


@pytest.mark.parametrize("task", ["los", "mec"])
def test_users_are_marked_with_links_to_who_serves_them(task):
    aviary = flown(task, num_users=15, **SMALL)
    found, place = marks(aviary), aviary.swarm.position[0]
    users = aviary.scene.memory["users"][0]
    np.testing.assert_array_equal(found.target, users)
    np.testing.assert_array_equal(found.seen, aviary.sight[0].any(axis=0))
    assert not len(found.goal)
    assert not len(found.to_goal)
    told = {tuple(np.concatenate(line)) for line in found.link}
    pairs = {(i, j) for i in range(3) for j in range(15) if (*place[i], *users[j]) in told}
    assert len(pairs) == len(found.link) > 0
    if task == "los":
        assert pairs == set(
            zip(*(axis.tolist() for axis in np.nonzero(aviary.sight[0])), strict=True)
        )
    else:  # the uplink takes the drone that receives most of each user, and one alone
        flew = aviary.current_frame().alive[0]
        received = np.where(flew[:, None], aviary.scene.memory["received"][0], -1.0)
        assert pairs == {(int(received[:, j].argmax()), j) for j in range(15)}
    aviary.close()


def test_before_the_first_decision_nobody_is_served():
    aviary = flown("mec", decisions=0, num_users=15, **SMALL)
    assert not len(marks(aviary).link)
    aviary.close()


def test_beams_end_where_they_measured():
    aviary = flown("lidar_navigation", 2, num_drones=2, area=300.0, num_layouts=1, leg=50.0)
    found = marks(aviary, 1)
    ranges = aviary.observer.split(aviary.observations())["lidar"][1]
    length = np.linalg.norm(found.beam[:, 1] - found.beam[:, 0], axis=1).reshape(2, -1)
    np.testing.assert_allclose(length, ranges, rtol=1e-5)
    np.testing.assert_array_equal(found.hit.reshape(2, -1), ranges < 60)
    np.testing.assert_array_equal(found.beam[::16, 0], aviary.swarm.position[1])
    sight = aviary.line_of_sight(
        found.beam[:, 0], found.beam[:, 0] + 0.999 * (found.beam[:, 1] - found.beam[:, 0]), 1
    )
    assert sight.all()
    assert found.hit.any()
    aviary.close()


def shown(picture):
    """Which of the marks' colours are in a picture."""
    return {colour for colour in COLOURS if (picture == colour).all(axis=-1).any()}


def test_pictures_show_the_marks_of_their_task_and_none_without():
    wanted = {
        "crossing": {DRONE, VELOCITY, GOAL},
        "mec": {DRONE, VELOCITY, SEEN, UNSEEN, LINK},
        "lidar_navigation": {DRONE, VELOCITY, GOAL, BEAM, MISS},
    }
    for task, colours in wanted.items():
        options = {"render_mode": "rgb_array"} | (SMALL if task != "crossing" else {})
        options |= {"leg": 50.0} if task == "lidar_navigation" else {}
        aviary = flown(task, **options)
        assert shown(aviary.render()) == colours, task
        assert not shown(aviary.render(marks=False))
        small = bulletuav.Aviary(task, **options, render_size=(64, 48))
        small.reset(seeds=0)
        assert small.render().shape == (48, 64, 3)
        for one in (aviary, small):
            one.close()


def test_a_user_is_drawn_where_it_is():
    aviary = flown("los", num_users=1, num_drones=1, render_size=(640, 200), **SMALL)
    found = marks(aviary)
    picture = aviary.render()
    colour = SEEN if found.seen[0] else UNSEEN
    rows, columns = np.nonzero((picture == colour).all(axis=-1))
    points = np.concatenate([found.drone, found.target])
    target, distance = fit_camera(points, DIRECTION, (640, 200))
    view = view_matrix(target + distance * np.array([-0.55, -0.75, 0.5]), target)
    lens = Lens(projection_matrix(3.2, 60.0) @ view, (640, 200))
    ((x, y),) = lens.project(found.target)[0]
    assert (columns.mean(), rows.mean()) == pytest.approx((x, y), abs=1.0)
    aviary.close()


@pytest.mark.parametrize("task", ["mec", "lidar_navigation"])
def test_looking_changes_nothing(task):
    options = {**SMALL, "leg": 50.0} if task == "lidar_navigation" else SMALL
    one, other = (bulletuav.Aviary(task, 2, **options) for _ in range(2))
    rng = np.random.default_rng(0)
    for aviary in (one, other):
        aviary.reset(seeds=3)
    for _ in range(8):
        one.render(1)
        one.render(0, marks=False)
        action = rng.uniform(-1, 1, one.given.shape)
        steps = [aviary.step(action) for aviary in (one, other)]
        for name, value in steps[1].info.items():
            np.testing.assert_array_equal(steps[0].info[name], value)
        np.testing.assert_array_equal(steps[0].observations, steps[1].observations)
        for mine, theirs in zip(one.swarm, other.swarm, strict=True):
            np.testing.assert_array_equal(mine, theirs)
    for aviary in (one, other):
        aviary.close()


def test_a_world_that_everybody_left_is_still_drawn():
    class Nowhere(bulletuav.tasks.find_task("hover")):
        name = "nowhere"
        has_goals = False
        ends = (bulletuav.tasks.ends.leaves_arena,)
        max_distance: float = 5.0

    options = {"action": "velocity", "max_distance": 2.0, "render_mode": "rgb_array"}
    aviary = bulletuav.Aviary(Nowhere, 2, start=((0.0, 0.0, 2.0),), **options)
    aviary.reset(seeds=0)
    up = np.zeros((2, 1, 3))
    up[0, 0, 2] = 1.0
    while aviary.alive[0].any():
        step = aviary.step(up)
    assert "goal_distance" not in step.info
    assert DRONE in shown(aviary.render())
    aviary.step(up)
    assert not shown(aviary.render())
    assert DRONE in shown(aviary.render(1))
    aviary.close()
