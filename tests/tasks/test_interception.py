"""Task `interception`: the evader's flight, captures, rewards, tracks and options."""

import numpy as np
import pytest

import bulletuav
from bulletuav.city.model import City
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.geometry.solids import Solids
from bulletuav.tasks.parts.city_layouts import open_ground
from bulletuav.tasks.parts.fleeing_evader import MAX_SLOPE, find_path_heights
from bulletuav.tasks.parts.target_track import update_tracks
from bulletuav.vehicle.swarm import FIRST_OBSTACLE

RADIUS = 0.3
WOODED = {"kind": "wooded_hills", "relief": 25.0, "tree_density": 60.0}


def make(worlds=1, **options):
    given = {"dynamics": "single_integrator", "num_layouts": 1, "difficulty": "easy", **options}
    aviary = bulletuav.Aviary("interception", worlds, **given)
    aviary.reset(seeds=0)
    return aviary


def towards(aviary, place, speed=6.0):
    """The action of flight to a place, (1, N, 3), at most at some speed."""
    velocity = (place - aviary.swarm.position) / aviary.task.context.period
    length = np.maximum(np.linalg.norm(velocity, axis=-1, keepdims=True), 1e-9)
    return aviary.action.encode(velocity * np.minimum(1, speed / length), aviary.commanded)


def put(aviary, offset, drone=0):
    """Put a drone at an offset from where the evader is going to be next, m."""
    aviary.swarm.position[0, drone] = aviary.scene.obstacle[0, 0] + offset
    aviary.worlds.dynamics.place(aviary.swarm, aviary.alive)


@pytest.mark.parametrize("city", ["hills", "forest", WOODED])
def test_starts_are_at_their_distance_and_clues_within_their_error(city):
    options = {"city": city, "num_drones": 3, "num_layouts": 2}
    task = EnvSpec("interception", 1, options).task
    errors = []
    for seed in range(20):
        spawn = task.spawn(np.random.default_rng(seed))
        evader = spawn.obstacle[0]
        distance = np.linalg.norm(spawn.position - evader, axis=1)
        assert ((distance >= 60) & (distance <= 100)).all()
        errors.append(np.linalg.norm(spawn.memory["track"][:3] - evader))
        assert evader[2] - task.city_layouts.cities[spawn.layout].roof(evader) >= 4
    assert max(errors) <= 10
    # Three quarters of the radius is the mean distance of points in a ball
    assert np.mean(errors) == pytest.approx(7.5, abs=1.2)


@pytest.mark.parametrize("city", ["hills", WOODED])
def test_the_evader_flies_at_its_speed_above_terrain_inside_the_arena(city):
    aviary = make(3, city=city, evader_weave=0.8, evader_speed=4.5, difficulty="medium")
    task, period = aviary.task, aviary.task.context.period
    terrain = task.city_layouts.cities[0]
    stay = np.zeros((3, 1, 3))
    for _ in range(400):
        before = aviary.scene.obstacle[:, 0].copy()
        aviary.step(stay)
        after = aviary.scene.obstacle[:, 0]
        speed = np.linalg.norm((after - before)[:, :2], axis=1) / period
        inside = (np.abs(after[:, :2]) < 94.9).all(axis=1)
        np.testing.assert_allclose(speed[inside], 4.5)
        assert (np.abs(after[:, :2]) <= 95 + 1e-9).all()
        climb = np.abs(after - before)[:, 2] / period
        assert climb.max() <= 4.5 * MAX_SLOPE * np.sqrt(2) + 1e-9
        assert (after[:, 2] - terrain.roof(after) > RADIUS + 1).all()
        assert (after[:, 2] < task.arena_high[2]).all()
        np.testing.assert_array_equal(aviary.scene.goal[:, 0], after)
        np.testing.assert_allclose(aviary.scene.goal_velocity[:, 0], (after - before) / period)


def test_the_evader_flees_and_turns_no_faster_than_it_can():
    aviary = make(evader_weave=0.0, evader_speed=2.0, evader_acceleration=1.0)
    for axis in (0, 1):
        direction = np.eye(3)[axis]
        # The middle, where the edges deflect least
        aviary.scene.obstacle[0, 0] = (0.0, 0.0, 30.0)
        aviary.swarm.position[0, 0] = aviary.scene.obstacle[0, 0] - 30 * direction
        aviary.scene.memory["threat"][0] = aviary.swarm.position[0, 0]
        before = aviary.scene.memory["course"][0]
        start = aviary.scene.obstacle[0, 0].copy()
        rngs = [np.random.default_rng(0)]
        turned = []
        for _ in range(200):  # a turn by 180 degrees takes 63
            aviary.task.evader.move_scene(aviary.scene, np.zeros(1), np.ones(1, dtype=bool), rngs)
            after = aviary.scene.memory["course"][0]
            turned.append(abs((after - before + np.pi) % (2 * np.pi) - np.pi))
            before = after
        # 1 m/s^2 at 2 m/s are 0.05 rad in 0.1 s
        assert max(turned) <= 0.05 + 1e-12
        assert (aviary.scene.obstacle[0, 0] - start)[axis] > 10


