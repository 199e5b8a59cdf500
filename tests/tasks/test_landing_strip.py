"""Task `landing_strip`: limits of a touchdown, the runway's use, and what policies earn."""

import math

import numpy as np
import pytest

from bulletuav.analysis.evaluation import evaluate
from bulletuav.envs.aviary import Aviary
from bulletuav.policies import find_policy
from bulletuav.vehicle.airframes import load_airframe
from bulletuav.vehicle.envelope import find_envelope

MIN_SPEED = find_envelope(load_airframe("trainer")).min_speed


@pytest.fixture
def strip():
    """An airspace of two aircraft without wind."""
    aviary = Aviary("landing_strip", 1, difficulty="easy", dynamics="point_mass", seed=4)
    aviary.reset()
    yield aviary
    aviary.close()


def touch(strip, place=(30.0, 0.0), velocity=(11.0, 0.0, -0.8), drone=0):
    """Put an aircraft just above the flare height, and fly one decision at its velocity."""
    # The second aircraft stays far behind
    flare = strip.task.flare[drone]
    strip.swarm.position[0, drone] = place[0] - 0.1 * velocity[0], place[1], flare + 0.01
    strip.swarm.velocity[0, drone] = velocity
    action = np.array(strip.swarm.velocity) / strip.options.max_speed
    action[0, drone] = np.array(velocity) / strip.options.max_speed
    return strip.step(action)


def down(strip, drone=0):
    """How the touchdown of an aircraft counts."""
    return strip.scene.memory["down"][0, drone]


def test_a_slow_level_aligned_touchdown_on_the_runway_is_safe(strip):
    step = touch(strip)
    assert down(strip) == 2.0
    assert step.info["success"][0, 0]
    assert step.info["sink_rate"][0, 0] == pytest.approx(0.8, abs=0.05)
    assert step.info["centreline"][0, 0] == 0.0
    assert step.info["touchdown"][0, 0] == pytest.approx(30.0, abs=0.1)
    assert not strip.alive[0, 0]
    assert strip.alive[0, 1]


@pytest.mark.parametrize(
    ("place", "velocity"),
    [
        ((-5.0, 0.0), (11.0, 0.0, -0.8)),  # before the threshold
        ((65.0, 0.0), (11.0, 0.0, -0.8)),  # beyond the touchdown zone
        ((30.0, 7.0), (11.0, 0.0, -0.8)),  # beside the runway
        ((30.0, 0.0), (1.55 * MIN_SPEED, 0.0, -0.8)),  # fast
        ((30.0, 0.0), (11.0 * math.cos(0.2), 11.0 * math.sin(0.2), -0.8)),  # 11.5 degrees askew
    ],
)
def test_a_touchdown_beyond_a_limit_is_none(strip, place, velocity):
    step = touch(strip, place, velocity)
    assert down(strip) == 1.0
    assert not step.info["success"][0, 0]
    assert step.terminated[0, 0]


def test_a_hard_touchdown_is_none(strip):
    strip.task.config.__dict__["sink_rate"] = 0.5
    touch(strip)
    assert down(strip) == 1.0


def test_a_banked_touchdown_is_none(strip):
    strip.task.config.__dict__["course"] = 90.0
    # A turn at the largest bank, 40 degrees
    flare = strip.task.flare[0]
    strip.swarm.position[0, 0] = 29.0, 0.0, flare + 0.01
    strip.swarm.velocity[0, 0] = 11.0, 0.0, -0.8
    action = np.array(strip.swarm.velocity) / strip.options.max_speed
    action[0, 0] = (0.0, 11.0 / strip.options.max_speed, -0.8 / strip.options.max_speed)
    strip.step(action)
    assert down(strip) == 1.0


def test_a_touchdown_occupies_the_runway(strip):
    touch(strip)
    touch(strip, drone=1)
    assert down(strip, 0) == 2.0
    assert down(strip, 1) == 1.0


def test_the_runway_is_free_again_after_its_time(strip):
    touch(strip)
    strip.swarm.position[0, 1] = -300.0, 0.0, 40.0
    east = np.zeros((1, 2, 3))
    east[..., 0] = 11.0 / strip.options.max_speed
    for _ in range(69):
        strip.step(east)
    touch(strip, drone=1)
    assert down(strip, 1) == 2.0


def test_drones_observe_how_long_the_runway_is_occupied():
    names = ("runway", "velocity")
    aviary = Aviary("landing_strip", 1, difficulty="easy", dynamics="point_mass", observation=names)
    rows = [aviary.reset()[0, 1, 0]]
    rows.append(touch(aviary).observations[0, 1, 0])
    east = np.zeros((1, 2, 3))
    east[..., 0] = 11.0 / aviary.options.max_speed
    rows += [aviary.step(east).observations[0, 1, 0] for _ in range(80)]
    assert rows[:2] == [0.0, 7.0]
    np.testing.assert_allclose(rows[2:72], np.arange(69, -1, -1) / 10, atol=1e-6)
    assert not any(rows[72:])
    aviary.close()


def test_the_runway_is_observed_in_this_task_only():
    with pytest.raises(ValueError, match="observation block 'runway' shows what task 'crossing'"):
        Aviary("crossing", 1, observation=("runway",))


