"""Obstacles, headings and teams in any flight, and the flight that arranges nothing."""

import numpy as np
import pytest
from scipy.spatial.distance import cdist

import bulletuav
from bulletuav.tasks.parts.obstacle_field import ObstacleField

POINTS = {"dynamics": "single_integrator"}
SPACES = [
    "converge",
    "crossing",
    "pursuit",
    "free_flight",
    "formation",
    "navigation",
    "default",
    "los",
]


def made(task, worlds=1, **options):
    aviary = bulletuav.Aviary(task, worlds, **{**POINTS, **options})
    aviary.reset(seeds=0)
    return aviary


@pytest.mark.parametrize("task", SPACES)
def test_obstacles_keep_off_starts_goals_and_buildings_and_stay_in_bounds(task):
    wide = {"area": 200.0} if task == "free_flight" else {}
    aviary = made(task, 3, num_obstacles=6, num_moving=4, randomization={}, **wide)
    at, task = aviary.scene, aviary.task
    field = next(part for part in task.parts if isinstance(part, ObstacleField))
    low, high = field.box()
    for w in range(3):
        for places in (aviary.swarm.position[w], at.goal[w]):
            assert (cdist(places, at.obstacle[w]) > field.min_distance).all()
    moving = at.obstacle_velocity[:, :4]
    assert (moving != 0).all()
    assert (at.obstacle_velocity[:, 4:] == 0).all()
    standing = at.obstacle[:, 4:].copy()
    before = at.obstacle.copy()
    still = np.zeros((3, aviary.num_drones, 3))
    for _ in range(30):
        aviary.step(still)
        assert ((at.obstacle >= low) & (at.obstacle <= high)).all()
        for w in range(3):
            for k in range(6):
                radius = field.radius[k]
                assert task.is_free(at.obstacle[w, k], radius, int(at.layout[w]))
    np.testing.assert_array_equal(at.obstacle[:, 4:], standing)
    assert (np.linalg.norm(at.obstacle - before, axis=-1)[:, :4] > 0).any()


def test_obstacles_can_be_hit():
    start, goal = [(0.0, -30.0, 50.0)], [(0.0, 30.0, 50.0)]
    aviary = made(
        "free_flight", 16, num_drones=1, start=start, goal=goal, heading="goal", num_obstacles=20,
        obstacle_radius=(5.0, 8.0), area=150.0, altitude_spread=40.0, altitude=50.0,
    )  # fmt: skip
    crashed = np.zeros(16, dtype=bool)
    for _ in range(80):
        result = aviary.step(np.full((16, 1, 3), (0.0, 1.0, 0.0)))
        crashed |= result.info["collision"][:, 0]
    assert 0 < crashed.sum() < 16


def test_a_crowd_of_obstacles_is_refused():
    wide = {"d_safe": 130.0, "altitude": 100.0, "obstacle_radius": (20.0, 20.0)}
    with pytest.raises(ValueError, match="no place is left for obstacle"):
        made("converge", num_drones=2, num_obstacles=1, **wide)
    with pytest.raises(ValueError, match="no room for obstacles of 60 m"):
        made("converge", num_obstacles=1, obstacle_radius=(60.0, 60.0))


def test_headings_turn_velocity_and_nose():
    noses = []
    for heading in (None, "goal", 90.0, [0.0, 45.0, 90.0, 180.0]):
        aviary = made("converge", num_drones=4, jitter=0.0, heading=heading, dynamics="rigid_body")
        velocity = aviary.swarm.velocity[0]
        direction = velocity / np.linalg.norm(velocity, axis=-1, keepdims=True)
        x, y, z, w = aviary.swarm.quaternion[0].T
        nose = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)], -1)
        noses.append(nose)
        if heading in (None, "goal"):
            way = aviary.scene.goal[0] - aviary.swarm.position[0]
            wanted = way / np.linalg.norm(way, axis=-1, keepdims=True)
        else:
            angle = np.radians(np.broadcast_to(heading, 4))
            wanted = np.stack([np.cos(angle), np.sin(angle), np.zeros(4)], -1)
        np.testing.assert_allclose(direction, wanted, atol=1e-12)
        faced = np.array([[1.0, 0, 0]] * 4) if heading is None else wanted
        np.testing.assert_allclose(nose, faced, atol=1e-12)


