"""Task `pad_landing`: pads, their motion and claims, rewards and ends."""

import numpy as np
import pytest

import bulletuav
from bulletuav.policies import find_policy
from bulletuav.tasks.parts.pads import update_landings
from bulletuav.vehicle.swarm import FIRST_OBSTACLE, Swarm

VECTOR = ("attitude", "velocity", "rates", "pad_clue", "lidar", "claimed_pads", "neighbours")
MOVING = {"pad_speed": 1.0, "pad_circle": 3.0, "pad_tilt": 0.2, "pad_period": 4.0}


def made(worlds=1, **options):
    options = {"dynamics": "rigid_body", "observation": VECTOR} | options
    return bulletuav.Aviary("pad_landing", worlds, **options)


@pytest.fixture(scope="module")
def resting():
    aviary = made(2)
    yield aviary
    aviary.close()


@pytest.mark.parametrize("difficulty", ["easy", "extreme"])
def test_pads_are_apart_and_the_clue_is_near_their_mean(difficulty):
    aviary = made(difficulty=difficulty)
    task, config = aviary.task, aviary.task.config
    rng = np.random.default_rng(1)
    errors = []
    for _ in range(200):
        spawn = task.spawn(rng)
        pads, platforms = np.split(spawn.obstacle, [task.pads.count])
        assert len(pads) == aviary.num_drones + config.extra_pads
        gap = np.linalg.norm((pads[:, None] - pads)[..., :2], axis=-1)
        assert gap[~np.eye(len(pads), dtype=bool)].min() >= 4.0 - 1e-9
        assert pads[:, 0].min() >= config.distance - 1e-9
        for solids, (low, high) in ((pads, config.pad_height), (platforms, config.start_height)):
            assert (solids[:, 2] + 0.1 >= low - 1e-9).all()
            assert (solids[:, 2] + 0.1 <= high + 1e-9).all()
        assert (spawn.position > task.arena_low).all()
        assert (pads < task.arena_high).all()
        np.testing.assert_allclose(spawn.position[:, :2], platforms[:, :2])
        place = spawn.memory["pad_place"].mean(axis=0) + (0.0, 0.0, 0.1)
        errors.append(spawn.memory["clue"] - place)
    assert (np.abs(errors) <= (config.clue_noise, config.clue_noise, 2.0)).all()
    assert np.abs(errors).max(axis=0) == pytest.approx([config.clue_noise] * 2 + [2.0], rel=0.1)
    aviary.close()


def test_pads_circle_at_their_speed_and_rock_by_their_tilt():
    aviary = made(2, **MOVING, decision_hz=50)
    aviary.reset(seeds=0)
    count, scene = aviary.task.pads.count, aviary.scene
    centre = scene.memory["pad_place"].copy()
    tilts = []
    for _ in range(210):
        before, turned = scene.obstacle.copy(), scene.obstacle_quaternion.copy()
        aviary.step(np.zeros((2, 2, 3)) + (0.0, 0.0, 0.1))
        moved = (scene.obstacle - before)[:, :count]
        # The chord of an arc of 1 m/s on a circle of 3 m
        chord = 2 * 3.0 * np.sin(0.02 / 3.0 / 2)
        np.testing.assert_allclose(np.linalg.norm(moved, axis=-1), chord, rtol=1e-9)
        np.testing.assert_allclose(moved / 0.02, scene.obstacle_velocity[:, :count], atol=1e-9)
        away = np.linalg.norm((scene.obstacle[:, :count] - centre)[..., :2], axis=-1)
        np.testing.assert_allclose(away, 3.0)
        quaternion = scene.obstacle_quaternion[:, :count]
        tilts.append(2 * np.arcsin(np.linalg.norm(quaternion[..., :2], axis=-1)))
        # Twice the vector part of a small rotation is the rotation
        x = 2 * (quaternion - turned[:, :count])[..., :2] / 0.02
        np.testing.assert_allclose(x, scene.memory["pad_spin"][..., :2], atol=0.02)
        # The shapes that sensors and contacts see are at the same poses
        scenery = aviary.worlds.engine.scenery
        np.testing.assert_array_equal(scenery.place, scene.obstacle)
        np.testing.assert_array_equal(scenery.quaternion, scene.obstacle_quaternion)
    assert np.max(tilts, axis=0) == pytest.approx(0.2, rel=1e-3)  # a period is 200 decisions
    assert (scene.obstacle[:, count:] == before[:, count:]).all()
    aviary.close()