@pytest.mark.parametrize(("drones", "runway_time", "horizon"), [(8, 7.0, 1233), (8, 20.0, 2793)])
def test_the_horizon_leaves_time_for_all_touchdowns(drones, runway_time, horizon):
    aviary = Aviary("landing_strip", 1, num_drones=drones, runway_time=runway_time)
    # 1.5 (250 m / v + 8 times the longer of 65 m / v and the runway time), v = 9.5639 m/s
    assert aviary.options.horizon == horizon
    aviary.close()


def test_absent_aircraft_do_not_land():
    options = {"difficulty": "easy", "dynamics": "point_mass", "num_drones": (2, 4)}
    aviary = Aviary("landing_strip", 8, seed=0, **options)
    aviary.reset()
    absent = ~aviary.alive
    assert set(absent.sum(axis=1)) == {0, 1, 2}
    aviary.swarm.position[..., 2] = 0.0
    aviary.step(np.zeros((8, 4, 3)))
    np.testing.assert_array_equal(aviary.scene.memory["down"] > 0, ~absent)
    aviary.close()


def test_starts_are_on_the_glide_path_and_apart():
    aviary = Aviary("landing_strip", 20, difficulty="extreme", dynamics="point_mass", seed=0)
    aviary.reset()
    offset = aviary.swarm.position - aviary.task.touchdown
    distance = np.hypot(offset[..., 0], offset[..., 1])
    # 4 degrees: 0.0699 m of height per metre
    np.testing.assert_allclose(offset[..., 2], 0.0699268 * distance, rtol=1e-6)
    apart = np.diff(np.sort(distance, axis=1), axis=1)
    assert apart.min() >= aviary.task.config.spacing / 2
    angle = np.degrees(np.arctan2(offset[..., 1], -offset[..., 0]))
    assert np.abs(angle).max() <= 30.0
    # Each order of the drones is drawn
    assert len({tuple(row) for row in np.argsort(distance, axis=1).tolist()}) > 15
    aviary.close()


@pytest.mark.parametrize("difficulty", ["easy", "hard"])
def test_shirkers_earn_less_than_the_baseline(difficulty):
    options = {"difficulty": difficulty, "dynamics": "point_mass", "episodes": 4}
    baseline = evaluate("landing_strip", **options)
    earned = np.mean([row["return"] for row in baseline.rows])
    for policy in ("strip_low_pass", "strip_hold", "strip_rush", "strip_undershoot"):
        rows = evaluate("landing_strip", policy, **options).rows
        assert np.mean([row["return"] for row in rows]) < earned - 50.0
        if policy != "strip_rush":
            assert not any(row["drone_success"] for row in rows)


@pytest.mark.parametrize(
    ("difficulty", "least", "most"),
    [("easy", 1.0, 1.0), ("medium", 0.9, 0.99), ("hard", 0.75, 0.9), ("extreme", 0.5, 0.75)],
)
def test_more_aircraft_need_turns_to_keep_the_runway_free(difficulty, least, most):
    options = {"difficulty": difficulty, "dynamics": "point_mass", "episodes": 20}
    by_speed, by_turns = (
        np.mean([row["drone_success"] for row in evaluate("landing_strip", policy, **options).rows])
        for policy in ("final_approach", "approach_oracle")
    )
    assert least <= by_speed <= most
    assert by_turns >= 0.9


@pytest.mark.parametrize(
    ("seconds", "angle", "speed"), [(55.0, 0.0, 10.106), (80.0, 50.2, 9.851), (100.0, 60.0, 9.851)]
)
def test_s_turns_make_the_delay(seconds, angle, speed):
    aviary = Aviary("landing_strip", 1, num_drones=1, wind=(0.0, 0.0, 0.0), dynamics="point_mass")
    aviary.reset(seeds=0)
    # 570 m before the touchdown point, on the glide path; the runway is free in some seconds
    aviary.swarm.position[0, 0] = aviary.task.touchdown[0] + (-570.0, 0.0, 570.0 * 0.0699268)
    aviary.scene.memory["runway_free"][0, 0] = seconds
    # Slowest speed 1.03 x 9.5639 = 9.851 m/s; the last 16 s of it are straight. Touchdown is 1.4 s
    # later than the runway is free: (570 - 157.6) m in 65.4 s are 6.305 m/s, 9.851 cos(50.2 deg)
    policy = find_policy("approach_oracle", "landing_strip")(aviary)
    east, north, _ = policy.act(None, aviary.swarm)[0, 0] * aviary.options.max_speed
    assert np.degrees(np.arctan2(north, east)) == pytest.approx(angle, abs=0.1)
    assert np.hypot(east, north) == pytest.approx(speed, abs=2e-3)
    aviary.close()


@pytest.mark.parametrize("dynamics", ["single_integrator", "double_integrator", "rigid_body"])
def test_the_baseline_lands_at_all_levels(dynamics):
    rows = evaluate("landing_strip", dynamics=dynamics, difficulty="medium", episodes=2).rows
    assert all(row["drone_success"] == 1.0 for row in rows)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"spacing": 8.0}, "starts may be in conflict: spacing 8 m must exceed 10 m"),
        ({"width": 0.0}, "width is 0: it must be above 0"),
        ({"airframe": "trainer", "take_off": True}, "take_off is True"),
    ],
)
def test_impossible_options_are_errors(options, message):
    with pytest.raises(ValueError, match=message):
        Aviary("landing_strip", 1, **options)


@pytest.mark.parametrize("name", ["distance", "spacing", "runway_time"])
def test_a_size_beyond_its_bound_is_named(name):
    with pytest.raises(ValueError, match=f"^{name} is 1e\\+300"):
        Aviary("landing_strip", **{name: 1e300})