def test_a_heading_may_be_a_number_of_python_that_no_array_holds():
    env = bulletuav.Aviary("converge", 1, dynamics="point_mass", heading=10**30)
    env.reset(seeds=0)
    assert np.isfinite(env.swarm.velocity).all()
    env.close()


def test_random_headings_are_uniform_in_space():
    aviary = made("free_flight", 100, num_drones=8, start_speed=(5.0, 15.0))
    velocity = aviary.swarm.velocity.reshape(-1, 3)
    speed = np.linalg.norm(velocity, axis=1)
    assert speed.min() >= 5.0
    assert speed.max() <= 15.0
    unit = velocity / speed[:, None]
    # Uniform on the sphere: mean 0, each axis' square 1/3; 800 directions, four standard errors.
    assert np.abs(unit.mean(axis=0)).max() < 4 * np.sqrt(1 / 3 / 800)
    assert np.abs((unit**2).mean(axis=0) - 1 / 3).max() < 4 * np.sqrt(4 / 45 / 800)


@pytest.mark.parametrize(
    "heading", ["up", np.nan, [1.0, 2.0], None.__class__, [[0.0] * 8]], ids=str
)
def test_headings_that_are_none_are_refused(heading):
    with pytest.raises(ValueError, match="heading is"):
        bulletuav.Aviary("converge", heading=heading, **POINTS)


def test_teams_have_the_sizes_that_are_asked_for():
    blocks = ("team", "neighbours", "neighbour_teams")
    aviary = bulletuav.Aviary("crossing", teams=(3, 5), observation=blocks, **POINTS)
    seen = aviary.reset(seeds=0)[0]
    np.testing.assert_array_equal(seen[:, :2], np.eye(2)[[0] * 3 + [1] * 5])
    position, team = aviary.swarm.position[0], aviary.task.team
    assert (position[:3, 1] < position[:3, 0].min()).all() or (position[:3, 1] <= -99).all()
    for i in range(8):
        gaps = np.linalg.norm(position - position[i], axis=1)
        nearest = np.argsort(gaps)[1 : 1 + 3]
        wanted = np.where(team[nearest] == team[i], 1.0, -1.0)
        np.testing.assert_array_equal(seen[i, -3:], wanted)


def test_slots_without_a_neighbour_have_no_team():
    aviary = bulletuav.Aviary("crossing", num_drones=2, observation=("neighbour_teams",), **POINTS)
    np.testing.assert_array_equal(aviary.reset(seeds=0)[0], [[-1.0, 0.0, 0.0]] * 2)


@pytest.mark.parametrize("teams", [(3, 4), (9, -1)])
def test_teams_that_do_not_add_up_are_refused(teams):
    with pytest.raises(ValueError, match="teams is .* must add up"):
        bulletuav.Aviary("crossing", teams=teams, **POINTS)


def test_the_seeds_scenario_is_one_call():
    """UAVConflictGym: starts, goals and directions are uniform, actions change the velocity."""
    env = bulletuav.parallel_env("free_flight", preset="uavconflict", **POINTS)
    env.reset(seed=0)
    space = env.observation_space(env.agents[0])
    assert len(env.agents) == 8
    assert space.shape == (6 + 4 + 8 + 6 * 7,)
    assert env.action_space(env.agents[0]).shape == (3,)
    low, high = env.aviary.task.starts.low, env.aviary.task.starts.high
    np.testing.assert_array_equal(high - low, 200.0)
    starts = np.concatenate(
        [env.aviary.swarm.position[0].copy() for _ in range(50) if env.reset() is not None]
    )
    middle = (starts - low) / 200.0
    # Nearly uniform, as starts keep 10 m apart: means within four standard errors.
    assert np.abs(middle.mean(axis=0) - 0.5).max() < 4 / np.sqrt(12 * 400)