class Landings:
    """Drones above two pads, and the arrays of their landings."""

    def __init__(self, drones=2):
        self.swarm = Swarm.zeros(1, drones, 4)
        self.pads = (
            np.zeros((1, 2, 3)),
            np.tile((0.0, 0.0, 0.0, 1.0), (1, 2, 1)),
            np.zeros((1, 2, 3)),
        )
        self.spin = np.zeros((1, 2, 3))
        self.time, self.pad, self.landing, self.has_pad = np.zeros((4, 1, drones))
        self.claimed = np.zeros((1, 2))

    def update(self, touched, times=1):
        for _ in range(times):
            alive = np.ones(self.time.shape, dtype=bool)
            touched = np.array([touched]).reshape(self.time.shape)
            given = (touched, self.swarm, alive, self.pads, self.spin, 0.02, self.time, self.pad)
            update_landings(*given, self.claimed, self.landing, self.has_pad)


@pytest.mark.parametrize("policy", ["pad_pilot", "pad_touch"])
def test_contact_is_paid_once_in_training(policy):
    """A landing has 25 decisions of contact, and `pad_touch` leaves after more than 15 of them."""
    aviary = made(num_drones=1, observation=("velocity",), horizon=1500, reward="training")
    weights = aviary.task.training_weights
    flown = find_policy(policy)(aviary)
    seen, touching, total = aviary.reset(seeds=0), 0.0, 0.0
    flown.reset(np.ones(1, dtype=bool))
    while aviary.alive.any():
        step = aviary.step(flown.act(seen, aviary.swarm))
        touching, total = touching + step.info["reward/touching"][0, 0], total + step.rewards[0, 0]
    assert 15 < touching / weights["touching"] < 25 + 1e-6
    assert (total > weights["landing"]) == (policy == "pad_pilot")
    aviary.close()


def test_half_a_second_of_contact_claims_a_pad_once():
    all_of = Landings()
    all_of.update([0, -1], 24)
    assert not all_of.claimed.any()
    all_of.update([0, 0])
    assert all_of.claimed.tolist() == [[1.0, 0.0]]
    assert all_of.landing.tolist() == [[1.0, 0.0]]
    all_of.update([0, 0], 40)  # claimed
    assert all_of.has_pad.tolist() == [[1.0, 0.0]]
    assert all_of.time[0, 1] == 0.0
    all_of.update([0, 1], 25)
    assert all_of.claimed.tolist() == [[1.0, 2.0]]


def test_of_simultaneous_landings_the_first_drone_claims():
    all_of = Landings()
    all_of.update([1, 1], 25)
    assert all_of.claimed.tolist() == [[0.0, 1.0]]
    assert all_of.has_pad.tolist() == [[1.0, 0.0]]


def test_contact_has_to_last_on_one_pad():
    all_of = Landings(1)
    all_of.update([0], 20)
    all_of.update([-1])
    all_of.update([0], 24)
    all_of.update([1], 24)
    assert not all_of.claimed.any()
    all_of.update([1])
    assert all_of.claimed.tolist() == [[0.0, 1.0]]


@pytest.mark.parametrize(
    ("velocity", "is_stable"),
    [
        ((0.0, 0.0, -0.49), True),
        ((0.0, 0.0, -0.51), False),
        ((0.35, 0.48, 0.0), True),  # 0.594 m/s
        ((0.37, 0.48, 0.0), False),  # 0.606 m/s
    ],
)
def test_speeds_of_a_landing_are_relative_to_the_pad(velocity, is_stable):
    all_of = Landings(1)
    all_of.pads[2][0, 0] = (2.0, -1.0, 0.0)
    all_of.swarm.velocity[0, 0] = np.array(velocity) + (2.0, -1.0, 0.0)
    all_of.update([0])
    assert bool(all_of.time[0, 0] > 0) is is_stable
    # A pad that turns about its y axis at 1 rad/s carries a point 0.6 m ahead down at 0.6 m/s
    all_of.spin[0, 0] = (0.0, 1.0, 0.0)
    all_of.swarm.position[0, 0] = (0.6, 0.0, 0.0)
    all_of.swarm.velocity[0, 0, 2] -= 0.6
    all_of.update([0])
    assert bool(all_of.time[0, 0] > 0) is is_stable


