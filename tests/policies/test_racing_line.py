"""Racing lines against formulas of motion, and the pilot that flies them."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import bulletuav
from bulletuav.policies import find_policy
from bulletuav.policies.race_pilot import RacePilot
from bulletuav.policies.racing_line import (
    SAMPLES,
    GatePath,
    RacingLimits,
    compute_speed_profile,
    default_parameters,
    make_line,
    optimize_line,
)
from bulletuav.tasks.parts.tracks import list_tracks

AXES = np.eye(3)


def straight_way(*places, first_speed=0.0):
    point = np.array([(x, 0.0, 0.0) for x in places])
    return GatePath(point, np.tile(AXES, (len(point), 1, 1)), np.zeros(len(point)), first_speed)


def timed(position, first_speed, limits):
    count = len(position)
    velocity, room = np.empty((2, count, 3))
    time = np.empty(count)
    compute_speed_profile(position, count, first_speed, limits, time, velocity, room)
    return time, velocity


@pytest.mark.parametrize("first_speed", [0.0, 3.0, 10.0])
def test_a_straight_is_flown_as_by_the_formulas_of_motion(first_speed):
    limits = RacingLimits(10.0, 4.0, 0.0)
    line = make_line(
        straight_way(0.0, 40.0, first_speed=first_speed), default_parameters(2), limits
    )
    rise = (10.0 - first_speed) / 4.0
    way = (10.0**2 - first_speed**2) / 8.0
    assert line.time[-1] == pytest.approx(rise + (40.0 - way) / 10.0, rel=5e-3)
    assert np.linalg.norm(line.velocity, axis=1).max() <= 10.0 + 1e-9
    np.testing.assert_allclose(line.velocity[:, 1:], 0.0, atol=1e-12)


def test_drag_slows_down_as_the_differential_equation_says():
    limits = RacingLimits(100.0, 4.0, 0.5)
    position = np.zeros((4001, 3))
    position[:, 0] = np.linspace(0.0, 60.0, 4001) ** 2 / 60.0
    time, velocity = timed(position, 0.0, limits)
    there = solve_ivp(
        lambda t, y: (y[1], 4.0 - 0.5 * y[1]), (0, 20), (0.0, 0.0), rtol=1e-9, dense_output=True
    ).sol(time[2000::400])
    np.testing.assert_allclose(there[0], position[2000::400, 0], rtol=1e-2)
    np.testing.assert_allclose(there[1][:-1], velocity[2000:-1:400, 0], rtol=1e-2)
    assert velocity[:, 0].max() < 4.0 / 0.5


@pytest.mark.parametrize("drag", [0.0, 0.3])
def test_the_speed_in_a_circle_is_what_turning_and_drag_leave(drag):
    angle = np.linspace(0, 6 * np.pi, 4000)
    position = np.stack([6 * np.cos(angle), 6 * np.sin(angle), np.full(4000, 2.0)], axis=1)
    _, velocity = timed(position, 0.0, RacingLimits(50.0, 9.0, drag))
    speed = np.linalg.norm(velocity, axis=1)[3000]
    assert np.hypot(speed**2 / 6.0, drag * speed) == pytest.approx(9.0, rel=1e-3)


def test_a_line_brakes_in_time_for_a_corner_and_keeps_within_its_limits():
    corner = np.concatenate(
        [
            np.stack([np.linspace(-30, 0, 300), np.zeros(300), np.zeros(300)], axis=1),
            np.stack(
                [
                    2 * np.sin(a := np.linspace(0.01, np.pi / 2, 60)),
                    2 - 2 * np.cos(a),
                    np.zeros(60),
                ],
                axis=1,
            ),
            np.stack([np.full(300, 2.0), np.linspace(2.1, 32, 300), np.zeros(300)], axis=1),
        ]
    )
    time, velocity = timed(corner, 10.0, RacingLimits(10.0, 5.0, 0.0))
    speed = np.linalg.norm(velocity, axis=1)
    assert speed[330] == pytest.approx(np.sqrt(5.0 * 2.0), rel=0.03)
    fast = int(np.flatnonzero(speed[:301] > 9.9)[-1])
    assert corner[300, 0] - corner[fast, 0] == pytest.approx((100 - 10) / 10.0, rel=0.1)
    change = np.diff(speed) / np.diff(time)
    assert np.abs(change[5:-5]).max() < 5.0 * 1.1


def test_lines_pass_gates_where_and_how_they_choose():
    rng = np.random.default_rng(0)
    axis = np.linalg.qr(rng.normal(size=(4, 3, 3)))[0]
    way = GatePath(rng.uniform(-20, 20, (4, 3)), axis, np.array((0.0, 0.5, 0.7, 0.9)), 0.0)
    choice = default_parameters(4)
    choice[:4] = rng.uniform(-0.5, 0.5, (4, 4))
    line = make_line(way, choice, RacingLimits(10.0, 5.0, 0.1))
    assert len(line.time) == 3 * SAMPLES + 1
    assert (np.diff(line.time) > 0).all()
    for m in range(1, 4):
        off = axis[m] @ (line.position[m * SAMPLES] - way.point[m])
        np.testing.assert_allclose(off, (0.0, *way.clearance[m] * choice[:2, m]), atol=1e-12)
        turn, rise = choice[2:4, m]
        wanted = (np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise))
        seen = axis[m] @ (line.position[m * SAMPLES] - line.position[m * SAMPLES - 1])
        assert seen @ wanted / np.linalg.norm(seen) > 0.9


def test_the_fastest_line_is_faster_and_straight_where_it_can_be():
    limits = RacingLimits(10.0, 5.0, 0.1)
    way = straight_way(0.0, 10.0, 25.0)
    way.point[1, 1] = 0.4  # within the room: the straight line is free
    free = way._replace(clearance=np.array((0.0, 0.5, 0.5)))
    best, plain = (
        make_line(straight_way(0.0, 25.0), default_parameters(2), limits),
        default_parameters(3),
    )
    found = make_line(free, optimize_line(free, limits), limits)
    assert found.time[-1] < make_line(free, plain, limits).time[-1]
    assert found.time[-1] == pytest.approx(best.time[-1], rel=5e-3)


def lap(dynamics="bullet", worlds=4, with_reference=False, **options):
    """Fly a race of one drone in each world; give the times of the fastest lines, and all told."""
    aviary = bulletuav.Aviary("race", worlds, num_drones=1, dynamics=dynamics, **options)
    policy = find_policy("race_pilot")(aviary)
    assert isinstance(policy, RacePilot)
    observations = aviary.reset(seeds=0)
    policy.reset(np.ones(worlds, dtype=bool))
    references = [policy.fastest(w, aviary.swarm) for w in range(worlds if with_reference else 0)]
    told = {name: np.zeros(worlds) for name in ("success", "race_time", "missed")}
    while aviary.alive.any():
        flown = aviary.alive[:, 0].copy()
        step = aviary.step(policy.act(observations, aviary.swarm))
        observations = step.observations
        for name, kept in told.items():
            kept[flown] = step.info[name][flown, 0]
    aviary.close()
    return references, told


def test_the_pilot_laps_within_15_per_cent_of_the_fastest_line():
    references, told = lap(difficulty="easy", with_reference=True)
    assert told["success"].all()
    assert not told["missed"].any()
    for reference, time in zip(references, told["race_time"], strict=True):
        assert reference < time < 1.15 * reference


@pytest.mark.parametrize(
    ("difficulty", "least"), [("medium", 1.0), ("hard", 0.8), ("extreme", 0.5)]
)
def test_the_pilot_laps_every_difficulty(difficulty, least):
    _, told = lap("rigid_body", 6, difficulty=difficulty)
    assert told["success"].mean() >= least


@pytest.mark.parametrize("track", list_tracks())
def test_the_pilot_laps_our_tracks(track):
    _, told = lap("rigid_body", 1, track=track, laps=3, horizon=1200, difficulty="easy")
    assert told["success"].all()  # 18 gates and more, which are planned on in flight


@pytest.mark.parametrize("dynamics", ["single_integrator", "double_integrator", "point_mass"])
def test_the_pilot_laps_in_all_dynamics(dynamics):
    _, told = lap(dynamics, difficulty="medium")
    assert told["success"].all()


def test_a_pilot_that_is_pushed_off_its_line_plans_anew():
    aviary = bulletuav.Aviary("race", num_drones=1, dynamics="point_mass", difficulty="easy")
    policy = find_policy("race_pilot")(aviary)
    observations = aviary.reset(seeds=0)
    policy.reset(np.ones(1, dtype=bool))
    for k in range(500):
        action = policy.act(observations, aviary.swarm)
        if 50 < k < 65:  # straight up instead
            action[...] = (0.0, 0.0, 1.0)
        step = aviary.step(action)
        if not aviary.alive.any():
            break
    assert step.info["success"].all()


def test_the_pilot_flies_races_alone():
    aviary = bulletuav.Aviary("crossing", dynamics="point_mass")
    with pytest.raises(ValueError, match="supports task 'race', not 'crossing'"):
        find_policy("race_pilot")(aviary)


def test_lines_of_later_drones_are_delayed_with_those_before_them():
    aviary = bulletuav.Aviary("race", 2, num_drones=3, dynamics="point_mass")
    policy = find_policy("race_pilot")(aviary)
    observations = aviary.reset(seeds=0)
    policy.reset(np.ones(2, dtype=bool))
    while aviary.steps[0] < 40:  # all have started
        observations = aviary.step(policy.act(observations, aviary.swarm)).observations
    before = policy._start_time.copy()
    # The first drone of world 0 falls behind, not so far that it plans a new line
    policy._start_time[0, 0] += 0.1
    policy.act(observations, aviary.swarm)
    gaps = np.diff(policy._start_time[0])
    assert (gaps >= policy.headway - 1e-9).all()
    assert policy._start_time[0, 2] > before[0, 2] + 0.05
    np.testing.assert_allclose(policy._start_time[1], before[1], atol=0.02)
