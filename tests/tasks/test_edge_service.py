"""Who serves whom in edge computing, and what becomes of tasks, by hand."""

import dataclasses
import math

import numpy as np
import pytest
from edge_users import (
    BAND,
    COMPUTED,
    CORE,
    DEAF,
    DOWN,
    EAST,
    EDGE,
    EQUAL,
    NOISE,
    STAY,
    friis,
    hover_power,
    hovered,
    shannon,
)
from placing import OPEN, SMALL, WALL, fly


def busy(aviary, decisions=12):
    """Which drones have completed tasks."""
    done = np.zeros(aviary.num_drones)
    for _ in range(decisions):
        fly(aviary, STAY)
        done += aviary.scene.memory["completed"].sum(axis=0)
    return np.flatnonzero(done).tolist()


@pytest.mark.parametrize(
    ("assignment", "who"), [("nearest", [0]), ("max_rate", [1]), ("dtlcm", [1])]
)
def test_a_near_drone_behind_a_wall(put, assignment, who):
    """49 m to the first one, through the wall, 64 m to the second; over ground 40 m and 30 m."""
    # So many cores that load does not count.
    options = {"assignment": assignment, "arrival_rate": 2.0, "num_cores": 40}
    assert busy(put("mec", WALL, [(0, 0, 30), (70, 0, 58)], [(40, 0, 1.5)], **options)) == who


@pytest.mark.parametrize(
    ("assignment", "who"), [("nearest", [1]), ("max_rate", [1]), ("dtlcm", [0])]
)
def test_a_drone_high_above(put, assignment, who):
    """108.5 m up, and 60.6 m aside."""
    options = {"assignment": assignment, "arrival_rate": 2.0, "num_cores": 40, "ceiling": 120.0}
    assert busy(put("mec", OPEN, [(0, 0, 110), (60, 0, 10)], [(0, 0, 1.5)], **options)) == who


@pytest.mark.parametrize(
    ("assignment", "who"), [("nearest", [0]), ("max_rate", [0]), ("dtlcm", [0, 1])]
)
def test_a_loaded_drone_is_relieved_by_an_idle_one(put, assignment, who):
    options = {"assignment": assignment, "arrival_rate": 2.0}
    assert busy(put("mec", OPEN, [(-30, 0, 50), (30, 0, 50)], [(0, 0, 1.5)], **options)) == who


@pytest.mark.parametrize("queue", ["simulated", "erlang"])
@pytest.mark.parametrize(("assignment", "latency"), [("max_rate", 0.0), ("nearest", 1.0)])
def test_users_whom_nobody_hears_lose_their_tasks(put, assignment, latency, queue):
    """With `nearest` they are the drone's, which hears nothing: its latency is the deadline."""
    options = {"assignment": assignment, "queue": queue, "arrival_rate": 3.0, **DEAF}
    aviary = put("mec", WALL, [(0, 0, 50)], [(40, 0, 1.5)], **options)
    for _ in range(5):
        step = fly(aviary, STAY)
        assert aviary.scene.memory["latency"] == latency
        assert np.isfinite(step.observations).all()
    assert aviary.scene.memory["generated"] > 5
    assert (step.info["completed"], step.info["latency"], step.info["served"]) == (0, 1.0, 0)
    if queue == "simulated":  # the mean of the other takes all for heard that are a drone's
        assert step.info["power"] == pytest.approx(hover_power())


def test_lost_tasks_count_the_deadline(put):
    """One user is heard, 49 m away, another is not.

    The mean is that of the tasks of the one and the deadlines of the other.
    """
    options = {
        "arrival_rate": 0.1,
        "horizon": 200,
        "num_cores": 20,
        "deadline": 1.5,
        **EQUAL,
        **DEAF,
    }
    aviary = put("mec", WALL, [(0, 0, 50)], [(0, 0, 1.5), (40, 0, 1.5)], 5, **options)
    info, memory = hovered(aviary).info, aviary.scene.memory
    done = 1e6 / shannon(friis(48.5) / NOISE) + COMPUTED
    lost = memory["generated"] - memory["finished"]
    assert (lost > 5).all()
    assert (memory["finished"] > 5).all()
    expected = (memory["finished"] * done + lost * 1.5) / memory["generated"]
    # Equal but for a task that waits for another's upload.
    np.testing.assert_allclose(info["latency"][:, 0], expected, rtol=1e-3)