def test_paths_climb_before_a_tower_with_limited_slope():
    """A tower of 20 m is a cone of slope 0.5 along the raster."""
    ground = open_ground((60.0, 60.0))
    tower = Solids(np.array([[(-0.4, -0.4, 0.0), (0.4, 0.4, 20.0)]]))
    city = City("tower", 60.0, tower, np.zeros(1, dtype=int), ground.streets)
    heights = find_path_heights(city)
    along = np.array([(0.0, 0.0), (10.0, 0.0), (0.0, -20.0), (10.0, 10.0), (29.0, 29.0)])
    expected = (20.0, 15.0, 10.0, 20 - 0.5 * 10 * np.sqrt(2), 0.0)
    np.testing.assert_allclose(heights.height(along), expected, atol=1e-9)


@pytest.mark.parametrize("dynamics", ["single_integrator", "rigid_body", "bullet"])
def test_a_touch_of_the_evader_is_a_capture_and_no_collision(dynamics):
    aviary = make(dynamics=dynamics, evader_speed=0.5, capture_gap=0.0)
    put(aviary, (-1.0, 0.0, 0.0))
    while aviary.alive.any():
        offset = aviary.scene.goal - aviary.swarm.position
        step = aviary.step(aviary.action.encode(4.0 * offset, aviary.commanded))
    assert aviary.steps[0] < 100
    assert step.terminated.all()
    assert step.info["success"].all()
    assert step.info["captured"].all()
    assert not step.info["collision"].any()
    assert step.info["capture_time"][0, 0] == pytest.approx(aviary.steps[0] * 0.1)


def test_a_gap_of_15_cm_is_a_capture_also_in_passing():
    """The drone passes the evader above, in one decision."""
    for above, captured in ((0.14, True), (0.16, False)):
        aviary = make(evader_speed=0.01, weights={"time": 0.0, "closing": 0.0})
        reach = RADIUS + aviary.task.context.collision_radius + above
        put(aviary, (-0.3, 0.0, reach))
        velocity = aviary.action.encode(np.array([[[6.0, 0.0, 0.0]]]), aviary.commanded)
        step = aviary.step(velocity)
        assert bool(step.info["captured"][0, 0]) == captured
        assert step.rewards[0, 0] == pytest.approx(50.0 * captured)
        assert not (aviary.worlds.frame.contacts.other == FIRST_OBSTACLE).any()


def test_reward_by_hand():
    aviary = make(evader_speed=1.0)
    before = np.linalg.norm(aviary.scene.goal - aviary.swarm.position)
    step = aviary.step(towards(aviary, aviary.scene.goal[0, 0], 3.0))
    after = np.linalg.norm(aviary.scene.goal - aviary.swarm.position)
    assert step.rewards[0, 0] == pytest.approx(0.2 * (before - after) - 0.05)


def test_a_crash_costs_the_rest_of_the_time():
    aviary = make()
    down = aviary.action.encode(np.array([[[0.0, 0.0, -6.0]]]), aviary.commanded)
    while aviary.alive.any():
        step = aviary.step(down)
    left = 600 - aviary.steps[0]
    assert left > 500
    assert step.info["collision"].all()
    assert not step.info["success"].any()
    expected = -20.0 - 0.05 * (1 + left)
    assert step.rewards[0, 0] == pytest.approx(expected, abs=0.2 * 0.9)


def test_a_capture_by_one_is_a_success_of_all_safe_drones():
    aviary = make(num_drones=3, evader_speed=0.01)
    place = aviary.swarm.position[0, 1].copy()
    put(aviary, (-0.6, 0.0, 0.0))
    # The second drone is in conflict, and leaves
    aviary.scene.memory["violations"][0, 1] = 1
    step = aviary.step(towards(aviary, aviary.scene.goal[0, 0]))
    assert step.terminated.all()
    np.testing.assert_array_equal(step.info["success"][0], (True, False, True))
    np.testing.assert_array_equal(step.info["captured"][0], 1.0)
    np.testing.assert_array_equal(aviary.task.reward["capture"][1], 50.0)
    terms = step.info["reward/capture"][0]
    np.testing.assert_array_equal(terms, (50.0, 0.0, 50.0))
    assert np.linalg.norm(place - aviary.swarm.position[0, 0]) > 1