@pytest.mark.parametrize(("axis", "yaw"), [((1, 0, 0), 0.0), ((0, 1, 0), 0.0), ((1, 0, 0), 1.0)])
def test_roll_and_pitch_of_a_landing_are_relative_to_the_pad(axis, yaw):
    from bulletuav.geometry.rotation import exp_map, from_euler, product

    for pad, drone, is_stable in ((0.0, 0.25, True), (0.0, 0.27, False), (0.2, 0.44, True)):
        all_of = Landings(1)
        all_of.pads[1][0, 0] = exp_map(tuple(pad * k for k in axis))
        turned = product(exp_map(tuple(drone * k for k in axis)), from_euler(0.0, 0.0, yaw))
        all_of.swarm.quaternion[0, 0] = turned
        all_of.update([0])
        # Yawed, the tilt is shared by roll and pitch
        assert bool(all_of.time[0, 0] > 0) is (is_stable or yaw > 0)


def test_progress_sums_up_to_the_distance(resting):
    resting.reset(seeds=3)
    first = np.linalg.norm(resting.scene.goal - resting.swarm.position, axis=-1)
    total = np.zeros(first.shape)
    for _ in range(40):
        step = resting.step(np.zeros((2, 2, 3)) + (0.5, 0.0, 0.5))
        total += step.info["reward/progress"] / 0.2
    last = np.linalg.norm(resting.scene.goal - resting.swarm.position, axis=-1)
    np.testing.assert_allclose(total, first - last, atol=1e-6)
    np.testing.assert_allclose(step.info["reward/waiting"], -0.01)


def test_the_ground_is_no_pad_and_start_platforms_are_no_collision(resting):
    resting.reset(seeds=4)
    for _ in range(60):
        step = resting.step(np.zeros((2, 2, 3)) - (0.0, 0.0, 0.2))
    assert resting.worlds.frame.landed.all()  # on their platforms
    assert not step.info["stable_time"].any()
    assert resting.alive.all()
    while resting.alive.any():
        last = resting.alive.copy()
        up = resting.swarm.position[..., 0] < 1.0
        action = np.where(up[..., None], (1.0, 0.0, 0.1), (0.0, 0.0, -0.2))
        step = resting.step(action)
        ended = last & ~resting.alive
        assert step.info["collision"][ended].all()
        assert not step.info["success"][ended].any()
        left = 3000 - resting.steps[:, None] * np.ones((1, 2))
        np.testing.assert_allclose(
            step.info["reward/waiting"][ended], -0.01 * (1 + left[ended]), rtol=1e-9
        )
    assert resting.steps.max() < 1000


def test_the_pilot_lands_on_pads_that_move_and_rock_and_scores():
    aviary = made(2, **MOVING, num_drones=3, extra_pads=0, horizon=2000)
    aviary.reset(seeds=1)
    policy = find_policy("pad_pilot")(aviary)
    policy.reset(np.ones(2, dtype=bool))
    last = np.zeros((2, 3))
    while aviary.alive.any():
        was = aviary.alive.copy()
        step = aviary.step(policy.act(None, aviary.swarm))
        ended = was & ~aviary.alive
        assert step.info["success"][ended].all()
        time = aviary.steps[:, None] / 50 * np.ones((1, 3))
        target = aviary.scene.memory["target_time"]
        part = np.minimum((40.0 - time) / (40.0 - target), 1.0)
        closest = np.clip((aviary.scene.memory["closest"] - 0.4) / 0.6, 0.0, 1.0)
        score = 0.45 + 0.45 * part + 0.10 * closest
        np.testing.assert_allclose(step.info["score"][ended], score[ended])
        paid = step.info["reward/landing"] + step.info["reward/early"] + step.info["reward/clear"]
        np.testing.assert_allclose(paid[ended], 100 * score[ended])
        assert (paid[~ended] == 0).all()
        last = np.where(ended, step.info["score"], last)
    assert (last > 0.5).all()
    # Scores of earlier landings stay to the end of the episode
    np.testing.assert_array_equal(step.info["score"], last)
    # Each drone has a pad of its own
    for claimed in aviary.scene.memory["claimed"]:
        assert sorted(claimed.tolist()) == [1.0, 2.0, 3.0]
    aviary.close()


