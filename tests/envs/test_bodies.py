"""Bodies of the option `bodies`, in any task: fixed or drawn, at rest or moving."""

import json
import math
import pickle

import numpy as np
import pytest

import bulletuav
from bulletuav.analysis.recording import fly_episode, load, save
from bulletuav.envs.bodies import Body, DrawnBodies
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.scenery import NOWHERE
from bulletuav.policies import find_policy
from bulletuav.vehicle.swarm import FIRST_OBSTACLE

WALL = Obstacle("box", (0.2, 20.0, 20.0))
BALL = Obstacle("sphere", (1.0,))
STILL = {"dynamics": "point_mass", "num_drones": 2}


def bodies_of(aviary):
    return aviary.worlds.engine.scenery.bodies


def fly(aviary, decisions):
    shape = (aviary.num_worlds, aviary.num_drones, aviary.action.low.shape[-1])
    for _ in range(decisions):
        aviary.step(np.zeros(shape))


def draw_walls(rng):
    return [
        Body(WALL, (*rng.uniform(-90, 90, 2), 50), angular_velocity=(0, 0, rng.uniform(-1, 1)))
        for _ in range(int(rng.integers(1, 4)))
    ]


def test_the_lidar_sees_a_wall_that_comes_nearer():
    wall = Body(WALL, (30, 0, 5), velocity=(-1.5, 0, 0))
    aviary = bulletuav.Aviary(
        "hover", num_drones=1, dynamics="point_mass", observation=("lidar",), bodies=[wall]
    )
    aviary.reset(seeds=0)
    seen = []
    for _ in range(3):
        x = float(aviary.swarm.position[0, 0, 0])
        seen.append(float(aviary.readings["lidar"][0, 0, 0]) + x)
        fly(aviary, 1)
    period = 1 / aviary.options.decision_hz
    # The face of the wall is 0.1 m before its centre; no noise
    np.testing.assert_allclose(seen, 29.9 - 1.5 * period * np.arange(3), atol=1e-4)


def test_loads_start_clear_of_bodies():
    box = Body(Obstacle("box", (0.1, 0.1, 0.1)), (0.0, 0.0, 0.1))
    aviary = bulletuav.Aviary("transport", bodies=[box])
    with pytest.raises(ValueError, match="the start of load 0 .* is in a body"):
        aviary.reset(seeds=0)
    aviary.close()


def test_a_drone_that_a_body_hits_has_collided_with_it():
    aviary = bulletuav.Aviary("hover", num_drones=1, dynamics="rigid_body", bodies=[])
    aviary.reset(seeds=0)
    start = aviary.swarm.position[0, 0].copy()
    ball = Body(BALL, start + (3, 0, 0), velocity=(-10, 0, 0))
    aviary = bulletuav.Aviary("hover", num_drones=1, dynamics="rigid_body", bodies=[ball])
    aviary.reset(seeds=0)
    np.testing.assert_array_equal(aviary.swarm.position[0, 0], start)
    while aviary.alive.all():
        fly(aviary, 1)
        assert aviary.steps[0] < 0.3 * aviary.options.decision_hz
    assert FIRST_OBSTACLE in aviary.contacts.other
    # It came 3 m nearer, less the radii, at 10 m/s
    assert aviary.steps[0] == math.ceil((3 - 1.0691) / 10 * aviary.options.decision_hz)


def test_a_task_keeps_its_own_obstacles_beside_them():
    plain = bulletuav.Aviary("obstacles", dynamics="point_mass", num_drones=2)
    aviary = bulletuav.Aviary("obstacles", **STILL, bodies=[Body(BALL, (0, 0, 90))])
    for one in (plain, aviary):
        one.reset(seeds=5)
        fly(one, 20)
    np.testing.assert_array_equal(plain.scene.obstacle, aviary.scene.obstacle)
    np.testing.assert_array_equal(plain.swarm.position, aviary.swarm.position)
    scenery = aviary.worlds.engine.scenery
    count = plain.scene.obstacle.shape[1]
    np.testing.assert_array_equal(scenery.place[0, :count], aviary.scene.obstacle[0])
    np.testing.assert_array_equal(scenery.place[0, count:], [(0, 0, 90)])
    assert scenery.other[count] == FIRST_OBSTACLE - count


def test_bodies_are_drawn_at_each_reset_of_each_world_from_its_generator():
    def make(worlds):
        drawn = DrawnBodies(draw_walls, [WALL] * 3)
        return bulletuav.Aviary("crossing", worlds, **STILL, bodies=drawn)

    aviary = make(3)
    aviary.reset(seeds=[1, 2, 3])
    before = bodies_of(aviary).position.copy()
    numbers = (before[..., 2] != NOWHERE).sum(axis=1)
    assert set(numbers) <= {1, 2, 3}
    assert len(set(before[:, 0, 0])) == 3
    fly(aviary, 3)
    aviary.reset(mask=np.array([False, True, False]))
    after = bodies_of(aviary).position
    np.testing.assert_array_equal(after[[0, 2]], before[[0, 2]])
    assert (after[1, 0] != before[1, 0]).any()
    # World 2 alone, in another process
    alone = make(1)
    alone.reset(seeds=[3])
    np.testing.assert_array_equal(bodies_of(alone).position[0], before[2])
    fly(alone, 3)
    assert alone.state_hash()[0] == aviary.state_hash([2])[0]


