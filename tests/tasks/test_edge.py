"""Edge computing against links, queues and statistics by hand."""

import dataclasses
import math

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from placing import OPEN, SMALL, WALL, fly
from scipy.spatial.transform import Rotation

import bulletuav
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.resolve import resolve
from bulletuav.policies import find_policy
from bulletuav.tasks import find_task
from bulletuav.vehicle.power import airframe_wing

EDGE = ("mec", "mec_advanced")
DEAF = {"n_nlos": 300.0}  # nothing is heard without a line of sight
EAST, DOWN, STAY = (1.0, 0, 0), (0, 0, -1.0), (0.0, 0, 0)
EQUAL = {"task_bits": (1e6, 1e6)}
COMPUTED = 1e6 * 1000 / 5e9  # s, for such a task on a core
BAND, POWER = 10e6, 0.5  # Hz, W: of `mec`
NOISE = 1.380649e-23 * 290 * BAND * 10**0.7  # W
CORE = 1e-28 * 5e9**3  # W


def hovered(aviary):
    """The last step of an episode in which all hover."""
    while aviary.alive.any():
        step = fly(aviary, STAY)
    return step


def friis(distance):
    """Power received in free space at 29 GHz, W."""
    return POWER * (299792458 / (4 * math.pi * distance * 29e9)) ** 2


def shannon(ratio, band=BAND):
    """Capacity, bit/s."""
    return band * math.log2(1 + ratio)


def alone(aviary, decisions):
    """Latencies (K,), s, of tasks that were the only one of a decision, with all drones idle."""
    memory, found = aviary.scene.memory, []
    for _ in range(decisions):
        before = memory["generated"].copy()
        idle = ~memory["core_free"].any(axis=(1, 2)) & ~memory["link_free"].any(axis=1)
        fly(aviary, STAY)
        found.append(memory["latency"][idle & (memory["generated"] == before + 1)].sum(axis=1))
    return np.concatenate(found)


def hover_power():
    """Of a hummingbird, W."""
    wing = airframe_wing(bulletuav.load_airframe("hummingbird"))
    return wing.blade + wing.induced


# Links


def test_link_rates_are_those_of_shannon(put):
    """Right below, 48.5 m; aside, 111.1 m; and behind the wall, 62.9 m.

    There power falls with the exponent 3.19.
    """
    users = [(0, 0, 1.5), (-60, -80, 1.5), (40, 0, 1.5)]
    aviary = put("mec", WALL, [(0, 0, 50)], users, observation=("link_rates",))
    assert not aviary.reset(seeds=0).any()
    expected = [shannon(friis(48.5) / NOISE), shannon(friis(math.hypot(100, 48.5)) / NOISE)]
    expected.append(shannon(friis(1) * math.hypot(40, 48.5) ** -3.19 / NOISE))
    assert expected[0] == pytest.approx(94.87e6, rel=1e-3)
    np.testing.assert_allclose(fly(aviary, STAY).observations[0, 0] * 1e6, expected, rtol=1e-6)


FLY, GHZ, SEEN, HID = (
    math.log10(50),
    math.log10(5),
    math.log10(48.5),
    math.log10(math.hypot(40, 48.5)),
)
LOSSES = {
    "umi": (32.4 + 21 * SEEN + 20 * GHZ, 22.4 + 35.3 * HID + 21.3 * GHZ),
    "uma": (28 + 22 * SEEN + 20 * GHZ, 13.54 + 39.08 * HID + 20 * GHZ),
    "umi_av": (
        30.9 + (22.25 - 0.5 * FLY) * SEEN + 20 * GHZ,
        32.4 + (43.2 - 7.6 * FLY) * HID + 20 * GHZ,
    ),
    "uma_av": (
        28 + 22 * SEEN + 20 * GHZ,
        -17.5 + (46 - 7 * FLY) * HID + 20 * math.log10(40 * math.pi * 5 / 3),
    ),
}
"""dB, of TR 38.901 and TR 36.777, at 5 GHz to a user 48.5 m right below and one behind the wall"""


