"""Metrics against episodes computed by hand."""

import numpy as np
import pytest
from scipy import stats

import bulletuav
from bulletuav.analysis.metrics import METRICS, Meter, estimate, jain, soonest_conflict
from bulletuav.city.model import City
from bulletuav.city.streets import Streets
from bulletuav.conflict.measures import pair_offsets, time_to_conflict
from bulletuav.geometry.solids import Solids
from bulletuav.policies import find_policy


@pytest.mark.parametrize(
    ("values", "expected"),
    [((1, 1, 1, 1), 1), ((1, 0, 0, 0), 0.25), ((1, 2, 3), 0.857143), ((0, 0), 1), ((5,), 1)],
)
def test_jain(values, expected):
    assert jain(np.array(values, float)) == pytest.approx(expected, abs=1e-6)


def test_soonest_conflict_agrees_with_the_measure_of_all_pairs():
    rng = np.random.default_rng(0)
    for _ in range(20):
        position, velocity = rng.uniform(-60, 60, (3, 6, 3)), rng.uniform(-20, 20, (3, 6, 3))
        alive = rng.uniform(size=(3, 6)) < 0.8
        times = time_to_conflict(pair_offsets(position), pair_offsets(velocity), 5.0)
        pairs = alive[:, :, None] & alive[:, None] & ~np.eye(6, dtype=bool)
        expected = np.where(pairs, times, np.inf).min(axis=(1, 2))
        np.testing.assert_allclose(soonest_conflict(position, velocity, alive, 5.0), expected)


def metered(task, act, seeds=0, worlds=1, **options):
    """Rows of one episode a world."""
    aviary = bulletuav.Aviary(
        task, worlds, randomization=options.pop("randomization", {}), **options
    )
    aviary.reset(seeds=seeds)
    meter = Meter(aviary)
    while aviary.alive.any():
        flown = aviary.alive.copy()
        meter.record(aviary.step(act(aviary)), flown)
    aviary.close()
    return [meter.row(w) for w in range(worlds)]


EXACT = {
    "dynamics": "single_integrator",
    "jitter": 0.0,
    "altitude_spread": 0.0,
    "start_speed": (10.0, 10.0),
}


EXACT_CONVERGE = {"dynamics": "single_integrator", "jitter": 0.0}


def at_ten(aviary):
    """Everyone straight ahead at 10 m/s: the first half north, the others east."""
    actions = np.zeros((aviary.num_worlds, aviary.num_drones, 3))
    north = (aviary.num_drones + 1) // 2
    actions[:, :north, 1] = actions[:, north:, 0] = 0.5
    return actions


def test_one_drone_that_flies_straight_by_hand():
    """200 m at 10 m/s: the goal counts from 2 m on, so after 198 m."""
    (row,) = metered("crossing", at_ten, num_drones=1, **EXACT)
    assert set(row) == set(METRICS)
    assert row["success"] == row["drone_success"] == 1
    assert row["collision"] == row["conflict"] == row["conflicts"] == row["near_misses"] == 0
    assert row["length"] == pytest.approx(19.8)
    assert row["goal_distance"] == pytest.approx(2.0)
    assert row["path_efficiency"] == pytest.approx(1.0)
    assert row["extra_path"] == pytest.approx(0.0, abs=1e-9)
    assert row["extra_time"] == pytest.approx(1.0)  # at half of max_speed
    assert row["jerk"] == pytest.approx(0, abs=1e-9)
    assert row["fairness"] == 1
    assert row["throughput"] == pytest.approx(60 / 19.8)
    assert all(
        np.isnan(row[name])
        for name in ("energy", "messages", "min_separation", "min_time_to_conflict")
    )


def test_two_that_cross_by_hand():
    """Drone 0 from (0, -100) north, drone 1 from (-100, 0) east, both at 10 m/s: they meet at 10 s.

    Their offset is sqrt(2) (100 - 10 t) long: 5 m 0.354 s before, 2.5 m 0.177 s before. The shapes
    touch at 0.5 m or so.
    """
    (row,) = metered("crossing", at_ten, num_drones=2, **EXACT)
    assert row["collision"] == row["conflict"] == row["conflicts"] == row["near_misses"] == 1
    assert row["success"] == row["drone_success"] == row["throughput"] == 0
    assert 9.9 <= row["length"] <= 10.0
    assert row["min_separation"] < 0.7
    assert row["min_time_to_conflict"] == 0
    assert all(np.isnan(row[name]) for name in ("path_efficiency", "extra_path", "extra_time"))
    assert row["fairness"] == pytest.approx(1.0)