def test_bodies_of_worlds_turn_and_stop_with_their_episodes():
    wall = Body(WALL, (0, 0, 90), angular_velocity=(0, 0, 1))
    aviary = bulletuav.Aviary("hover", 2, **STILL, bodies=wall)
    aviary.reset(seeds=0)
    fly(aviary, 5)
    period = 1 / aviary.options.decision_hz
    turned = (0, 0, math.sin(2.5 * period), math.cos(2.5 * period))
    np.testing.assert_allclose(bodies_of(aviary).quaternion[:, 0], [turned] * 2, atol=1e-14)
    aviary.reset(mask=np.array([True, False]))
    np.testing.assert_allclose(bodies_of(aviary).quaternion[:, 0], [(0, 0, 0, 1), turned])


def test_a_body_follows_a_function_of_the_time_of_its_episode():
    door = Body(BALL, motion=lambda time: ((3 * time, 0, 90), (0, 0, 0, 1)))
    aviary = bulletuav.Aviary("hover", 2, **STILL, bodies=[door])
    aviary.reset(seeds=0)
    fly(aviary, 4)
    aviary.reset(mask=np.array([True, False]))
    fly(aviary, 2)
    period = 1 / aviary.options.decision_hz
    at = bodies_of(aviary).position[:, 0, 0]
    np.testing.assert_allclose(at, [3 * 2 * period, 3 * 6 * period], rtol=1e-12)


def test_snapshots_hold_the_bodies():
    options = {**STILL, "bodies": DrawnBodies(draw_walls, [WALL] * 3)}
    aviary, other = (bulletuav.Aviary("hover", 2, **options) for _ in range(2))
    aviary.reset(seeds=4)
    fly(aviary, 3)
    saved = aviary.save_state()
    fly(aviary, 5)
    for one in (aviary, other):
        one.load_state(saved)
        scenery = one.worlds.engine.scenery
        np.testing.assert_array_equal(scenery.place, aviary.worlds.engine.scenery.place)
    fly(other, 5)
    fly(aviary, 5)
    assert other.state_hash() == aviary.state_hash()


def test_drawn_functions_of_time_have_no_snapshots():
    def draw(rng):
        x = rng.uniform(0, 9)
        return [Body(BALL, motion=lambda time: ((x + time, 0, 90), (0, 0, 0, 1)))]

    aviary = bulletuav.Aviary("hover", **STILL, bodies=draw)
    aviary.reset(seeds=0)
    with pytest.raises(ValueError, match="a drawn body follows a function of time"):
        aviary.save_state()


def test_starts_and_goals_are_drawn_again_until_they_are_clear_of_bodies():
    """A wall fills half of the arena: half of all starts and goals would be in it."""
    options = {**STILL, "num_obstacles": 0, "num_moving": 0}
    plain = bulletuav.Aviary("obstacles", 8, **options)
    size = plain.task.arena_high - plain.task.arena_low
    half = Obstacle("box", (float(size[0]) / 2, float(size[1]), 2 * float(size[2])))
    middle = (plain.task.arena_low + plain.task.arena_high) / 2
    x = float(middle[0] + size[0] / 4)
    plain.reset(seeds=0)
    assert (plain.swarm.position[..., 0] > middle[0]).any()
    aviary = bulletuav.Aviary(
        "obstacles", 8, **options, bodies=[Body(half, (x, float(middle[1]), 0.0))]
    )
    aviary.reset(seeds=0)
    assert (aviary.swarm.position[..., 0] < middle[0]).all()
    assert (aviary.scene.goal[..., 0] < middle[0]).all()
    assert not aviary.contacts.other.size


def test_orca_flies_round_a_body():
    """A ball of 8 m in the middle of the way; straight flight hits it."""
    options = {
        "dynamics": "point_mass",
        "num_drones": 1,
        "start": [(-60.0, 1.0, 40.0)],
        "goal": [(60.0, 0.0, 40.0)],
        "horizon": 400,
    }
    ball = Obstacle("sphere", (8.0,))
    hits = {}
    for name in ("orca", "straight"):
        aviary = bulletuav.Aviary("crossing", **options, bodies=[Body(ball, (0, 0, 40))])
        recording = fly_episode(aviary, find_policy(name).make(aviary), 0)
        hits[name] = (recording.contact_other == FIRST_OBSTACLE).any()
        assert recording.success[-1, 0] == (name == "orca")
    assert hits == {"orca": False, "straight": True}


