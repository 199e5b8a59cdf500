"""Groups of worlds, each with a Bullet client, fly the same bits as one client of all worlds."""

import numpy as np
import pytest

import bulletuav
import bulletuav.engine.engine as engine_module
import bulletuav.engine.in_bullet as in_bullet
from bulletuav.engine.c_extension import Extension
from bulletuav.engine.in_bullet import MAX_GROUPS, group_worlds
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.view import CameraMatrices
from bulletuav.vehicle.swarm import GROUND

pytestmark = pytest.mark.bullet


@pytest.mark.parametrize(
    ("worlds", "drones", "sizes"),
    [
        (1, 1000, [1]),
        (16, 4, [16]),
        (79, 4, [79]),
        (80, 4, [40, 40]),
        (83, 4, [42, 41]),
        (256, 4, [43] * 5 + [41]),
        (64, 8, [22, 22, 20]),
        (9, 200, [1] * 9),
        (4096, 4, [256] * MAX_GROUPS),
    ],
)
def test_groups_have_many_drones_and_their_number_is_limited(worlds, drones, sizes):
    groups = group_worlds(worlds, drones)
    assert [group.stop - group.start for group in groups] == sizes
    assert [group.start for group in groups] == np.cumsum([0, *sizes[:-1]]).tolist()
    assert groups[-1].stop == worlds


@pytest.fixture(params=[True, False], ids=["extension", "calls"])
def extension(request, monkeypatch):
    """Run a test with and without the C extension."""
    if not request.param:
        without = Extension(None, "", "for comparison")
        monkeypatch.setattr(engine_module, "EXTENSION", without)


def flights(monkeypatch, task, fly, **options):
    """Results of a flight of five worlds in one group, and in three."""
    found = []
    for size in (1000, 2):
        monkeypatch.setattr(in_bullet, "GROUP_DRONES", size * 2)
        aviary = bulletuav.Aviary(task, 5, dynamics="bullet", **options)
        aviary.reset(seeds=0)
        found.append(fly(aviary))
        groups = aviary.worlds.engine._groups
        assert [group.worlds.stop - group.worlds.start for group in groups] == (
            [5] if size > 2 else [3, 2]
        )
        aviary.close()
    return found


def act(aviary, decisions, seed=0):
    """States of all drones while they fly by random actions, with resets of worlds that end."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(decisions):
        result = aviary.step(rng.uniform(-1.0, 1.0, aviary.given.shape))
        found += [array.tobytes() for array in aviary.swarm]
        ended = (result.terminated | result.truncated).all(axis=1)
        if ended.any():
            aviary.reset(ended)
    return found


@pytest.mark.usefixtures("extension")
@pytest.mark.parametrize(
    ("task", "options"),
    [
        ("hover", {"horizon": 5, "randomization": {"mass": [0.8, 1.2]}}),
        ("obstacles", {"num_obstacles": 5, "num_moving": (1, 3), "area": 80.0, "leg": 35.0}),
        ("lidar_navigation", {"area": 100.0, "leg": 60.0}),
    ],
)
def test_flights_do_not_depend_on_the_groups(monkeypatch, task, options):
    def fly(aviary):
        return act(aviary, 12)

    one, several = flights(monkeypatch, task, fly, num_drones=2, **options)
    assert one == several


def test_saved_worlds_of_any_group_continue(monkeypatch):
    def fly(aviary):
        saved = aviary.save_state([0, 4])
        first = act(aviary, 3)
        aviary.load_state(saved, [0, 4])
        return first + act(aviary, 3)

    one, several = flights(monkeypatch, "hover", fly, num_drones=2)
    assert one == several


def test_bodies_pictures_and_distances_are_those_of_their_world(monkeypatch):
    """Bodies of all worlds and of single ones, before and after Bullet's bodies are created."""
    ball = Obstacle("sphere", (0.5,))
    view, projection = np.eye(4), np.diag([1.5, 1.5, -1.02, 0.0])
    view[2, 3], projection[2, 3], projection[3, 2] = -12.0, -0.2, -1.0

    def look(aviary):
        aviary.add_body(ball, (2.0, 0.0, 2.0))
        aviary.add_body(ball, (-2.0, 0.0, 2.0), world=3)
        aviary.reset(seeds=0)
        engine = aviary.worlds.engine
        engine.set_poses(aviary.swarm, aviary.alive)
        shot = CameraMatrices(view, projection, (48, 32))
        found = []
        for world in range(5):
            picture = engine.picture_by_bullet(world, shot)
            pose = aviary.swarm.position[world, 1], aviary.swarm.quaternion[world, 1]
            gap = engine.separation(world, (1, *pose), (GROUND, None, None), 100.0)
            found.append((picture.pixels.tobytes(), picture.depth.tobytes(), gap))
        assert found[3][0] != found[0][0]
        return found

    one, several = flights(monkeypatch, "hover", look, num_drones=2)
    assert one == several


def test_one_client_serves_contacts_and_rays_of_bullet(make_bench):
    for options in ({"contacts": "bullet"}, {"rays": "bullet"}):
        one = make_bench("bullet", worlds=64, drones=4, **options)
        assert len(one.engine._groups) == 1