def test_who_is_dead_serves_nobody_and_others_take_over(put):
    """Two fast servers, one above each user.

    The first dives, and the other has all tasks, until that dives too.
    """
    options = {
        "arrival_rate": 6.0,
        "core_frequency": 50e9,
        "capacitance": 0.0,
        "horizon": 30,
        **EQUAL,
    }
    aviary = put("mec", OPEN, [(-30, 0, 20), (30, 0, 20)], [(-30, 5, 1.5), (30, 5, 1.5)], **options)
    memory = aviary.scene.memory
    while aviary.alive.all():
        fly(aviary, DOWN, STAY)
        assert (memory["completed"][0] > 0).all()
    for _ in range(5):
        before = memory["generated"].copy()
        step = fly(aviary, STAY)
        assert memory["completed"][0].tolist() == [0, *(memory["generated"] - before)]
        assert step.info["reward/tasks"][0, 0] == step.info["reward/latency"][0, 0] == 0
    assert memory["finished"] == memory["generated"]
    while aviary.alive.any():
        step = fly(aviary, DOWN)
    generated, seconds = memory["generated"].copy(), aviary.steps
    # Tasks to come count as not completed.
    expected = memory["finished"] / (generated + 2 * 6.0 * (30 - seconds))
    assert step.info["completed"][0] == pytest.approx(np.tile(expected, 2))
    step = fly(aviary, STAY)
    assert memory["generated"] == generated
    assert step.info["completed"][0] == pytest.approx(np.tile(expected, 2))
    assert not step.info["success"].any()


def test_more_drones_complete_more(put):
    """Of one core each, with four users who ask for 10 s of work a second."""
    users = [(x, y, 1.5) for x in (-50, 50) for y in (-50, 50)]
    places = [[(0, 0, 40)], [(-50, 0, 40), (50, 0, 40)], [(x, y, 40) for x, y, _ in users]]
    options = {"num_cores": 1, "arrival_rate": 2.0, "horizon": 30}
    shares = [
        hovered(put("mec", OPEN, drones, users, 5, **options)).info["completed"].mean()
        for drones in places
    ]
    assert shares[0] + 0.1 < shares[1]
    assert shares[1] + 0.05 < shares[2] <= 1
    unlimited = [
        hovered(put("mec", OPEN, drones, users, 5, horizon=30)).info["completed"].min()
        for drones in places
    ]
    assert unlimited == [1.0] * 3


@pytest.mark.parametrize("queue", ["simulated", "erlang"])
def test_shares_are_of_the_episode_as_planned(make, queue):
    """After t of 20 s the 30 users are to have 15 tasks in each second that is left."""
    options = {
        "num_users": 30,
        "arrival_rate": 0.5,
        "horizon": 20,
        "num_cores": 2,
        "wanted": 0.2,
        "queue": queue,
    }
    aviary, rng = make("mec", 6, city=OPEN, **options), np.random.default_rng(0)
    memory, finished, count = aviary.scene.memory, np.zeros(6), np.zeros(6)
    for t in range(1, 21):
        step = aviary.step(rng.uniform(-1, 1, (6, 3, 3)) * (1, 1, 0.1))
        assert aviary.alive.all() == (t < 20)
        finished += memory["completed"].sum(axis=1)
        assert (memory["generated"] > count).all()
        count = memory["generated"].copy()
        assert ((finished <= count) & (finished == memory["finished"])).all()
        expected = finished / (count + 15 * (20 - t))
        np.testing.assert_allclose(
            step.info["completed"], np.tile(expected[:, None], 3), rtol=1e-12
        )
        np.testing.assert_array_equal(step.info["success"], step.info["completed"] >= 0.2)
        assert ((step.info["latency"] > 0) & (step.info["latency"] <= 1)).all()
        assert ((memory["completed_share"] >= 0) & (memory["completed_share"] <= 1)).all()
        assert ((memory["utilisation"] >= 0) & (memory["utilisation"] <= 1 + 1e-12)).all()
    assert step.info["completed"][:, 0] == pytest.approx(finished / count)
    assert count.sum() == pytest.approx(6 * 300, abs=5 * math.sqrt(1800))  # Poisson
    assert 0.05 < step.info["completed"].min() < step.info["completed"].max() < 0.95