def test_claims_are_observed_by_others(resting):
    resting.reset(seeds=5)
    resting.scene.memory["claimed"][1, 2] = 2.0  # drone 1 in world 1
    observations = resting.step(np.zeros((2, 2, 3)) + (0.0, 0.0, 0.2)).observations
    claims = observations[..., resting.observer.slices["claimed_pads"]]
    offset = resting.scene.obstacle[1, 2] - resting.swarm.position[1, 0]
    np.testing.assert_allclose(claims[1, 0], [*offset, 1.0], rtol=1e-6)
    assert not claims[1, 1].any()
    assert not claims[0].any()
    clue = observations[..., resting.observer.slices["pad_clue"]]
    np.testing.assert_allclose(
        clue, resting.scene.memory["clue"][:, None] - resting.swarm.position, rtol=1e-6
    )
    # The next nearest pad becomes the goal
    assert (resting.scene.memory["aim"][1] != 2).all()


def test_the_sides_and_hard_contacts_are_collisions(resting):
    for speed, height in ((0.9, 0.5), (0.3, 0.15)):
        resting.reset(seeds=6)
        start = resting.swarm.position.copy()
        pad = resting.scene.obstacle[:, :2] + (0.0, 0.0, 0.1)
        aside = (0.0, 0.0, height) if speed > 0.5 else (-1.0, 0.0, -0.1)
        resting.swarm.position[:] = pad + aside
        assert (start != resting.swarm.position).any()
        resting.worlds.dynamics.place(resting.swarm, np.ones((2, 2), dtype=bool))
        resting.simulation.recompute()
        direction = (0.0, 0.0, -1.0) if speed > 0.5 else (speed, 0.0, 0.0)
        step = None
        for _ in range(250):
            was = resting.alive.copy()
            step = resting.step(np.zeros((2, 2, 3)) + direction)
            ended = was & ~resting.alive
            if speed > 0.5 and ended.any():
                others = resting.worlds.frame.contacts.other
                assert (others <= FIRST_OBSTACLE).all()
            assert step.info["collision"][ended].all() or step.info["success"][ended].all()
            if not resting.alive.any():
                break
        if speed < 0.5:
            assert step.info["collision"].any()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"pad_height": (0.1, 3.0)}, "pad_height"),
        ({"pad_height": (4.0, 3.0)}, "pad_height"),
        ({"start_height": (0.2, 200.0)}, "start_height"),
        ({"pad_spacing": 1.3}, "pad_spacing"),
        ({"distance": 1.0}, "distance"),
        ({"pad_speed": 1.0, "pad_circle": 0.0}, "pad_circle"),
        ({"pad_tilt": 0.1, "pad_period": 0.0}, "pad_period"),
        ({"d_safe": 1.0}, "d_safe"),
    ],
)
def test_options_that_make_no_mission_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        bulletuav.Aviary("pad_landing", **options)


@pytest.mark.parametrize("contacts", ["impulse", "stop", "bullet"])
def test_obstacles_turn_in_all_models_of_contacts(contacts):
    aviary = made(dynamics="bullet", contacts=contacts, **MOVING)
    aviary.reset(seeds=0)
    for _ in range(5):
        aviary.step(np.zeros((1, 2, 3)) + (0.0, 0.0, 0.5))
        scenery = aviary.worlds.engine.scenery
        np.testing.assert_array_equal(scenery.quaternion, aviary.scene.obstacle_quaternion)
        np.testing.assert_array_equal(scenery.place, aviary.scene.obstacle)
        assert not scenery.spin.any()
    assert aviary.scene.memory["pad_spin"].any()
    aviary.close()


def test_a_drone_that_stands_on_a_rocking_pad_tilts_with_it():
    aviary = made(pad_tilt=0.2, pad_period=4.0, extra_pads=0, num_drones=1)
    aviary.reset(seeds=0)
    policy = find_policy("pad_pilot")(aviary)
    policy.reset(np.ones(1, dtype=bool))
    while aviary.scene.memory["stable_time"][0, 0] < 0.1:
        aviary.step(policy.act(None, aviary.swarm))
        assert aviary.alive.all()
    # Without a claim, so that the drone stays for a period
    above = []
    for _ in range(200):
        aviary.scene.memory["stable_time"][:] = 0.0
        aviary.step(np.array([[[0.0, 0.0, -1.0]]]))
        assert aviary.worlds.frame.landed.all()
        pad, drone = aviary.scene.obstacle_quaternion[0, 0], aviary.swarm.quaternion[0, 0]
        up = [
            np.array((2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)))
            for x, y, z, w in (pad, drone)
        ]
        above.append(up[0] @ up[1])
    # The pad tilts by 11 degrees
    assert np.min(above) > np.cos(np.radians(1.0))
    aviary.close()
