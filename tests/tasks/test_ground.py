"""Take-off from the ground, and landing on it."""

import gymnasium
import numpy as np
import pytest
from scipy.spatial.distance import pdist

import bulletuav
from bulletuav.policies.find import find_policy
from bulletuav.tasks import find_task
from bulletuav.tasks.frame import MAX_TOUCHDOWN_SPEED

LEVELS = ["single_integrator", "point_mass", "rigid_body", "bullet"]
POINTS = {"dynamics": "single_integrator"}


def fly(aviary, policy, decisions=500):
    """Fly worlds; give what each drone's infos told at any time, and last."""
    observations = aviary.reset(seeds=0)
    pilot = find_policy(policy)(aviary)
    pilot.reset(np.ones(aviary.num_worlds, dtype=bool))
    shape = aviary.alive.shape
    ever = {name: np.zeros(shape, dtype=bool) for name in ("landed", "success", "collision")}
    for _ in range(decisions):
        if not aviary.alive.any():
            break
        step = aviary.step(pilot.act(observations, aviary.swarm))
        observations = step.observations
        for name, told in ever.items():
            told |= step.info[name]
    return ever


@pytest.mark.parametrize("task", [one for one in bulletuav.list_tasks() if one != "landing_strip"])
def test_every_task_can_start_on_the_ground(task):
    # In `landing_strip` aeroplanes start in flight
    options = {"action": "velocity", "randomization": {}, **POINTS}
    if find_task(task).needs_cables:
        options["dynamics"] = "rigid_body"
    if task == "interception":
        options["city"] = "forest"  # drones do not stand on hills
    aviary = bulletuav.Aviary(task, 2, take_off=True, **options)
    aviary.reset(seeds=0)
    stands = np.array([[airframe.standing_height for airframe in aviary.options.airframe]] * 2)
    if task == "pad_landing":  # on platforms
        stands = stands + aviary.scene.obstacle[:, aviary.task.pads.count :, 2] + 0.1
    np.testing.assert_allclose(
        aviary.swarm.position[..., 2],
        stands,
        rtol=1e-7,
        atol=1.1e-3 if task == "pad_landing" else 0.0,
    )
    assert not aviary.swarm.velocity.any()
    assert not aviary.swarm.rotor_speed.any()
    still = np.zeros((2, aviary.num_drones, aviary.action.low.shape[-1]))
    info = aviary.step(still).info
    assert not info["collision"].any()
    assert aviary.alive.all()
    upwards = still + (0.0, 0.0, 1.0)
    for _ in range(15 if task == "pad_landing" else 3):
        info = aviary.step(upwards).info
    assert aviary.alive.all()
    assert not info["landed"].any()
    assert (aviary.swarm.position[..., 2] > stands + 0.1).all()


@pytest.mark.parametrize("difficulty", ["easy", "medium", "hard", "extreme"])
def test_free_flight_has_room_to_take_off(difficulty):
    aviary = bulletuav.Aviary("free_flight", 20, difficulty=difficulty, take_off=True, **POINTS)
    aviary.reset(seeds=0)
    apart = 2 * aviary.task.config.d_safe
    for places in aviary.swarm.position:
        assert pdist(places).min() > apart
    aviary.close()


@pytest.mark.parametrize("dynamics", LEVELS)
def test_goals_of_pursuit_wait_for_the_climb(dynamics):
    """The climb of 40 m at 10 m/s, half of max_speed, takes 4 s; goals speed up for as long."""
    aviary = bulletuav.Aviary("pursuit", dynamics=dynamics, take_off=True, randomization={})
    observations = aviary.reset(seeds=0)
    above, paid = aviary.scene.goal.copy(), []
    succeeded = np.zeros(8, dtype=bool)
    pilot = find_policy("pursuit_oracle")(aviary)
    pilot.reset(np.ones(1, dtype=bool))
    cruising = aviary.scene.memory["cruising_speed"].copy()
    while aviary.alive.any():
        if len(paid) <= 40:
            np.testing.assert_allclose(aviary.scene.goal, above)
        if len(paid) <= 100:
            fraction = np.clip((len(paid) - 40) / 40, 0, 1)
            speed = np.linalg.norm(aviary.scene.goal_velocity, axis=-1)
            np.testing.assert_allclose(speed, fraction * cruising, atol=1e-9)
        if len(paid) in (60, 80, 100):  # 1/2 t^2 / 4 s, then t
            moved = {60: 0.5, 80: 2.0, 100: 4.0}[len(paid)] * cruising
            flown = aviary.task.flown(cruising, np.array([len(paid) * 0.1]))
            np.testing.assert_allclose(flown, moved)
            chord = np.linalg.norm(aviary.scene.goal - above, axis=-1)
            np.testing.assert_allclose(chord, 120 * np.sin(moved / 120))
        step = aviary.step(pilot.act(observations, aviary.swarm))
        observations = step.observations
        paid.append(step.info["reward/lap"][0])
        succeeded |= step.info["success"][0]
    assert succeeded.all()
    paid = np.array(paid)
    assert not paid[:40].any()
    assert (paid[41:50] > 0).all()
    np.testing.assert_allclose(paid.sum(axis=0), 500)
    aviary.close()