@pytest.mark.parametrize("name", LOSSES)
def test_path_losses_of_the_standards(put, name):
    options = {"observation": ("link_rates",), "path_loss": name, "frequency": 5.0}
    aviary = put("mec", WALL, [(0, 0, 50)], [(0, 0, 1.5), (40, 0, 1.5)], **options)
    expected = [shannon(POWER * 10 ** (-loss / 10) / NOISE) for loss in LOSSES[name]]
    np.testing.assert_allclose(fly(aviary, STAY).observations[0, 0] * 1e6, expected, rtol=1e-5)


@pytest.mark.parametrize("name", ["umi_av", "uma_av"])
def test_path_losses_for_other_bands_are_refused(make, name):
    with pytest.raises(ValueError, match="frequency is 29.0: TR 36.777 .* is for 0.5 to 6 GHz"):
        make("mec", path_loss=name)


@pytest.mark.parametrize(
    ("fading", "variance"), [("none", 0.0), ("rician", 21 / 121), ("rayleigh", 1.0)]
)
def test_fading_spreads_the_power_and_keeps_its_mean(put, fading, variance):
    """With the factor K = 10 a Rician channel's power has the variance (2 K + 1) / (K + 1)^2."""
    users = [(48 * math.cos(k), 48 * math.sin(k), 1.5) for k in range(20)]
    aviary = put("mec", OPEN, [(0, 0, 50)], users, observation=("link_rates",), fading=fading)
    rates = np.array([fly(aviary, STAY).observations[0, 0] for _ in range(90)])
    gain = (2 ** (rates * 1e6 / BAND) - 1) / (friis(math.hypot(48, 48.5)) / NOISE)
    assert gain.mean() == pytest.approx(1, abs=5 * math.sqrt(variance / gain.size) + 1e-5)
    assert gain.var() == pytest.approx(variance, rel=0.3, abs=1e-6)
    assert (np.unique(rates, axis=0).shape[0] == 1) == (fading == "none")


def test_a_task_takes_its_upload_and_its_cycles_where_nothing_waits(put):
    aviary = put("mec", OPEN, [(0, 0, 50)], [(0, 0, 1.5)], 20, arrival_rate=0.3, **EQUAL)
    latency = alone(aviary, 20)
    assert len(latency) > 50
    np.testing.assert_allclose(latency, 1e6 / shannon(friis(48.5) / NOISE) + COMPUTED, rtol=1e-12)


def test_sizes_of_tasks_are_between_their_ends(put):
    aviary = put(
        "mec", OPEN, [(0, 0, 50)], [(0, 0, 1.5)], 20, arrival_rate=0.3, task_bits=(1e6, 2e6)
    )
    bits = alone(aviary, 30) / (1 / shannon(friis(48.5) / NOISE) + 1000 / 5e9)
    assert 1e6 <= bits.min() < 1.1e6
    assert 1.9e6 < bits.max() <= 2e6
    assert bits.mean() == pytest.approx(1.5e6, rel=5 * 0.1925 / math.sqrt(len(bits)))


OWN, CROSS = friis(math.hypot(20, 48.5)), friis(math.hypot(100, 20, 48.5))
SHARE = 0.15 * 2.0
"""Of the time in which a user may send: its rate of tasks, each given up after the deadline"""
RATES = {
    "ofdma": shannon(2 * OWN / (NOISE + SHARE * 2 * CROSS), BAND / 2),
    "tdma": shannon(OWN / (NOISE + SHARE * CROSS)) / 2,
    "shared": shannon(OWN / (NOISE + SHARE * (OWN + 2 * CROSS))),
}
"""Of two drones 100 m apart, each with two users 20 m aside of it"""


@pytest.mark.parametrize("access", RATES)
def test_users_share_the_band_and_disturb_each_other(put, access):
    users = [(-50, -20, 1.5), (50, 20, 1.5), (-50, 20, 1.5), (50, -20, 1.5)]
    options = {"access": access, "arrival_rate": 0.15, "deadline": 2.0, **EQUAL}
    latency = alone(put("mec", OPEN, [(-50, 0, 50), (50, 0, 50)], users, 20, **options), 20)
    assert len(latency) > 50
    np.testing.assert_allclose(latency, 1e6 / RATES[access] + COMPUTED, rtol=1e-9)