def test_a_miss_by_hand():
    """Drone 1 starts 8 m higher: a closest approach of 8 m. With d_safe 10 it is a conflict."""
    for d_safe, conflict in ((5.0, 0), (10.0, 1)):
        options = EXACT | {"num_drones": 2, "d_safe": d_safe, "lane_spacing": 25.0}

        def act(aviary):
            actions = at_ten(aviary)
            if aviary.steps[0] < 8:
                actions[0, 1] = (0.5, 0.0, 0.5)
            return actions

        (row,) = metered("crossing", act, **options)
        assert row["conflict"] == row["conflicts"] == conflict
        assert row["near_misses"] == 0
        assert row["min_separation"] == pytest.approx(8.0, abs=1e-6)
        assert row["success"] == 0  # drone 1 flies past its goal, 8 m above it, out of the arena
        # The other drone reaches its goal, which is no success after a conflict
        assert row["drone_success"] == row["safe_success"] == (0.0 if conflict else 0.5)
        assert np.isnan(row["min_time_to_conflict"]) == (not conflict)


def test_jerk_and_efficiency_by_hand():
    """One drone, 10 m/s north, but 1 s sideways in between: v changes by sqrt(2) 10 m/s twice."""

    def act(aviary):
        actions = at_ten(aviary)
        if 50 <= aviary.steps[0] < 60:
            actions[0, 0] = (0.5, 0.0, 0.0)
        elif 60 <= aviary.steps[0] < 70:
            actions[0, 0] = (-0.5, 0.0, 0.0)
        return actions

    (row,) = metered("crossing", act, num_drones=1, **EXACT)
    steps = 198 + 20
    assert row["length"] == pytest.approx(steps / 10)
    assert row["path_efficiency"] == pytest.approx(198 / (steps - 0), rel=1e-9)
    assert row["extra_path"] == pytest.approx(20 / 198, rel=1e-9)
    assert row["extra_time"] == pytest.approx(steps / 99 - 1, rel=1e-9)
    changes = [
        np.sqrt(2) * 10,
        20.0,
        np.sqrt(2) * 10,
    ]  # at three decisions; each a jump up and down of acceleration
    assert row["jerk"] == pytest.approx(2 * sum(changes) / 0.1**2 / (steps - 1), rel=1e-9)


def test_a_drone_that_starts_at_its_goal_has_no_extra_path_or_time():
    """Only drone 1 counts, which flies 20 m at half of max_speed, to within 2 m of its goal."""
    starts, goals = [(0, 0, 40), (20, 0, 40)], [(0, 0, 40), (40, 0, 40)]
    act = lambda aviary: np.array([[(0.0, 0, 0), (0.5, 0, 0)]])  # noqa: E731
    places = {"start": starts, "goal": goals, "start_speed": (0.0, 0.0)}
    (row,) = metered("converge", act, num_drones=2, **(EXACT_CONVERGE | places))
    assert row["drone_success"] == 1
    assert row["extra_path"] == pytest.approx(0.0, abs=1e-9)
    assert row["extra_time"] == pytest.approx(1.0)


def test_energy_of_hovering_is_torque_times_speed():
    for dynamics in ("bullet", "rigid_body"):
        (row,) = metered(
            "hover",
            lambda aviary: np.zeros((1, 1, 4)),
            action="hover_rpm",
            horizon=60,
            start_offset=0.0,
            dynamics=dynamics,
            effects=(),
        )
        airframe = bulletuav.load_airframe("cf2x")
        speed = airframe.hover_speed()
        power = 4 * airframe.torque_ratio * airframe.thrust_coefficient * speed**3
        assert row["energy"] == pytest.approx(power * 2.0, rel=1e-6)


def test_messages_are_counted():
    (row,) = metered(
        "converge",
        lambda aviary: np.zeros((1, 3, 3)),
        num_drones=3,
        horizon=10,
        dynamics="point_mass",
        randomization={"radio_delay": 0.05},
    )
    assert row["messages"] == 3 * 2 * 10


def test_pursuit_counts_the_way_of_the_goal():
    """Following the goal round the circle at its pace is as short as can be."""
    aviary = bulletuav.Aviary(
        "pursuit", num_drones=1, dynamics="point_mass", jitter=0.0, randomization={}
    )
    aviary.reset(seeds=0)
    meter, policy = Meter(aviary), find_policy("straight")(aviary)
    while aviary.alive.any():
        flown = aviary.alive.copy()
        meter.record(aviary.step(policy.act(np.zeros(0), aviary.swarm)), flown)
    row = meter.row(0)
    assert row["success"] == 1
    assert row["path_efficiency"] > 0.97
    aviary.close()