def test_the_slack_of_pursuit_counts_after_the_climb():
    aviary = bulletuav.Aviary("pursuit", take_off=True, randomization={}, **POINTS)
    aviary.reset(seeds=0)
    still = np.zeros((1, 8, 3))
    for _ in range(39):
        aviary.step(still)
    assert aviary.alive.all()
    for _ in range(2):
        aviary.step(still)
    assert not aviary.alive.any()
    aviary.close()


@pytest.mark.parametrize("dynamics", LEVELS)
def test_drones_take_off_fly_and_land(dynamics):
    options = {"take_off": True, "at_goal": "land", "randomization": {}, "altitude": 10.0}
    aviary = bulletuav.Aviary(
        "converge", num_drones=2, radius=20.0, dynamics=dynamics, margin=9.0, **options
    )
    ever = fly(aviary, "orca")
    assert ever["success"].all()
    assert ever["landed"].all()
    assert not ever["collision"].any()
    goal = aviary.scene.goal[0]
    assert (goal[:, 2] == 0).all()
    away = np.linalg.norm(aviary.swarm.position[0, :, :2] - goal[:, :2], axis=1)
    assert (away <= aviary.task.config.goal_radius).all()


@pytest.mark.parametrize("dynamics", LEVELS)
def test_hover_takes_off_or_lands(dynamics):
    for place in ("take_off", "land"):
        options = {place: True, "min_in_place": 0.25}
        aviary = bulletuav.Aviary("hover", 2, action="velocity", dynamics=dynamics, **options)
        ever = fly(aviary, "straight", 200)
        assert ever["success"].all()
        assert not ever["collision"].any()
        assert aviary.alive.all()
        assert ever["landed"].any() or "land" not in options


def test_hovering_low_is_no_landing():
    options = {"land": True, "start_offset": 0.0, "min_in_place": 0.001}
    aviary = bulletuav.Aviary("hover", 1, action="velocity", **options, **POINTS)
    aviary.reset(seeds=0)
    height = aviary.swarm.position[0, 0, 2]
    down = np.array([[[0.0, 0.0, -1.0]]])
    while height > 0.16:
        speed = min(1.0, (height - 0.12) * 30 / aviary.options.max_speed)
        info = aviary.step(down * speed).info
        height = aviary.swarm.position[0, 0, 2]
    info = aviary.step(down * (height - 0.08) * 30 / aviary.options.max_speed).info
    assert info["goal_distance"][0, 0] < aviary.task.config.goal_radius
    assert not info["success"][0, 0]
    assert info["reward/holding"][0, 0] == 0
    for _ in range(3):
        info = aviary.step(down * 0.3).info
    assert info["landed"][0, 0]
    assert info["success"][0, 0]
    assert info["reward/holding"][0, 0] == 1


@pytest.mark.parametrize(
    ("speed", "lands"), [(0.9 * MAX_TOUCHDOWN_SPEED, True), (1.1 * MAX_TOUCHDOWN_SPEED, False)]
)
@pytest.mark.parametrize("dynamics", ["single_integrator", "bullet"])
def test_a_fast_touch_is_a_collision(dynamics, speed, lands):
    aviary = bulletuav.Aviary(
        "converge", num_drones=1, dynamics=dynamics, take_off=True, randomization={}
    )
    aviary.reset(seeds=0)
    up = np.array([[[0.0, 0.0, 1.0]]]) / aviary.options.max_speed
    for _ in range(30):
        aviary.step(4.0 * up)
    for _ in range(200):
        info = aviary.step(-speed * up).info
        if info["collision"].any() or info["landed"].any():
            break
    assert info["landed"].all() == lands
    assert info["collision"].all() != lands
    assert aviary.alive.all() == lands