# Who serves whom


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
    options = {"assignment": assignment, "arrival_rate": 2.0, "num_cores": 40}
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


# Statistics of the episode


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
    options = {"arrival_rate": 2.0, "horizon": 100, "battery_capacity": 1.0, **EQUAL}
    aviary = put("mec", OPEN, [(0, 0, 50)], [(0, 0, 1.5)], **options)
    memory, before, energy, finished = aviary.scene.memory, np.zeros(1), 0.0, 0
    assert pytest.approx(50) == 4 * CORE
    for _ in range(60):
        step = fly(aviary, STAY)
        assert step.info["power"][0] == pytest.approx(hover_power() + before * 4 * CORE)
        before, energy = memory["utilisation"][0].copy(), energy + float(step.info["power"][0, 0])
        assert step.info["charge"][0, 0] == pytest.approx(1 - energy / 3600)
    while memory["utilisation"].any():
        finished = memory["finished"][0]
        energy += float(fly(aviary, STAY).info["power"][0, 0])
    computed = energy - hover_power() * aviary.steps[0]
    assert finished > 80
    assert computed == pytest.approx(finished * 1e9 * 1e-28 * 5e9**2)


def test_rewards_of_a_task_that_came_alone(put):
    """Of 0.3 tasks that are expected, latency over the deadline, power over 50 W, and sight."""
    options = {"arrival_rate": 0.3, "deadline": 2.0, "power_scale": 50.0, **EQUAL}
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
    frame = aviary._frame
    frame = dataclasses.replace(frame, readings={**frame.readings, "power": np.full((1, 1), power)})
    terms, weights = aviary.task.evaluate_step(frame).terms, aviary.task.weights
    assert sum(weights[name] * terms[name][0, 0] for name in terms) == pytest.approx(
        reward, abs=5e-8
    )


@pytest.mark.parametrize("task", EDGE)
def test_evaluating_twice_changes_nothing(make, task):
    aviary = make(task, 2, arrival_rate=2.0)
    for _ in range(3):
        step = fly(aviary, EAST)
    memory = {name: array.copy() for name, array in aviary.scene.memory.items()}
    one, other = (aviary.task.evaluate_step(aviary._frame) for _ in range(2))
    for name, term in one.terms.items():
        np.testing.assert_array_equal(term, other.terms[name])
        np.testing.assert_array_equal(step.info[f"reward/{name}"], aviary.task.weights[name] * term)
    np.testing.assert_array_equal(one.success, other.success)
    for name, array in aviary.scene.memory.items():
        np.testing.assert_array_equal(array, memory[name])
    first, again = aviary.first_info(), aviary.first_info()
    for name in first:
        np.testing.assert_array_equal(first[name], again[name])


# The mean response instead of a simulation

STEADY = [
    (1, 2.0, 1 / 3),
    (1, 4.0, 1.0),
    (2, 4.0, 0.2 / (1 - 0.4**2)),
    (2, 8.0, 0.2 / (1 - 0.8**2)),
]
"""Cores of 5 tasks/s, tasks/s, and the mean response, s.

That is 1 / (mu - lambda) of one core, and 1 / (mu (1 - rho^2)) of two.
"""


@pytest.mark.parametrize(("cores", "rate", "response"), STEADY)
def test_every_task_takes_its_upload_and_the_mean_response(put, cores, rate, response):
    options = {
        "num_cores": cores,
        "arrival_rate": rate,
        "deadline": 5.0,
        "queue": "erlang",
        **EQUAL,
    }
    aviary = put("mec", OPEN, [(0, 0, 50)], [(0, 0, 1.5)], **options)
    for t in range(10):
        step = fly(aviary, STAY)
        work = cores * CORE * rate / (5 * cores) if t > 0 else 0.0
        assert step.info["power"] == pytest.approx(hover_power() + work)
    assert step.info["latency"] == pytest.approx(
        1e6 / shannon(friis(48.5) / NOISE) + response, rel=1e-12
    )
    assert aviary.scene.memory["utilisation"] == pytest.approx(rate / (5 * cores))
    assert aviary.scene.memory["finished"] == aviary.scene.memory["generated"]