def test_worlds_are_measured_apart():
    rows = metered(
        "converge",
        lambda aviary: np.zeros((3, 2, 3)),
        worlds=3,
        num_drones=2,
        horizon=20,
        dynamics="point_mass",
    )
    (alone,) = metered(
        "converge",
        lambda aviary: np.zeros((1, 2, 3)),
        seeds=1,
        num_drones=2,
        horizon=20,
        dynamics="point_mass",
    )
    np.testing.assert_array_equal(list(rows[1].values()), list(alone.values()))
    assert rows[0] != rows[1]


def test_intervals_of_rates_are_wilsons_and_of_means_the_bootstraps():
    rate = estimate("conflict", [1.0] * 3 + [0.0] * 97)
    assert rate[:1] == (0.03,)
    z = stats.norm.ppf(0.975)  # the formula of E. Wilson, 1927
    centre = (0.03 + z**2 / 200) / (1 + z**2 / 100)
    half = z * np.sqrt(0.03 * 0.97 / 100 + z**2 / 40000) / (1 + z**2 / 100)
    np.testing.assert_allclose(rate[1:3], (centre - half, centre + half), rtol=1e-9)
    sample = np.random.default_rng(1).normal(5, 2, 400)
    mean = estimate("length", [*sample, np.nan])
    assert mean.episodes == 400
    assert mean.mean == pytest.approx(sample.mean())
    half = 1.96 * sample.std() / 20
    np.testing.assert_allclose(
        (mean.low, mean.high), (sample.mean() - half, sample.mean() + half), atol=0.03
    )
    assert estimate("length", [*sample]) == estimate("length", [*sample])
    assert estimate("length", [2.0, 2.0])[:3] == (2, 2, 2)
    # Ten successes are no certainty: Wilson's lower end is n / (n + z^2)
    for metric in ("safe_success", "drone_success"):
        sure = estimate(metric, [1.0] * 10)
        assert sure[:3] == (1.0, pytest.approx(10 / (10 + z**2)), pytest.approx(1.0))
        never = estimate(metric, [0.0] * 10)
        assert never[:3] == (0.0, pytest.approx(0.0), pytest.approx(z**2 / (10 + z**2)))
        assert estimate(metric, [0.5, 0.5])[:3] == (0.5, 0.5, 0.5)
    # The bits of SciPy
    for k, n in ((0, 7), (3, 7), (7, 7), (41, 50)):
        theirs = stats.binomtest(k, n).proportion_ci(method="wilson")
        assert estimate("conflict", [1.0] * k + [0.0] * (n - k))[1:3] == tuple(theirs)
    for n in (2, 5, 97):
        part, rng = sample[:n], np.random.default_rng(0)
        resamples = {"n_resamples": 2000, "method": "percentile", "rng": rng}
        theirs = stats.bootstrap((part,), np.mean, **resamples).confidence_interval
        assert estimate("length", [*part])[1:3] == (theirs.low, theirs.high)
    nothing = estimate("energy", [np.nan])
    assert nothing.episodes == 0
    assert np.isnan(nothing.mean)


def test_a_conflict_that_was_there_from_the_start_is_one():
    row = metered(
        "hover",
        lambda aviary: np.zeros((1, 2, 4)),
        action="hover_rpm",
        num_drones=2,
        horizon=5,
        d_safe=5.0,
    )[0]
    assert row["conflict"] == 1
    assert row["conflicts"] == 0
    assert row["min_separation"] < 5


# Service to users

PLAIN = City(
    "plain",
    200.0,
    Solids(np.zeros((0, 2, 3))),
    np.zeros(0, dtype=int),
    Streets(np.zeros((0, 2)), np.zeros((0, 2), int)),
)
HOVER = {
    "city": PLAIN,
    "mobility": "still",
    "dynamics": "single_integrator",
    "height": (20.0, 20.0),
    "horizon": 10,
}
GOALS = ("goal_distance", "path_efficiency", "fairness", "throughput")
SERVICE = ("served", "completed", "latency")


def dive(*drones):
    """These drones dive, the others hover."""
    return lambda aviary: np.where(
        np.isin(np.arange(aviary.num_drones), drones)[:, None], (0, 0, -1.0), 0.0
    )[None]


