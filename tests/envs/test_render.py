"""Pictures and the live view."""

import ctypes.util

import numpy as np
import pytest

import bulletuav
from bulletuav.envs.marks import DRONE, GOAL
from bulletuav.envs.renderer import GRID
from bulletuav.geometry.view import DRONE as VIEW_DRONE
from bulletuav.geometry.view import FAR, SKY_COLOUR, CameraMatrices, projection_matrix, view_matrix


def ring(picture):
    """Rows and columns of pixels of rings; the key is in the corner to the left."""
    is_ring = (picture == DRONE).all(axis=-1)
    is_ring[:, :20] = False
    return np.nonzero(is_ring)


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body"])
@pytest.mark.parametrize("task", ["hover", "crossing"])
def test_headless_picture_shows_drones_goals_ground_and_sky(task, dynamics):
    env = bulletuav.parallel_env(
        task, dynamics=dynamics, render_mode="rgb_array", render_size=(320, 240)
    )
    env.reset(seed=0)
    picture = env.render()
    assert picture.shape == (240, 320, 3)
    assert picture.dtype == np.uint8
    for colour in (DRONE, GOAL, GRID, SKY_COLOUR):
        assert (picture == colour).all(axis=-1).any()
    env.step({agent: env.action_space(agent).high for agent in env.agents})
    assert (env.render() != picture).any()
    env.close()


def test_the_drone_itself_is_drawn_where_its_ring_is():
    env = bulletuav.parallel_env(
        "hover", dynamics="rigid_body", render_mode="rgb_array", start=((0.0, 0.0, 2.0),)
    )
    env.reset(seed=0)
    picture = env.render().astype(int)
    rows, columns = ring(picture)
    inside = picture[
        int(rows.mean()) - 12 : int(rows.mean()) + 12,
        int(columns.mean()) - 12 : int(columns.mean()) + 12,
    ]
    blue = (inside[..., 2] > inside[..., 0] + 40).sum()  # rear propellers
    assert blue > 5
    env.close()


def test_drones_are_drawn_by_the_shapes_that_touch():
    """A hummingbird's disc has an area of pi 0.27^2 m^2; its looks have holes in it."""
    options = {"num_drones": 1, "airframe": "hummingbird", "render_mode": "rgb_array"}
    aviary = bulletuav.Aviary("hover", 2, **options)
    aviary.reset(seeds=0)
    looks = aviary.render(1)
    shape = aviary.render(1, collision=True)
    np.testing.assert_array_equal(aviary.render(1), looks)
    assert (shape != looks).any()
    # From 10 m straight above, at 60 degrees, a metre is 400 / (2 * 10 * tan 30 deg) pixels.
    place = aviary.swarm.position[1, 0]
    view = view_matrix(place + (0, 0, 10.0), place, (0, 1, 0))
    shot = CameraMatrices(view, projection_matrix(1.0, 60.0), (400, 400))
    area = (400 / (20 * np.tan(np.pi / 6))) ** 2 * np.pi * 0.27**2
    drones = aviary.swarm, aviary.alive
    disc, body = (
        aviary.worlds.engine.picture(1, shot, drones, one).labels == VIEW_DRONE
        for one in (True, False)
    )
    assert disc.sum() == pytest.approx(area, rel=0.06)
    assert 10 < body.sum() < 0.9 * area
    aviary.alive[1] = False
    for one in (True, False):
        gone = aviary.worlds.engine.picture(1, shot, drones, one).labels == VIEW_DRONE
        assert not gone.any()
    aviary.close()


def test_every_world_is_drawn_on_its_ground():
    aviary = bulletuav.Aviary(
        "hover", 3, render_mode="rgb_array", render_size=(160, 120), start=((0.0, 0.0, 2.0),)
    )
    aviary.reset(seeds=0)
    pictures = [aviary.render(world) for world in (0, 1, 2, 0)]
    assert (pictures[0] == GRID).all(axis=-1).sum() > 50
    for picture in pictures[1:]:
        np.testing.assert_array_equal(picture, pictures[0])
    with pytest.raises(ValueError, match="world is 3"):
        aviary.render(3)
    aviary.close()


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body"])
def test_the_last_picture_still_shows_who_finished(dynamics):
    env = bulletuav.parallel_env(
        "hover", horizon=1, render_mode="rgb_array", dynamics=dynamics, start=((0.0, 0.0, 2.0),)
    )
    env.reset(seed=0)
    env.step({"drone_0": np.full(4, -0.1, np.float32)})
    assert env.agents == []
    picture = env.render().astype(int)
    rows, columns = ring(picture)
    inside = picture[
        int(rows.mean()) - 12 : int(rows.mean()) + 12,
        int(columns.mean()) - 12 : int(columns.mean()) + 12,
    ]
    assert (inside[..., 2] > inside[..., 0] + 40).sum() > 5
    env.close()


def test_resetting_one_world_leaves_the_pictures_of_others():
    aviary = bulletuav.Aviary("hover", 2, horizon=1, render_mode="rgb_array", render_size=(64, 48))
    aviary.reset(seeds=0)
    aviary.step(np.full((2, 1, 4), -0.1))
    before = aviary.render(1)
    aviary.reset(np.array([True, False]))
    np.testing.assert_array_equal(aviary.render(1), before)
    aviary.close()


def test_without_a_render_mode_there_is_no_picture():
    env = bulletuav.parallel_env("hover")
    env.reset(seed=0)
    assert env.render() is None
    env.close()


def test_live_view_without_a_screen_says_so(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(RuntimeError, match=r'"human" needs a screen.*rgb_array'):
        bulletuav.parallel_env("hover", render_mode="human")


@pytest.mark.skipif(ctypes.util.find_library("X11") is None, reason="no X11 library to ask")
def test_live_view_on_a_screen_that_does_not_answer_says_so(monkeypatch):
    monkeypatch.setenv("DISPLAY", ":987")
    with pytest.raises(RuntimeError, match="DISPLAY is ':987'"):
        bulletuav.parallel_env("hover", render_mode="human")


def test_a_picture_is_of_one_world():
    env = bulletuav.batch_env("hover", 2, dynamics="rigid_body", render_mode="rgb_array")
    env.reset(seed=0)
    for world in (2, -1, [0, 1]):
        with pytest.raises(ValueError, match="world is .*: a whole number from 0 to 1 is needed"):
            env.render(world)
    env.close()


@pytest.mark.parametrize("away", [0.0, 900.0, 4000.0])
def test_ground_is_seen_as_far_as_pictures_go(away):
    """Of a camera 150 m high that looks level; rows meet the ground where trigonometry says."""
    airspace = bulletuav.Airspace([(0.0, 0.0, 1.0)], dynamics="point_mass")
    height, angle = 150.0, 60.0
    eye = np.array([away, 0.0, height])
    picture = airspace.picture(
        position=eye, target=eye + [1.0, 0.0, 0.0], size=(64, 240), field_of_view=angle
    )
    airspace.close()
    below = (np.arange(240) + 0.5 - 120) / 120 * np.tan(np.radians(angle / 2))
    exact = height / np.maximum(below, 1e-9)
    is_ground = picture.labels[:, 32] == 1
    # A row is half a pixel wrong at most.
    steps = np.flatnonzero(is_ground != (exact < FAR))
    assert len(steps) <= 1
    told = picture.depth[is_ground, 32]
    np.testing.assert_allclose(told, exact[is_ground], rtol=0.04)
    assert told.max() > 1700.0