@pytest.mark.parametrize(("cores", "rate", "response"), STEADY)
def test_the_mean_queue_is_of_those_who_wait_or_are_computed(put, cores, rate, response):
    """Rate times response (Little's law), as the task's memory has it."""
    options = {
        "num_cores": cores,
        "arrival_rate": rate,
        "deadline": 5.0,
        "queue": "erlang",
        **EQUAL,
    }
    aviary = put("mec", OPEN, [(0, 0, 50)], [(0, 0, 1.5)], observation=("server",), **options)
    assert fly(aviary, STAY).observations[0, 0, 1] == pytest.approx(rate * response, rel=1e-6)


@pytest.mark.parametrize("normalise", [False, True])
@pytest.mark.parametrize("rate", [5.0, 50.0])
def test_a_queue_without_end_completes_nothing(put, rate, normalise):
    """At 5 tasks/s one core is at its limit; the second drone serves nobody."""
    options = {
        "num_cores": 1,
        "arrival_rate": rate,
        "queue": "erlang",
        "normalise": normalise,
        **EQUAL,
    }
    aviary = put("mec", OPEN, [(0, 0, 50), (-90, -90, 100)], [(0, 0, 1.5)], **options)
    low = -1 if normalise else 0
    for t in range(4):
        step = fly(aviary, STAY)
        assert np.isfinite(step.observations).all()
        assert np.isfinite(step.rewards).all()
        np.testing.assert_array_equal(
            step.observations[0, :, -4:], [(1, 1 if normalise else 100, 1, low), (low,) * 4]
        )
        assert step.info["reward/tasks"].tolist() == [[0, 0]]
        assert step.info["reward/latency"].tolist() == [[0, 0]]
        np.testing.assert_allclose(
            step.info["power"][0], (hover_power() + (t > 0) * CORE, hover_power())
        )
    assert (step.info["completed"] == 0).all()
    assert (step.info["latency"] == 1).all()


def test_the_load_of_the_mean_response_is_that_of_the_drones_own_users(put):
    """Two users here, one there, of 2 tasks/s each."""
    users = [(-50, 1, 1.5), (-50, -1, 1.5), (50, 0, 1.5)]
    options = {"num_cores": 1, "arrival_rate": 2.0, "deadline": 5.0, "queue": "erlang", **EQUAL}
    aviary = put("mec", OPEN, [(-50, 0, 50), (50, 0, 50)], users, **options)
    fly(aviary, STAY)
    np.testing.assert_allclose(aviary.scene.memory["utilisation"][0], (0.8, 0.4))
    assert (aviary.scene.memory["latency"][0] > (1, 1 / 3)).all()
    # The tolerance is for the upload.
    np.testing.assert_allclose(aviary.scene.memory["latency"][0], (1, 1 / 3), atol=0.15)


# A decision's length


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


# Antennas


def gained(rates, distances):
    """Antenna gains, dBi, that explain rates (U,) Mbit/s in 10 MHz in free space."""
    received = (2 ** (rates * 1e6 / BAND) - 1) * NOISE
    return 10 * np.log10(received / [friis(distance) for distance in distances])


BELOW = np.array([(0, 0, 1.5), (-48.5, 0, 1.5), (0, 48.5, 1.5), (48.5, 0, 1.5), (90, 0, 1.5)])


def test_antennas_look_down_by_hand(put):
    """8 dBi below; 12 (45 / 65)^2 dB less at 45 degrees, and 12 (61.7 / 65)^2 at 61.7."""
    aviary = put(
        "mec_advanced", OPEN, [(0, 0, 50)], BELOW, observation=("link_rates",), bandwidth=BAND
    )
    gain = gained(
        fly(aviary, STAY).observations[0, 0].astype(float),
        np.linalg.norm(BELOW - (0, 0, 50), axis=1),
    )
    aside = 8 - 12 * (45 / 65) ** 2
    far = 8 - 12 * (math.degrees(math.atan2(90, 48.5)) / 65) ** 2
    np.testing.assert_allclose(gain, (8, aside, aside, aside, far), atol=1e-4)
    isotropic = put("mec", OPEN, [(0, 0, 50)], BELOW, observation=("link_rates",))
    even = gained(
        fly(isotropic, STAY).observations[0, 0].astype(float),
        np.linalg.norm(BELOW - (0, 0, 50), axis=1),
    )
    np.testing.assert_allclose(even, 0, atol=1e-4)