def test_recordings_show_the_pieces_of_bodies_as_obstacles(tmp_path):
    given = [{"source": {"kind": "box", "size": (4, 1, 1)}, "position": (0, 0, 90)}]
    given[0]["angular_velocity"] = (0, 0, 1)
    aviary = bulletuav.Aviary("hover", **STILL, bodies=given)
    save(
        fly_episode(aviary, find_policy("straight").make(aviary), 0),
        aviary,
        "straight",
        0,
        tmp_path,
    )
    recording = load(tmp_path)
    rows = len(recording.time)
    np.testing.assert_array_equal(recording.obstacle, np.tile((0, 0, 90), (rows, 1, 1)))
    np.testing.assert_allclose(recording.obstacle_radius, [math.sqrt(4.5)])
    half = recording.time / 2
    turn = recording.scene["obstacle_quaternion"][:, 0]
    np.testing.assert_allclose(turn[:, 2], np.sin(half), atol=1e-9)
    (shown,) = json.loads(str(recording.scene["about"]))["obstacles"]
    assert shown["half"] == [2, 0.5, 0.5]
    # `bulletuav verify` can repeat the call
    run = json.loads((tmp_path / "run.json").read_text())
    assert "'bodies': [{'source': {'kind': 'box'" in run["call"]
    assert run["options"]["bodies"][0]["angular_velocity"] == [0, 0, 1]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (3, "bodies is 3: a list or tuple is needed"),
        (["wall"], "bodies has 'wall': a Body, or a dict of its attributes"),
        ([{"sauce": 1}], "bodies: .*sauce"),
        ([{"position": (0, 0, 1)}], "bodies has .*source"),
        ([{"source": {"kind": "cone"}, "position": (0, 0, 1)}], "kind of obstacle"),
        ([Body("gone.stl", (0, 0, 1))], "body is 'gone.stl': pass the path"),
        ([Body(WALL, (0, 0, 9))] * 1025, "bodies has 1025 entries: at most 1024"),
        (lambda rng: 3, "the function of bodies returned a list that is 3"),
    ],
)
def test_options_that_are_no_bodies(given, message):
    with pytest.raises(ValueError, match=message):
        bulletuav.Aviary("hover", **STILL, bodies=given)


def test_pools_that_cannot_be():
    with pytest.raises(ValueError, match="pool of bodies is empty"):
        DrawnBodies(draw_walls, [])
    with pytest.raises(ValueError, match="draw of bodies is 3: a function"):
        DrawnBodies(3, [WALL])
    assert DrawnBodies(draw_walls, [{"kind": "sphere", "size": (1.0,)}]).pool == (BALL,)
    two = DrawnBodies(lambda rng: [Body(WALL, (0, 0, 90))] * 2, [WALL, BALL])
    aviary = bulletuav.Aviary("hover", **STILL, bodies=two)
    with pytest.raises(ValueError, match="drawn more often than it is in the pool"):
        aviary.reset(seeds=0)


def test_a_start_that_stays_in_a_body_is_an_error():
    everywhere = Obstacle("box", (900.0, 900.0, 900.0))
    aviary = bulletuav.Aviary("hover", **STILL, bodies=[Body(everywhere, (0, 0, 0))])
    with pytest.raises(ValueError, match="the start of drone 0 .* body, also after 100 draws"):
        aviary.reset(seeds=0)


def test_an_airspace_adds_its_bodies_by_a_method():
    with pytest.raises(TypeError, match="unknown option of Airspace: 'bodies'"):
        bulletuav.Airspace([(0.0, 0.0, 1.0)], bodies=[])


def test_bodies_work_in_all_interfaces():
    ball = Body(BALL, (0, 0, 90))
    env = bulletuav.parallel_env("hover", **STILL, bodies=[ball])
    env.reset(seed=0)
    assert bodies_of(env.aviary).position.tolist() == [[[0, 0, 90]]]
    env.close()


def test_new_goals_and_bodies_exclude_each_other():
    with pytest.raises(ValueError, match="at_goal is 'respawn', and new goals may lie in bodies"):
        bulletuav.Aviary("free_flight", at_goal="respawn", bodies=[Body(BALL, (0, 0, 60))])


def test_bodies_far_away_are_saved_and_loaded():
    airspace = bulletuav.Airspace([(0.0, 0.0, 1.0)], dynamics="point_mass", decision_hz=1)
    airspace.add_body(BALL, (-4000.0, 0.0, 60.0), velocity=(-100.0, 0.0, 0.0))
    for _ in range(3):
        airspace.step()
    airspace.load_state(pickle.loads(pickle.dumps(airspace.save_state())))
    airspace.close()