def test_tracks_show_what_detectors_see():
    quiet = {"detector_noise": 0.0}
    aviary = make(randomization=quiet, evader_weave=0.0, clue_error=5.0)
    part = aviary.observer.slices["target_track"]
    hidden = {**quiet, "detector_range": 10.0}
    blind = make(randomization=hidden, evader_weave=0.0, clue_error=5.0)
    for _ in range(100):
        stay = np.zeros((1, 1, 3))
        seen, unseen = (env.step(stay).observations[0, 0, part] for env in (aviary, blind))
    # At a constant speed and without noise the filter has no error but that of turns
    position = (aviary.scene.obstacle[0, 0] - aviary.swarm.position[0, 0]).astype(np.float32)
    assert seen[0] == 1
    assert seen[7] == 0
    np.testing.assert_allclose(seen[1:4], position, atol=0.3)
    np.testing.assert_allclose(seen[4:7], aviary.scene.obstacle_velocity[0, 0], atol=0.6)
    assert unseen[0] == 0
    assert unseen[7] == pytest.approx(10.0)
    np.testing.assert_array_equal(unseen[4:7], 0.0)


def test_the_track_is_a_kalman_filter():
    """Against the filter in matrices, for one axis: F, Q and H of constant velocity."""
    rng = np.random.default_rng(3)
    dt, density = 0.1, 4.0
    transition = np.array([[1.0, dt], [0.0, 1.0]])
    noise = density * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    state, covariance = np.array([5.0, 0.0]), np.diag([4.0, 9.0])
    track, variance = np.zeros((1, 6)), np.array([[4.0, 0.0, 9.0]])
    track[0, 0] = 5.0
    detected, age = np.zeros(1), np.zeros(1)
    position, alive = np.zeros((1, 2, 3)), np.array([[True, True]])
    for k in range(30):
        offset, is_seen = 40.0 + rng.normal(), k % 3 > 0
        # The second drone is farther from what it detects, which does not count
        row = (1.0 * is_seen, offset, 0.0, 0.0)
        detection = np.array([[row, (1.0 * is_seen, 99.0, 0.0, 0.0)]])
        fade = np.diag([1.0, 1.0 if detected[0] else np.exp(-dt / 4.0)])
        state = fade @ transition @ state
        covariance = transition @ covariance @ transition.T + noise
        if is_seen:
            total = covariance[0, 0] + (0.02 * offset) ** 2
            gain = covariance[:, 0] / total
            state = state + gain * (offset - state[0])
            covariance = covariance - np.outer(gain, covariance[0])
        everywhere = np.ones(1, dtype=bool)
        place = (track, variance, detected, age)
        update_tracks(np.full(1, dt), everywhere, detection, position, alive, *place)
        np.testing.assert_allclose(track[0, [0, 3]], state, rtol=1e-9)
        found = covariance[[0, 0, 1], [0, 1, 1]]
        np.testing.assert_allclose(variance[0], found, rtol=1e-9)
        assert detected[0] == is_seen
        assert age[0] == pytest.approx(0.0 if is_seen else dt)


def test_pictures_show_the_evader():
    aviary = make(observation=("velocity", "depth"), evader_speed=0.01)
    put(aviary, (-3.0, 0.0, 0.0))
    aviary.step(np.zeros((1, 1, 3)))
    depth = aviary.observations()["depth"][0, 0]
    assert depth[24, 32] == pytest.approx(2.4, abs=0.2)


REFUSED = [
    ({"evader_speed": 6.0}, "evader_speed is 6 m/s: a speed above 0 and below max_speed 6 m/s"),
    ({"evader_speed": 0.0}, "evader_speed is 0 m/s"),
    ({"evader_acceleration": 0.0}, "evader_acceleration is 0 m/s.2: it must be above 0"),
    ({"evader_height": (0.5, 3.0)}, r"evader_height is \(0.5, 3.0\): from low to high, at least"),
    ({"evader_height": (5.0, 4.0)}, r"evader_height is \(5.0, 4.0\): from low to high"),
    ({"evader_height": (4.0, 60.0)}, "ceiling is 40 m: more than .* m is needed, where the evader"),
    ({"distance": (0.5, 50.0)}, r"distance is \(0.5, 50.0\): from low to high, more than 0.7"),
    ({"distance": (80.0, 70.0)}, r"distance is \(80.0, 70.0\): from low to high"),
    ({"take_off": True}, "drones land on flat ground only"),
]


@pytest.mark.parametrize(("options", "message"), REFUSED)
def test_options_that_contradict_each_other_are_errors(options, message):
    with pytest.raises(ValueError, match=message):
        EnvSpec("interception", 1, {"num_layouts": 1, **options})


def test_a_distance_that_does_not_fit_is_an_error():
    task = EnvSpec("interception", 1, {"num_layouts": 1, "distance": (280.0, 300.0)}).task
    with pytest.raises(ValueError, match=r"distance is \(280.0, 300.0\): there is no room for 1"):
        task.spawn(np.random.default_rng(0))