NEAR = np.array([(0, 0, 1.5), (-20, 0, 1.5), (20, 0, 1.5)])


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body"])
def test_antennas_tilt_with_the_drone(put, dynamics):
    """Who speeds up to the east looks to the west.

    The gain is that of the angle between the body's -z and the way to a user in its plane.
    """
    options = {
        "observation": ("link_rates",),
        "bandwidth": BAND,
        "dynamics": dynamics,
        "decision_hz": 10,
    }
    aviary = put("mec_advanced", OPEN, [(0, 0, 50)], NEAR, **options)
    for _ in range(4):
        observation = fly(aviary, EAST).observations[0, 0].astype(float)
    way = NEAR - aviary.swarm.position[0, 0]
    down = Rotation.from_quat(aviary.swarm.quaternion[0, 0]).apply((0, 0, -1))
    distance = np.linalg.norm(way, axis=1)
    angle = np.degrees(np.arccos(way @ down / distance))
    tilt = math.degrees(math.asin(-down[0]))
    assert tilt > 5
    assert angle[1] < angle[0] < angle[2] < 85
    np.testing.assert_allclose(gained(observation, distance), 8 - 12 * (angle / 65) ** 2, atol=0.02)


def test_who_hovers_well_can_do_the_advanced_task(put):
    """By its defaults, in the open: three drones over ten users."""
    rng = np.random.default_rng(0)
    users = np.column_stack([rng.uniform(-100, 100, (10, 2)), np.full(10, 1.5)])
    for height in (30, 100):
        step = hovered(
            put(
                "mec_advanced", OPEN, [(-60, 0, height), (0, 60, height), (60, 0, height)], users, 3
            )
        )
        assert step.info["success"].all()
        assert step.info["completed"].min() > 0.85


# Options, sizes and faces


@pytest.mark.parametrize(("task", "users"), [("mec", 50), ("mec_advanced", 10)])
def test_the_preset_has_the_sizes_that_it_is_named_after(make, task, users):
    options, config = resolve(find_task(task), {"preset": "urbanmarl"})
    assert (options.num_drones, config.num_users, config.area) == (3, users, 500)
    assert (options.decision_hz, options.horizon, options.dynamics) == (1, 100, "single_integrator")
    assert (config.queue, config.assignment, config.n_nlos, config.contact_ends) == (
        "erlang",
        "dtlcm",
        3.5,
        "world",
    )
    aviary = make(task, preset="urbanmarl", **SMALL)
    for k in range(1, 101):
        step = fly(aviary, STAY)
        assert step.truncated.all() == step.truncated.any() == (k == 100)
    assert 0 < step.info["completed"].min() < 1