def test_after_a_reset_nothing_was_done(make):
    aviary = make("mec", 2, arrival_rate=1.0, num_users=10)
    for _ in range(3):
        fly(aviary, STAY)
    assert aviary.first_info()["completed"].all()
    aviary.reset(np.array([True, False]))
    info = aviary.first_info()
    for name in ("completed", "latency", "power"):
        assert not info[name][0].any()
        assert info[name][1].all()
    power = fly(aviary, STAY).info["power"]
    np.testing.assert_allclose(power[0], hover_power())  # cores have done nothing yet
    assert (power[1] > hover_power()).any()


def test_a_reset_of_one_world_leaves_the_statistics_of_others(make):
    rows = []
    for mask in (None, np.array([True, False])):
        aviary = make(
            "mec", 2, arrival_rate=2.0, fading="rayleigh", mobility="hotspot", num_cores=1
        )
        own = []
        for k in range(6):
            if k == 3 and mask is not None:
                aviary.reset(mask)
            step = fly(aviary, STAY)
            own += [
                step.observations[1].tobytes(),
                step.rewards[1].tobytes(),
                step.info["completed"][1].tobytes(),
            ]
        rows.append(own)
    assert rows[0] == rows[1]


@pytest.mark.parametrize("task", EDGE)
def test_worlds_are_the_same_among_however_many_and_after_other_episodes(make, task):
    options = {"fading": "rician", "mobility": "gauss_markov", "arrival_rate": 2.0}
    many, one = make(task, 4, **options), make(task, 1, **options)
    for seeds in ([5, 6, 7, 8], [1, 2, 11, 12], [9, 9, 7, 9]):
        many.reset(seeds=seeds)
        one.reset(seeds=[seeds[2]])
        rng = np.random.default_rng(0)
        for _ in range(5):
            actions = rng.uniform(-1, 1, (4, 3, 3))
            mine, own = many.step(actions), one.step(actions[2:3])
            np.testing.assert_array_equal(mine.observations[2], own.observations[0])
            np.testing.assert_array_equal(mine.rewards[2], own.rewards[0])
            assert not (mine.rewards[1] == mine.rewards[2]).all()


def test_an_overloaded_server_works_without_a_break(put):
    """Of 40 tasks a second a core can do five; those it takes on it has done a second later."""
    options = {"arrival_rate": 40.0, "num_cores": 2, "horizon": 30, **EQUAL}
    aviary = put("mec", OPEN, [(0, 0, 50)], [(0, 0, 1.5)], observation=("server",), **options)
    for t in range(30):
        step = fly(aviary, STAY)
        utilisation, queue, latency, share = step.observations[0, 0]
        if t > 0:
            assert utilisation == pytest.approx(1)
            assert step.info["power"] == pytest.approx(
                hover_power() + 2 * CORE, rel=0.05 if t == 1 else 1e-12
            )
        assert 0 < queue <= 10  # two cores do as many in the second of the deadline
        assert 0.5 < latency <= 1
        assert 0.1 < share < 0.7
    assert 300 - 1 <= aviary.scene.memory["finished"] <= 300 + 10