def test_a_tilted_touch_is_a_collision():
    # Nothing holds it up: from 0.13 m it falls with less than 2 m/s, tilted as it starts.
    touched = set()
    for seed in range(12):
        aviary = bulletuav.Aviary(
            "hover", land=True, height=0.13, start_offset=0.0, start_tilt=90.0, max_distance=5.0
        )
        aviary.reset(seeds=seed)
        x, y = aviary.swarm.quaternion[0, 0, :2]
        tilt = np.degrees(np.arccos(1 - 2 * (x * x + y * y)))
        for _ in range(10):
            info = aviary.step(-np.ones((1, 1, 4))).info
            if info["collision"].any() or info["landed"].any():
                break
        if abs(tilt - 30) > 3:  # the last centimetres may turn it
            assert info["landed"].any() == (tilt < 30), tilt
            touched.add(bool(info["landed"].any()))
    assert touched == {True, False}


def test_roofs_and_other_drones_are_no_ground():
    high = {"take_off": True, "randomization": {}, **POINTS}
    aviary = bulletuav.Aviary("los", 1, num_drones=2, city="urban", ceiling=70.0, **high)
    aviary.reset(seeds=0)
    roof = max(aviary.solids().bounds, key=lambda box: box[1, 2])
    above = [*roof.mean(axis=0)[:2], roof[1, 2] + 1.0]
    aviary.swarm.position[0, 0] = above
    info = None
    for _ in range(40):
        info = aviary.step(np.array([[[0.0, 0.0, -0.1 / 15], [0.0, 0.0, 0.0]]]) * 10).info
        if info["collision"].any():
            break
    np.testing.assert_array_equal(info["collision"], [[True, False]])
    np.testing.assert_array_equal(info["landed"], [[False, True]])


def test_without_the_options_the_ground_is_hit():
    aviary = bulletuav.Aviary("converge", num_drones=1, randomization={}, altitude=5.0, **POINTS)
    aviary.reset(seeds=0)
    for _ in range(60):
        info = aviary.step(np.array([[[0.0, 0.0, -0.05]]])).info
        if info["collision"].any():
            break
    assert info["collision"].all()
    assert "landed" not in info


def test_given_starts_are_put_on_the_ground():
    start = [(0.0, 0.0, 30.0), (20.0, 0.0, 0.0)]
    aviary = bulletuav.Aviary("free_flight", num_drones=2, start=start, take_off=True, **POINTS)
    aviary.reset(seeds=0)
    np.testing.assert_array_equal(aviary.swarm.position[0, :, :2], [(0, 0), (20, 0)])
    assert aviary.swarm.position[0, :, 2] == pytest.approx(aviary.task.context.standing_height)


def test_what_cannot_stand_or_land_is_refused():
    with pytest.raises(ValueError, match="land and take_off are both on"):
        bulletuav.Aviary("hover", land=True, take_off=True)
    with pytest.raises(ValueError, match="starts may be 20.5"):
        bulletuav.Aviary("hover", land=True, height=20.0)
    with pytest.raises(ValueError, match="of the ground, at most 50% is possible with take_off"):
        bulletuav.Aviary(
            "free_flight", num_drones=30, area=100.0, altitude_spread=60.0, take_off=True
        )
    above = [(0.0, 0.0, 50.0), (0.0, 0.0, 80.0)]
    with pytest.raises(ValueError, match="start positions of drones 0 and 1 overlap"):
        bulletuav.Aviary("free_flight", num_drones=2, start=above, take_off=True)


def test_names_carry_the_version():
    env = bulletuav.parallel_env("hover_v2")
    assert env.metadata["name"] == "bulletuav_hover_v2"
    assert bulletuav.parallel_env("hover-v2").metadata == env.metadata
    with pytest.raises(ValueError, match="this is version 2 of 'hover'.*'hover-v2'"):
        bulletuav.parallel_env("hover_v1")
    with (
        pytest.warns(DeprecationWarning, match="out of date"),
        pytest.raises(gymnasium.error.DeprecatedEnv, match="use `bulletuav/Hover-v2` instead"),
    ):
        gymnasium.make("bulletuav/Hover-v1")