NAN = float("nan")
BAD = [
    (
        {"task_bits": (2e6, 1e6)},
        r"task_bits is \(2000000.0, 1000000.0\): from low to high, above 0",
    ),
    ({"task_bits": (0.0, 1e6)}, "task_bits is"),
    ({"task_bits": 1e6}, "task_bits is 1000000.0: a list or tuple of 2"),
    ({"task_bits": (NAN, 1e6)}, "task_bits is nan"),
    ({"deadline": 0.0}, "deadline is 0: it must be above 0"),
    ({"deadline": float("inf")}, "deadline is inf: a finite number"),
    ({"cycles_per_bit": 0.0}, "cycles_per_bit is 0: it must be above 0"),
    ({"core_frequency": 0.0}, "core_frequency is 0: it must be above 0"),
    ({"power_scale": 0.0}, "power_scale is 0: it must be above 0"),
    ({"capacitance": -1e-28}, "capacitance is -1e-28: it must not be negative"),
    ({"num_cores": 0}, "num_cores is 0: a whole number, at least 1"),
    ({"num_cores": 2.5}, "num_cores is 2.5: a whole number"),
    ({"arrival_rate": NAN}, "arrival_rate is nan: a finite number"),
    ({"arrival_rate": -0.1}, "arrival_rate is -0.1: it must not be negative"),
    ({"queue": "erlan"}, "unknown queue 'erlan': did you mean 'erlang'"),
    ({"access": "tmda"}, "unknown access 'tmda': did you mean 'tdma'"),
    ({"assignment": "nearst"}, "unknown assignment 'nearst': did you mean 'nearest'"),
    ({"assignment": None}, "unknown assignment None"),
    ({"path_loss": "umi_va"}, "unknown path_loss 'umi_va': did you mean 'umi_av'"),
    ({"antenna": "downwards"}, "unknown antenna 'downwards': did you mean 'downward'"),
    ({"fading": "rice"}, "unknown fading 'rice': did you mean 'rician'"),
    ({"rician_factor": -1.0}, "rician_factor is -1: it must not be negative"),
    ({"bandwidth": 0.0}, "bandwidth is 0: it must be above 0"),
    ({"frequency": 0.0}, "frequency is 0: it must be above 0"),
    ({"user_power": 0.0}, "user_power is 0: it must be above 0"),
    ({"wanted": 1.2}, "wanted is 1.2"),
    ({"arival_rate": 1.0}, "did you mean 'arrival_rate'"),
    ({"preset": "urbanmal"}, "unknown preset 'urbanmal': did you mean 'urbanmarl'"),
    ({"weights": {"task": 1.0}}, "unknown reward term 'task': did you mean 'tasks'"),
]


@pytest.mark.parametrize(("options", "message"), BAD, ids=[str(options) for options, _ in BAD])
def test_options_that_cannot_be(options, message):
    with pytest.raises(ValueError, match=message):
        EnvSpec("mec", 1, {"city": OPEN, **options})


def test_nobody_asks_for_anything(put):
    step = hovered(put("mec", OPEN, [(0, 0, 50)], [(0, 0, 1.5)], arrival_rate=0.0, horizon=3))
    assert step.info["completed"] == step.info["reward/tasks"] == step.info["reward/latency"] == 0
    assert not step.info["success"].any()


SHAPES = {
    "plain": {},
    "preset": {"preset": "urbanmarl"},
    "fading": {"fading": "rician", "access": "tdma", "path_loss": "umi", "mobility": "manhattan"},
    "shared": {
        "fading": "rayleigh",
        "access": "shared",
        "path_loss": "uma",
        "assignment": "nearest",
        "normalise": True,
    },
    "drones": {
        "path_loss": "umi_av",
        "frequency": 2.0,
        "antenna": "downward",
        "queue": "erlang",
        "difficulty": "medium",
        "num_drones": 2,
    },
    "high": {
        "path_loss": "uma_av",
        "frequency": 2.0,
        "assignment": "dtlcm",
        "boundary": "soft",
        "contact_ends": "world",
        "decision_hz": 2,
    },
    "tilted": {
        "dynamics": "rigid_body",
        "decision_hz": 10,
        "arrival_rate": 20.0,
        "boundary": "end",
    },
    "all": {
        "observation": ("power", "dwell_time", "server", "link_rates", "centroids", "sight_matrix"),
        "num_users": 12,
    },
}


@pytest.mark.parametrize("options", SHAPES.values(), ids=SHAPES)
@pytest.mark.parametrize("task", EDGE)
def test_numbers_are_finite_and_within_their_bounds_in_whole_random_episodes(task, options):
    env = bulletuav.batch_env(
        task, 3, autoreset_mode=AutoresetMode.SAME_STEP, **{"horizon": 8, **SMALL, **options}
    )
    observations, infos = env.reset(seed=0)
    rng, names = np.random.default_rng(0), set(infos)
    assert {"served", "completed", "latency", "power", "charge"} <= names
    for _ in range(20):
        for one in observations.reshape(-1, observations.shape[-1]):
            assert env.observation_space.contains(one)
        observations, rewards, _, _, infos = env.step(rng.uniform(-1, 1, (*env.alive.shape, 3)))
        own = {name for name in infos if "final" not in name}
        assert own == names
        for numbers in (observations, rewards, *(infos[name] for name in own - {"separation"})):
            assert np.isfinite(numbers).all()
        assert ((infos["completed"] >= 0) & (infos["completed"] <= 1)).all()
        assert (infos["latency"] <= env.aviary.task.config.deadline + 1e-12).all()
    env.close()


