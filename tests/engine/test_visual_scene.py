"""Pictures for people: where things are in them, how far they reach, and what shows a drone."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bulletuav
from bulletuav.engine.visual_scene import COLLISION_COLOUR, FLOOR_COLOUR, _quaternion
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.view import (
    DRONE,
    FAR,
    LAND,
    OBSTACLE,
    SKY,
    SKY_COLOUR,
    CameraMatrices,
    projection_matrix,
    view_matrix,
)

RED = (1.0, 0.0, 0.0, 1.0)


def shot(eye, target, size=(64, 48), angle=60.0):
    eye, target = np.array(eye, dtype=float), np.array(target, dtype=float)
    projection = projection_matrix(size[0] / size[1], angle)
    return CameraMatrices(view_matrix(eye, target), projection, size)


@pytest.fixture
def airspace():
    cube = Obstacle("box", (2.0, 2.0, 2.0), RED)
    with bulletuav.Airspace([(0.0, 50.0, 1.0)], obstacles=[cube], dynamics="point_mass") as one:
        one.place_obstacle(0, (10.0, 0.0, 1.0))
        yield one


def test_depths_are_those_of_rays_through_the_corners_of_pixels(airspace):
    camera = shot((0.0, 0.3, 2.0), (10.0, 0.0, 1.0))
    seen = airspace.world.engine.picture(0, camera)
    height, width = seen.depth.shape
    # The ray of row v and column u goes through the lower left corner of the pixel
    tangent = np.tan(np.radians(30.0))
    across = tangent * width / height * (2 * np.arange(width) / width - 1)
    rise = tangent * (1 - 2 * (np.arange(height) + 1) / height)
    right, up, back = camera.view[:3, :3]
    ahead = (
        -back + across[None, :, None] * right + rise[:, None, None] * up
    )  # a step of 1 m along the view axis
    start = np.broadcast_to((0.0, 0.3, 2.0), ahead.shape).reshape(-1, 3)
    end = start + FAR * ahead.reshape(-1, 3)
    world = np.zeros(len(start), dtype=np.int64)
    fraction = airspace.world.engine.cast_rays(start, end, world)
    np.testing.assert_allclose(seen.depth.ravel(), FAR * fraction, rtol=1e-6)
    assert {SKY, LAND, OBSTACLE} == set(np.unique(seen.labels))


def test_colours_are_those_of_obstacles_ground_and_sky(airspace):
    seen = airspace.world.engine.picture(0, shot((0.0, 0.0, 2.0), (10.0, 0.0, 1.0)))
    assert tuple(seen.pixels[0, 0]) == SKY_COLOUR
    assert tuple(seen.pixels[-1, 0]) == FLOOR_COLOUR
    inner = seen.pixels[24, 32].astype(int)
    assert inner[0] > 100
    assert not inner[1:].any()


def test_edges_are_smooth(airspace):
    """A pixel at the side of the cube has a colour between those of the cube and the sky."""
    seen = airspace.world.engine.picture(0, shot((0.0, 0.0, 1.0), (10.0, 0.0, 1.02)))
    row = np.unique(seen.pixels[20], axis=0)
    assert 3 <= len(row) <= 5


@pytest.mark.parametrize("far", [FAR, 5 * FAR])
def test_bodies_are_found_where_asked(airspace, far):
    engine, state = airspace.world.engine, airspace.world.state
    airspace.add_body(Obstacle("sphere", (1.0,)), (10.0, 4.0, 1.0))
    state.swarm.position[0, 0] = (2.0, 0.0, 1.0)
    camera, drones = shot((0.0, 0.3, 2.0), (10.0, 0.0, 1.0)), (state.swarm, state.alive)
    plain, none = engine.draw(0, camera, drones, far=far)
    assert none is None
    seen, bodies = engine.draw(0, camera, drones, far=far, with_bodies=True)
    for one, other in zip(plain, seen, strict=True):
        np.testing.assert_array_equal(one, other)
    # The drone, the cube and the sphere
    assert set(np.unique(bodies)) == {-1, 0, 1, 2}
    np.testing.assert_array_equal(bodies == 0, seen.labels == DRONE)
    np.testing.assert_array_equal(bodies > 0, seen.labels == OBSTACLE)
    left, right = (np.argwhere(bodies == body)[:, 1].mean() for body in (2, 1))
    assert left < right
    # Another body makes other shapes
    airspace.add_body(Obstacle("sphere", (1.0,)), (10.0, -4.0, 1.0))
    _, bodies = engine.draw(0, camera, drones, far=far, with_bodies=True)
    assert np.argwhere(bodies == 3)[:, 1].mean() > right


@pytest.mark.parametrize("far", [FAR, 1.5 * FAR, 5 * FAR])
def test_pictures_reach_as_far_as_asked(far):
    tower = Obstacle("box", (400.0, 400.0, 4000.0), RED)
    with bulletuav.Airspace([(0.0, 0.0, 1.0)], obstacles=[tower], dynamics="point_mass") as one:
        one.place_obstacle(0, (3200.0, 0.0, 0.0))
        camera = shot((0.0, 0.0, 100.0), (100.0, 0.0, 100.0))
        seen = one.world.engine.picture(0, camera, far=far)
    is_tower = seen.labels[20, 32] == OBSTACLE
    assert is_tower == (far > FAR)
    if is_tower:
        assert seen.depth[20, 32] == pytest.approx(3000.0, rel=1e-6)
    assert seen.depth[seen.labels == SKY].min() >= far


def test_visual_or_collision_shapes_show_drones_in_flight(airspace):
    state = airspace.world.state
    place = state.swarm.position[0, 0]
    above = CameraMatrices(
        view_matrix(place + (0, 0, 1.0), place, (0, 1, 0)), projection_matrix(1.0, 30.0), (80, 80)
    )
    drones = state.swarm, state.alive
    visual, collision, none = (
        airspace.world.engine.picture(0, above, which, by_shape)
        for which, by_shape in ((drones, False), (drones, True), (None, False))
    )
    assert not (none.labels == DRONE).any()
    assert 0 < (visual.labels == DRONE).sum() < (collision.labels == DRONE).sum()
    colour = collision.pixels[40, 40] / collision.pixels[40, 40].max()
    np.testing.assert_allclose(colour, np.array(COLLISION_COLOUR[:3]) / 0.98, atol=0.01)


def test_bodies_added_later_and_in_other_worlds():
    """A body shows in its own world from the next picture on."""
    aviary = bulletuav.Aviary("hover", 2, dynamics="point_mass")
    aviary.reset(seeds=0)
    camera = shot((-5.0, 0.0, 1.0), (0.0, 0.0, 1.0))
    engine = aviary.worlds.engine
    assert not (engine.picture(1, camera).labels == OBSTACLE).any()
    aviary.add_body(Obstacle("box", (1.0, 1.0, 2.0), RED), (0.0, 0.0, 1.0), world=1)
    found = [(engine.picture(world, camera).labels == OBSTACLE).sum() for world in (0, 1)]
    assert found[0] == 0
    assert found[1] > 50
    aviary.close()


def test_attitudes_of_cameras_are_those_of_their_matrices():
    """Also of half turns, where formulas that divide by the real part fail."""
    half_turns = Rotation.from_quat([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0.6, 0, 0.8, 0]])
    for one in Rotation.concatenate([Rotation.random(20, random_state=0), half_turns]):
        found = Rotation.from_quat(_quaternion(one.as_matrix()))
        np.testing.assert_allclose(found.as_matrix(), one.as_matrix(), atol=1e-14)