def test_what_is_served_is_of_the_episode_as_planned():
    """In the plain everybody is in sight.

    From 20 m up the second decision of 15 m ends on the ground: 2 of 10 s.
    """
    for task in ("mobile_users", "mec"):
        for drones, dives, length, served in (
            (1, (), 10, 1.0),
            (1, (0,), 2, 0.2),
            (2, (0,), 10, 1.0),
            (2, (0, 1), 2, 0.2),
        ):
            (row,) = metered(task, dive(*dives), num_drones=drones, decision_hz=1, **HOVER)
            assert row["length"] == length
            assert row["served"] == pytest.approx(served)
            assert row["collision"] == (length == 2 or bool(dives))
    (row,) = metered(
        "los", dive(0), num_drones=1, decision_hz=5, max_speed=10.0, **HOVER
    )  # 2 m a decision: all 10
    assert row["served"] == pytest.approx(1.0)


def test_a_share_that_is_served_is_the_mean_over_time():
    aviary = bulletuav.Aviary("mobile_users", 2, area=250.0, num_layouts=1, horizon=12)
    aviary.reset(seeds=3)
    meter, served = Meter(aviary), np.zeros(2)
    while aviary.alive.any():
        flown, seen = aviary.alive.copy(), np.zeros(2)
        meter.record(aviary.step(np.full((2, 3, 3), (0.4, 0.0, 0.0))), flown)
        users = aviary.scene.memory["users"]
        for w in range(2):
            ways = [(i, j) for i in np.flatnonzero(flown[w]) for j in range(20)]
            start, end = (
                np.array(ends)
                for ends in zip(
                    *((aviary.swarm.position[w, i], users[w, j]) for i, j in ways), strict=True
                )
            )
            free = aviary.line_of_sight(start, end, w)
            seen[w] = len({j for (_, j), one in zip(ways, free, strict=True) if one}) / 20
        served += seen
    rows = [meter.row(w)["served"] for w in range(2)]
    assert rows == pytest.approx(served / 12)
    assert 0.1 < min(rows) < max(rows) < 0.95
    aviary.close()


@pytest.mark.parametrize("dives", [(), (0, 1)])
def test_what_is_completed_and_how_late_is_what_was_told_last(dives):
    """Shares fall where more tasks come than in the mean, and those of greater size are late."""
    options = {
        "num_drones": 2,
        "num_users": 5,
        "arrival_rate": 0.3,
        "deadline": 0.3,
        "decision_hz": 1,
    }
    aviary = bulletuav.Aviary("mec", 8, **options, **HOVER)
    aviary.reset(seeds=0)
    meter, act, told = Meter(aviary), dive(*dives), []
    while aviary.alive.any():
        flown = aviary.alive.copy()
        step = aviary.step(np.repeat(act(aviary), 8, axis=0))
        meter.record(step, flown)
        told.append(step.info["completed"][:, 0].copy())
    rows = [meter.row(w) for w in range(8)]
    assert [row["completed"] for row in rows] == told[-1].tolist()
    assert [row["latency"] for row in rows] == step.info["latency"][:, 0].tolist()
    assert (told[-1] < np.max(told, axis=0)).any()
    assert 0 < np.mean(told[-1]) < (0.2 if dives else 0.8)
    for _ in range(3):  # as when other worlds fly on
        meter.record(aviary.step(np.zeros((8, 2, 3))), aviary.alive)
    for name in SERVICE:
        assert [meter.row(w)[name] for w in range(8)] == [row[name] for row in rows]
    aviary.close()


USERS = ("city_alpha", "city_beta", "city_gamma", "dwell_time", "mean_service")
EDGE = (*USERS, "dropped", "utilisation", "queue")
RELAY = (*USERS, "contribution")
OWN = {"los": RELAY, "mobile_users": RELAY, "mec": EDGE, "mec_advanced": EDGE}


@pytest.mark.parametrize(
    ("task", "missing"),
    [
        ("crossing", SERVICE),
        ("los", (*GOALS, "completed", "latency")),
        ("mobile_users", (*GOALS, "completed", "latency")),
        ("mec", GOALS),
        ("mec_advanced", GOALS),
    ],
)
def test_episodes_have_the_metrics_of_their_task_alone(task, missing):
    options = {"dynamics": "single_integrator", "horizon": 3}
    (row,) = metered(task, dive(), **({} if task == "crossing" else HOVER) | options)
    assert set(row) == {*METRICS, *OWN.get(task, ())}
    for name in (*GOALS, *SERVICE):
        assert np.isnan(row[name]) == (
            name in missing or (task, name) == ("crossing", "path_efficiency")
        ), name