def test_a_user_sends_one_task_after_the_other(put):
    """In 150 kHz a task takes 0.43 s to send; of four a second the link carries only some."""
    options = {"arrival_rate": 4.0, "bandwidth": 150e3, "num_cores": 20, "horizon": 40, **EQUAL}
    aviary = put("mec", OPEN, [(0, 0, 50)], [(0, 0, 1.5)], 3, **options)
    hovered(aviary)
    most = 40 * shannon(friis(48.5) / (NOISE * 150e3 / BAND), 150e3) / 1e6
    assert 80 < most < 100
    finished = aviary.scene.memory["finished"]
    assert ((finished > 5) & (finished <= most + 1)).all()
    assert (aviary.scene.memory["generated"] > 1.3 * most).all()


def test_the_queue_is_the_work_that_is_left(put):
    """Tasks take 20 s of a core each: what is left of the first that came alone, in tasks."""
    options = {
        "arrival_rate": 0.05,
        "cycles_per_bit": 1e5,
        "deadline": 60.0,
        "num_cores": 2,
        **EQUAL,
    }
    aviary = put("mec", OPEN, [(0, 0, 50)], [(0, 0, 1.5)], 9, observation=("server",), **options)
    generated, upload, found = (
        aviary.scene.memory["generated"],
        1e6 / shannon(friis(48.5) / NOISE),
        0,
    )
    left = np.zeros(9)
    for _ in range(30):
        before = generated.copy()
        server = fly(aviary, STAY).observations[:, 0].astype(float)
        for utilisation, queue, latency, share in server[(before == 0) & (generated == 1)]:
            worked = 20 * (1 - queue)  # s, since it arrived in that decision
            assert 0 <= worked <= 1 - upload
            assert utilisation == pytest.approx(worked / 2, abs=2e-6)  # of two cores one
            assert (latency, share) == pytest.approx((20 + upload, 1), rel=1e-6)
            found += 1
        later = (before == 1) & (generated == 1)
        np.testing.assert_allclose(server[later, 1], np.maximum(left[later] - 0.05, 0), atol=1e-6)
        np.testing.assert_allclose(server[later, 0], 10 * (left - server[:, 1])[later], atol=1e-5)
        assert not server[later, 2:].any()
        left = server[:, 1]
    assert found > 3


def test_cores_are_paid_for_by_the_battery_a_decision_later(put):
    """Drones take hover's power and 12.5 W of a busy core: kappa f^2 for each cycle."""
    options = {"arrival_rate": 2.0, "horizon": 100, "battery_capacity": 2.0, **EQUAL}
    aviary = put("mec", OPEN, [(0, 0, 50)], [(0, 0, 1.5)], **options)
    memory, before, energy, finished = aviary.scene.memory, np.zeros(1), 0.0, 0
    assert pytest.approx(50) == 4 * CORE
    for _ in range(60):
        step = fly(aviary, STAY)
        assert step.info["power"][0] == pytest.approx(hover_power() + before * 4 * CORE)
        before, energy = memory["utilisation"][0].copy(), energy + float(step.info["power"][0, 0])
        assert step.info["charge"][0, 0] == pytest.approx(1 - energy / 7200)
    while memory["utilisation"].any():
        finished = memory["finished"][0]
        energy += float(fly(aviary, STAY).info["power"][0, 0])
    computed = energy - hover_power() * aviary.steps[0]
    assert finished > 80
    assert computed == pytest.approx(finished * 1e9 * 1e-28 * 5e9**2)


def test_rewards_of_a_task_that_came_alone(put):
    """Of 0.3 tasks that are expected, latency over the deadline, power over 50 W, and sight."""
    options = {"arrival_rate": 0.3, "deadline": 2.0, "power_scale": 50.0, **EQUAL}
    options["weights"] = {"dwell_time": 0.3, "service_time": 0.0}
    aviary = put("mec", OPEN, [(0, 0, 50)], [(0, 0, 1.5)], **options)
    latency, memory, seen = (
        1e6 / shannon(friis(48.5) / NOISE) + COMPUTED,
        aviary.scene.memory,
        set(),
    )
    for t in range(1, 40):
        before, idle = memory["generated"][0], not memory["core_free"].any()
        step = fly(aviary, STAY)
        count = int(memory["generated"][0] - before)
        power = step.info["power"][0, 0]
        if count == 0 or (count == 1 and idle):
            terms = (
                count / 0.3,
                -0.5 * count * latency / 2 / 0.3,
                -0.1 * power / 50,
                0.3 * math.tanh(0.1 * t),
            )
            names = ("tasks", "latency", "energy", "dwell_time")
            np.testing.assert_allclose(
                [step.info[f"reward/{name}"][0, 0] for name in names], terms, rtol=1e-9, atol=1e-15
            )
            assert step.rewards[0, 0] == pytest.approx(sum(terms))
            seen.add((count, bool(power > hover_power() + 1e-9)))
    assert seen == {(0, False), (0, True), (1, False), (1, True)}