@pytest.mark.parametrize("task", EDGE)
def test_agents_of_pettingzoo_get_the_same_infos_at_reset_and_at_every_step(task):
    env = bulletuav.parallel_env(task, horizon=4, **SMALL)
    observations, infos = env.reset(seed=0)
    names = set(infos["drone_0"])
    assert {"served", "completed", "latency", "reward/tasks", "reward/energy"} <= names
    while env.agents:
        assert all(
            env.observation_space(agent).contains(observations[agent]) for agent in env.agents
        )
        flying = list(env.agents)
        observations, _, _, truncated, infos = env.step(
            dict.fromkeys(flying, np.zeros(3, np.float32))
        )
        assert all(set(infos[agent]) == names for agent in flying)
        assert len({(infos[agent]["completed"], infos[agent]["latency"]) for agent in flying}) == 1
    assert all(truncated.values())
    env.close()


@pytest.mark.parametrize("task", EDGE)
def test_the_number_of_processes_changes_no_bit(task):
    rows = []
    for workers in (1, 2):
        env = bulletuav.batch_env(
            task,
            3,
            workers=workers,
            seed=3,
            horizon=4,
            fading="rician",
            mobility="hotspot",
            **SMALL,
        )
        rng, own = np.random.default_rng(0), [env.reset()[0].tobytes()]
        for _ in range(9):
            observations, rewards, *_, infos = env.step(rng.uniform(-1, 1, (3, 3, 3)))
            own += [observations.tobytes(), rewards.tobytes()]
            own += [np.asarray(infos[name]).tobytes() for name in ("completed", "latency", "power")]
        rows.append(own)
        env.close()
    assert rows[0] == rows[1]


# What is worth doing


@pytest.mark.parametrize("preset", [None, "urbanmarl"])
@pytest.mark.parametrize("task", EDGE)
def test_to_serve_pays_more_than_to_hover_and_that_more_than_to_crash(task, preset):
    returns = {}
    for name in ("crash", "hover", "kmeans"):
        aviary = bulletuav.Aviary(task, 4, preset=preset)
        observations = aviary.reset(seeds=0)
        policy = find_policy("kmeans")(aviary)
        policy.reset(np.ones(4, dtype=bool))
        returns[name] = 0.0
        while aviary.alive.any():
            actions = {"crash": np.tile([0.0, 0, -1], (4, 3, 1)), "hover": np.zeros((4, 3, 3))}
            step = aviary.step(
                actions[name] if name in actions else policy.act(observations, aviary.swarm)
            )
            observations = step.observations
            returns[name] += step.rewards.mean()
        aviary.close()
    assert returns["crash"] + 5 < returns["hover"]
    assert returns["hover"] + 5 < returns["kmeans"]


@pytest.mark.parametrize("dynamics", ["single_integrator", "point_mass", "bullet"])
def test_drones_that_the_bounds_push_together_collide(dynamics):
    aviary = bulletuav.Aviary("mec", num_drones=3, area=200.0, num_layouts=1, dynamics=dynamics)
    aviary.reset(seeds=1)
    collided = 0
    for _ in range(30):
        collided += fly(aviary, (-1, -1, 1)).info["collision"].sum()
    assert collided == 2
    assert aviary.alive.sum() == 1
    aviary.close()


def test_an_overloaded_uplink_goes_on_to_carry_what_it_can(put):
    """Few tasks are begun in vain.

    The more are offered, the more are completed, up to what the link carries.
    """
    completed = []
    for rate in (1.0, 4.0, 20.0):
        options = {"arrival_rate": rate, "bandwidth": 0.3e6, "observation": ("link_rates",)}
        aviary = put("mec", OPEN, [(0, 0, 50)], [(0, 0, 1.5)], num_worlds=8, **options)
        step = hovered(aviary)
        carried = step.observations[0, 0, 0] / 0.5  # of the smallest tasks
        completed.append(aviary.scene.memory["finished"].mean() / 100)
        assert completed[-1] < carried
    assert completed[0] < completed[1] < completed[2]