ANCHOR = [
    ("mec", 50, 20, 0.253838029, 100 * 20 / 49, 0.3708998),
    ("mec_advanced", 10, 6, 0.15, 77.0, 0.3060586),
]
"""Task, users, completed tasks, mean latency, power and reward of UrbanMARL.

20 / 50 - 0.5 * 0.2538 - 0.1 * 20 / 49 + 0.3 tanh 0.5, and
2 * 6 / 10 - 1.5 * 0.15 / 0.2 + 0.5 tanh 0.5. There every user has a task a step, and the latency is
that of the server: so much for each that is expected.
"""


@pytest.mark.parametrize(
    ("task", "users", "completed", "latency", "power", "reward"), ANCHOR, ids=EDGE
)
def test_rewards_add_up_to_those_of_the_anchor(put, task, users, completed, latency, power, reward):
    aviary = put(
        task,
        OPEN,
        [(0, 0, 50)],
        [(k, 0, 1.5) for k in range(users)],
        arrival_rate=1.0,
        power_scale=100.0,
    )
    for _ in range(5):
        fly(aviary, STAY)
    aviary.scene.memory["completed"][:], aviary.scene.memory["delay_completed"][:] = (
        completed,
        users * latency,
    )
    frame = aviary.worlds.frame
    frame = dataclasses.replace(frame, readings={**frame.readings, "power": np.full((1, 1), power)})
    terms, weights = aviary.task.evaluate_step(frame).terms, aviary.task.weights
    assert sum(weights[name] * terms[name][0, 0] for name in terms) == pytest.approx(
        reward, abs=5e-8
    )


@pytest.mark.parametrize("task", EDGE)
def test_evaluating_twice_changes_nothing(make, task):
    aviary = make(task, 2, arrival_rate=2.0, city="urban", **SMALL)
    for _ in range(3):
        step = fly(aviary, EAST)
    memory = {name: array.copy() for name, array in aviary.scene.memory.items()}
    one, other = (aviary.task.evaluate_step(aviary.worlds.frame) for _ in range(2))
    for name, term in one.terms.items():
        np.testing.assert_array_equal(term, other.terms[name])
        np.testing.assert_array_equal(step.info[f"reward/{name}"], aviary.task.weights[name] * term)
    np.testing.assert_array_equal(one.success, other.success)
    for name, array in aviary.scene.memory.items():
        np.testing.assert_array_equal(array, memory[name])
    first, again = aviary.first_info(), aviary.first_info()
    for name in first:
        np.testing.assert_array_equal(first[name], again[name])


def test_shares_do_not_depend_on_how_long_a_decision_is(put):
    """60 s of hovering in 20 worlds, where slow links lose a part: standard errors are 0.005."""
    users = [(x, y, 1.5) for x in (-60, -20, 20, 60) for y in (-60, -20, 20, 60)]
    drones, shares, delays = [(-40, 0, 40), (40, 0, 40)], [], []
    for hz in (1, 2, 10):
        options = {"decision_hz": hz, "horizon": 60 * hz, "arrival_rate": 0.5}
        info = hovered(put("mec", OPEN, drones, users, 20, **options)).info
        shares.append(info["completed"][:, 0].mean())
        delays.append(info["latency"][:, 0].mean())
    assert 0.5 < min(shares) < max(shares) < 0.95
    assert np.ptp(shares) < 0.025
    assert np.ptp(delays) < 0.025
