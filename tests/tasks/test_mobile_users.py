"""Task `mobile_users`: how long users are seen, what that is worth, and what is observed."""

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from placing import OPEN, SMALL, WALL, city_of, fly

import bulletuav
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.network.mobility import find_mobility
from bulletuav.tasks.observations.targets import _mean

OWN = {"served": 0.0, "service_time": 0.0, "sight": 1.0, "dwell_time": 0.5}
"""Weights by which drones are paid for what they see themselves"""


@pytest.fixture
def put(put):
    """Builds aviaries that pay drones for what they see themselves."""

    def one(task, *places, **options):
        own = OWN if task == "mobile_users" else {}
        return put(task, *places, **{**options, "weights": {**own, **options.get("weights", {})}})

    return one


EAST, WEST, NORTH, SOUTH = (1.0, 0, 0), (-1.0, 0, 0), (0, 1.0, 0), (0, -1.0, 0)
UP, DOWN, STAY = (0, 0, 1.0), (0, 0, -1.0), (0.0, 0, 0)


TOWER = city_of(((-10, -10, 0), (10, 10, 30)))
DRONES = [(-50, 0, 10), (-50, 40, 10), (40, 40, 10)]
USERS = [(40, 0, 1.5), (20, 0, 1.5), (-30, -20, 1.5), (40, -30, 1.5), (30, -40, 1.5)]
SEEN = np.array([(0, 0, 1, 1, 1), (1, 0, 1, 0, 0), (1, 1, 0, 1, 1)])
"""At TOWER.

From the second drone to user 0 the line passes x = 10 at y = 13.3, beside the tower; to user 1 at
5.7; to users 3 and 4 it passes x = -10 at 8.9 and 0. From the first those pass x = -10 at -13.3 and
-20. From the third to user 2 it passes x = 10 at y = 14.3 and y = 10 at x = 5.
"""


def told(aviary, observations, beginning):
    """(W, N, ...) the numbers of observations whose names begin so."""
    return observations[..., [label.name.startswith(beginning) for label in aviary.observer.labels]]


def test_seconds_of_sight_are_counted_and_lost_behind_a_wall(put):
    """A wall ends at y = 50.

    From (0, 55) to a user at (40, 70) the line passes x = 10 at y = 58.75, beside the wall; from
    (0, 40) at 47.5.
    """
    aviary = put(
        "mobile_users",
        WALL,
        [(0, 70, 10)],
        [(40, 70, 1.5), (0, 0, 1.5)],
        observation=("dwell_time",),
    )
    seconds = []
    for way in (STAY, STAY, SOUTH, SOUTH, STAY, NORTH, STAY):
        step = fly(aviary, way)
        seconds.append(aviary.scene.memory["dwell_time"][0, 0].tolist())
        assert step.observations[0, 0] == pytest.approx(np.mean(seconds[-1]))
        assert step.info["reward/dwell_time"][0, 0] == pytest.approx(
            0.5 * np.tanh(0.1 * np.mean(seconds[-1]))
        )
    assert seconds == [[1, 1], [2, 2], [3, 3], [0, 4], [0, 5], [1, 6], [2, 7]]


@pytest.mark.parametrize("hz", [1, 2, 5, 10])
def test_seconds_of_sight_are_seconds_whatever_a_decision_takes(put, hz):
    aviary = put("mobile_users", OPEN, [(0, 0, 30)], [(40, 0, 1.5)], decision_hz=hz, horizon=5 * hz)
    for _ in range(4 * hz):
        step = fly(aviary, STAY)
    assert aviary.scene.memory["dwell_time"] == pytest.approx(4.0)
    assert step.info["reward/dwell_time"] == pytest.approx(0.5 * np.tanh(0.4))


def test_sight_of_users_who_walk_out_of_it_starts_anew(make):
    """Dwell time follows sight, one decision after the other, of everybody."""
    aviary = make("mobile_users", 2, num_users=30, horizon=60)
    expected, lost = np.zeros((2, 3, 30)), 0
    while aviary.alive.all():
        fly(aviary, STAY)
        places = aviary.scene.memory["users"]
        for w, i in np.ndindex(2, 3):
            start = np.tile(aviary.swarm.position[w, i], (30, 1))
            seen = aviary.line_of_sight(start, places[w], w)
            lost += ((expected[w, i] > 0) & ~seen).sum()
            expected[w, i] = np.where(seen, expected[w, i] + 1, 0)
        np.testing.assert_array_equal(aviary.scene.memory["dwell_time"], expected)
    assert lost > 20


def test_who_is_dead_has_seen_nobody_and_a_reset_forgets(put):
    aviary = put(
        "mobile_users",
        OPEN,
        [(0, 0, 40), (50, 0, 40)],
        [(40, 0, 1.5)],
        2,
        observation=("dwell_time",),
    )
    for seconds in (1, 2):  # 15 m down in each; the third ends on the ground
        step = fly(aviary, DOWN, STAY)
        assert step.observations[..., 0].tolist() == [[seconds, seconds]] * 2
    fly(aviary, DOWN, STAY)
    assert aviary.alive.tolist() == [[False, True]] * 2
    step = fly(aviary, STAY)
    assert step.observations[..., 0].tolist() == [[0, 4]] * 2
    assert step.info["reward/dwell_time"][:, 0].tolist() == [0, 0]
    aviary.reset(np.array([False, True]))
    assert fly(aviary, STAY).observations[..., 0].tolist() == [[0, 5], [1, 1]]


def test_reward_of_seeing_three_in_five_for_ten_seconds(put):
    """At three decisions a second those who are seen have been so for 50 / 3 s after 50 of them.

    In the mean of all users that is 10 s.
    """
    aviary = put("mobile_users", TOWER, DRONES, USERS, decision_hz=3)
    for _ in range(50):
        step = fly(aviary, STAY)
    assert step.info["reward/sight"][0] == pytest.approx((0.6, 0.4, 0.8))
    assert step.rewards[0, 0] == pytest.approx(0.9807971, abs=5e-8)
    assert not step.terminated.any()


def test_reward_of_sight_that_lasts(put):
    expected = {1: 0.0996680, 5: 0.4621172, 10: 0.7615942, 20: 0.9640276}  # of the weight 1
    aviary = put(
        "mobile_users",
        OPEN,
        [(0, 0, 30)],
        [(9, 0, 1.5), (0, 9, 1.5)],
        weights={"dwell_time": 1.0, "sight": 0.0},
    )
    for seconds in range(1, 21):
        step = fly(aviary, STAY)
        assert step.rewards[0, 0] == step.info["reward/dwell_time"][0, 0]
        if seconds in expected:
            assert step.rewards[0, 0] == pytest.approx(expected[seconds], abs=5e-8)


def test_success_is_to_see_as_many_as_wanted_among_all_drones(put):
    short = {"horizon": 1, "min_contribution": 0.0}
    step = fly(put("mobile_users", TOWER, DRONES, USERS, wanted=1.0, **short), STAY)
    assert step.info["served"][0].tolist() == [1, 1, 1]
    assert step.info["success"][0].tolist() == [True] * 3
    for wanted in (0.8, 0.81):
        alone = fly(put("mobile_users", TOWER, DRONES[2:], USERS, wanted=wanted, **short), STAY)
        assert alone.info["served"][0].tolist() == [0.8]
        assert alone.info["success"][0].tolist() == [wanted == 0.8]


BOUNDS = {"hard": 0.0, "soft": 0.8}


@pytest.mark.parametrize(("boundary", "left"), BOUNDS.items())
def test_bounds_hold_drones_back_by_hand(put, boundary, left):
    """5 m off the edge at 12 m/s west and 9 m/s north: the way along the edge goes on."""
    options = {"boundary": boundary, "weights": {"out_of_bounds": -3.0}, "ceiling": 65.0}
    aviary = put("mobile_users", OPEN, [(-95, 0, 30), (0, 0, 60)], [(0, 0, 1.5)], **options)
    step = fly(aviary, (-0.8, 0.6, 0.0), UP)
    np.testing.assert_allclose(aviary.swarm.position[0], [(-100, 9, 30), (0, 0, 65)], atol=1e-9)
    np.testing.assert_allclose(
        aviary.swarm.velocity[0], [(left * 12, 9, 0), (0, 0, -left * 15)], atol=1e-9
    )
    assert step.info["reward/out_of_bounds"][0].tolist() == [-3, -3]
    assert not step.terminated.any()
    assert not step.info["collision"].any()
    step = fly(aviary, EAST, STAY)
    np.testing.assert_allclose(aviary.swarm.position[0], [(-85, 9, 30), (0, 0, 65)], atol=1e-9)
    assert step.info["reward/out_of_bounds"][0].tolist() == [0, -3]


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body", "point_mass"])
@pytest.mark.parametrize("boundary", BOUNDS)
def test_bounds_hold_back_whatever_flies(put, boundary, dynamics):
    options = {"boundary": boundary, "dynamics": dynamics, "decision_hz": 10, "horizon": 100}
    aviary = put("mobile_users", OPEN, [(-96, 0, 30)], [(0, 0, 1.5)], **options)
    turned = 0
    for _ in range(25):
        fly(aviary, WEST)
        x, speed = aviary.swarm.position[0, 0, 0], aviary.swarm.velocity[0, 0, 0]
        assert x >= -100
        turned += x == -100
        if x == -100:
            assert speed > 0 if boundary == "soft" else speed == 0
    assert turned >= (1 if boundary == "soft" else 10)
    for _ in range(20):
        fly(aviary, EAST)
    assert aviary.swarm.position[0, 0, 0] > -95
    assert aviary.alive.all()


def test_the_bounds_can_end_it_instead(put):
    options = {"boundary": "end", "weights": {"out_of_bounds": -3.0}}
    aviary = put("mobile_users", OPEN, [(-95, 0, 30), (0, 0, 40)], [(0, 0, 1.5)], **options)
    step = fly(aviary, WEST, STAY)
    assert aviary.swarm.position[0, 0, 0] == pytest.approx(-110)
    assert step.terminated[0].tolist() == [True, False]
    assert step.info["reward/out_of_bounds"][0].tolist() == [-3, 0]


def test_defaults_of_the_bounds():
    for task, boundary in (
        ("los", "end"),
        ("mobile_users", "hard"),
        ("mec", "hard"),
        ("mec_advanced", "hard"),
    ):
        assert (
            EnvSpec(task, 1, {"city": OPEN, "mobility": "still"}).task.config.boundary == boundary
        )


@pytest.mark.parametrize("dynamics", ["single_integrator", "rigid_body"])
@pytest.mark.parametrize(
    ("ends", "over"), [("drone", [True, False, False]), ("world", [True, True, True])]
)
def test_contact_ends_the_drones_episode_or_the_worlds(put, ends, over, dynamics):
    options = {"contact_ends": ends, "dynamics": dynamics}
    aviary = put(
        "mobile_users", OPEN, [(0, 0, 22), (50, 0, 40), (-50, 0, 40)], [(0, 9, 1.5)], 2, **options
    )
    still = np.zeros((2, 3, 3))
    dives = still.copy()
    dives[0, 0] = DOWN
    for _ in range(4):
        step = aviary.step(dives)
        if step.terminated.any():
            break
    assert step.terminated.tolist() == [over, [False] * 3]
    assert step.info["collision"].tolist() == [[True, False, False], [False] * 3]
    assert step.info["reward/collision"].tolist() == [[-2, 0, 0], [0, 0, 0]]
    assert not step.truncated.any()
    assert aviary.alive.tolist() == [[not one for one in over], [True] * 3]
    assert not aviary.step(still).terminated.any()


def test_an_empty_battery_ends_only_the_episode_of_its_drone(put):
    """Hovering takes more than flying at 7.5 m/s."""
    options = {"contact_ends": "world", "battery_capacity": 0.05, "decision_hz": 10}
    aviary = put("mobile_users", OPEN, [(0, 0, 30), (0, -90, 30)], [(0, 9, 1.5)], **options)
    while aviary.alive.all():
        step = fly(aviary, STAY, (0, 0.5, 0))
    assert step.terminated[0].tolist() == [True, False]
    assert step.info["charge"][0, 0] == 0 < step.info["charge"][0, 1]


def test_centroids_by_hand(put):
    """The first drone is high above users 0 and 1: over ground they are nearest to it.

    The third is near nobody.
    """
    users = [(10, 0, 1.5), (-10, 20, 1.5), (60, 0, 1.5), (70, 30, 1.5), (50, 60, 1.5)]
    drones = [(0, 0, 100), (55, 10, 10), (-90, -90, 30)]
    aviary = put("mobile_users", OPEN, drones, users, observation=("centroids",), ceiling=120.0)
    everybody, first, second = (36, 22), (0, 10), (60, 30)
    expected = [(*everybody, *first), (*everybody, *second), (*everybody, *everybody)]
    np.testing.assert_allclose(aviary.reset(seeds=0)[0], expected)
    np.testing.assert_allclose(fly(aviary, STAY).observations[0], expected)
    while aviary.alive.all():
        step = fly(aviary, STAY, DOWN, STAY)
    # All are the first one's now.
    np.testing.assert_allclose(step.observations[0, [0, 2]], [(*everybody, *everybody)] * 2)
    observations = fly(aviary, STAY, STAY, NORTH).observations  # 15 m at a time
    for _ in range(6):
        observations = fly(aviary, STAY, STAY, NORTH).observations
    np.testing.assert_allclose(aviary.swarm.position[0, 2, :2], (-90, 15))
    np.testing.assert_allclose(observations[0, 2], (*everybody, *everybody))
    names = [label.name for label in aviary.observer.labels]
    assert names == ["centroid x", "centroid y", "own centroid x", "own centroid y"]


def test_centroids_add_the_targets_in_order():
    """A product of matrices adds in an order that depends on the BLAS."""
    rng = np.random.default_rng(0)
    chosen, place = rng.random((2, 3, 50)) < 0.5, rng.normal(0.0, 100.0, (2, 50, 2))
    total = np.zeros((2, 3, 2))
    for j in range(50):
        total += chosen[:, :, j, None] * place[:, None, j]
    np.testing.assert_array_equal(_mean(place, chosen), total / chosen.sum(axis=-1)[..., None])


def test_own_centroids_follow_the_drones(put):
    aviary = put(
        "mobile_users",
        OPEN,
        [(-30, 0, 30), (30, 0, 30)],
        [(-20, 5, 1.5), (5, 10, 1.5), (40, 0, 1.5)],
    )
    # Then 15 m and 25 m from the second user.
    expected = {
        STAY: [(-20, 5), (22.5, 5)],
        EAST: [(-7.5, 7.5), (40, 0)],
    }
    for way, own in expected.items():
        observations = fly(aviary, way, STAY).observations
        np.testing.assert_allclose(told(aviary, observations, "own centroid")[0], own)
        np.testing.assert_allclose(
            told(aviary, observations, "centroid")[0], [(25 / 3, 5)] * 2, rtol=1e-6
        )


def test_the_matrix_of_sight_has_the_own_row_first_and_those_of_others_by_index(put):
    aviary = put("mobile_users", TOWER, DRONES, USERS)
    expected = [SEEN[[0, 1, 2]], SEEN[[1, 0, 2]], SEEN[[2, 0, 1]]]
    for observations in (aviary.reset(seeds=0), fly(aviary, STAY).observations):
        np.testing.assert_array_equal(observations[0, :, 8:].reshape(3, 3, 5), expected)
    names = [label.name for label in aviary.observer.labels[8:]]
    assert (names[0], names[5], names[10], names[14]) == (
        "own sees 1",
        "other 1 sees 1",
        "other 2 sees 1",
        "other 2 sees 5",
    )
    while aviary.alive.all():
        fly(aviary, STAY, DOWN, STAY)
    rows = fly(aviary, STAY).observations[0, :, 8:].reshape(3, 3, 5)
    blind = SEEN * np.array([[1], [0], [1]])
    np.testing.assert_array_equal(rows[[0, 2]], [blind[[0, 1, 2]], blind[[2, 0, 1]]])


@pytest.mark.parametrize("task", ["los", "mobile_users"])
def test_power_is_told(put, task):
    aviary = put(
        task, OPEN, [(0, 0, 30), (50, 0, 30)], [(0, 9, 1.5)], observation=("position", "power")
    )
    assert (told(aviary, aviary.reset(seeds=0), "power") == 0).all()
    step = fly(aviary, STAY, NORTH)
    np.testing.assert_allclose(
        told(aviary, step.observations, "power")[..., 0], step.info["power"], rtol=1e-6
    )
    assert step.info["power"][0, 0] != step.info["power"][0, 1]


def test_the_preset_has_the_sizes_that_it_is_named_after(make):
    aviary = make("mobile_users", preset="urbanmarl", area=500.0)
    options, task = aviary.options, aviary.task
    assert (options.num_drones, task.num_targets, options.decision_hz, options.horizon) == (
        3,
        50,
        1,
        100,
    )
    assert (options.dynamics, task.config.contact_ends, task.users.mobility) == (
        "single_integrator",
        "world",
        find_mobility("manhattan"),
    )
    np.testing.assert_array_equal(
        (task.arena_low, task.arena_high), [(-250, -250, 0), (250, 250, 200)]
    )
    for k in range(1, 101):
        step = fly(aviary, STAY)
        assert step.truncated.all() == step.truncated.any() == (k == 100)
    assert (
        EnvSpec(
            "mobile_users", 1, {"preset": "urbanmarl", "num_users": 7, **SMALL}
        ).task.num_targets
        == 7
    )


def test_sight_ahead_is_what_would_be_seen_from_there(put):
    """Also where that is beyond the edge, or would be in a building."""
    wall = ((-5.0, -20.0, 0.0), (5.0, 20.0, 40.0))
    users = [(-60.0, 0.0, 1.5), (60.0, 0.0, 1.5), (20.0, 60.0, 1.5)]
    place = [(-20.0, 0.0, 20.0), (90.0, 50.0, 20.0), (15.0, 0.0, 20.0)]
    aviary = put("mobile_users", city_of(wall), place, users, observation="sight_ahead")
    seen = fly(aviary, STAY).observations[0].reshape(3, 4, 3)
    low, high = aviary.task.arena_low, aviary.task.arena_high
    for i, at in enumerate(aviary.swarm.position[0]):
        for k, way in enumerate(((30, 0, 0), (0, 30, 0), (-30, 0, 0), (0, -30, 0))):
            there = np.clip(at + way, low, high)
            np.testing.assert_array_equal(
                seen[i, k], aviary.line_of_sight(there, aviary.scene.memory["users"][0])
            )
    assert (seen[0] != seen[0, :1]).any()


SHAPES = {
    "plain": {},
    "preset": {"preset": "urbanmarl"},
    "noisy": {"difficulty": "medium", "mobility": "hotspot", "normalise": True, "num_drones": 2},
    "all": {
        "observation": (
            "centroids",
            "sight_matrix",
            "dwell_time",
            "power",
            "targets",
            "seen_share",
            "sight_ahead",
            "neighbours",
        )
    },
    "ends": {"boundary": "end", "contact_ends": "world", "mobility": "gauss_markov"},
    "soft": {
        "boundary": "soft",
        "dynamics": "rigid_body",
        "decision_hz": 10,
        "mobility": "waypoint",
    },
}


@pytest.mark.parametrize("options", SHAPES.values(), ids=SHAPES)
def test_numbers_are_finite_and_within_their_bounds_in_whole_random_episodes(options):
    env = bulletuav.batch_env(
        "mobile_users",
        3,
        autoreset_mode=AutoresetMode.SAME_STEP,
        horizon=12,
        **{**SMALL, **options},
    )
    observations, infos = env.reset(seed=0)
    rng, names = np.random.default_rng(0), set(infos)
    for _ in range(30):
        for one in observations.reshape(-1, observations.shape[-1]):
            assert env.observation_space.contains(one)
        actions = rng.uniform(-1, 1, (*env.alive.shape, 3))
        observations, rewards, _, _, infos = env.step(actions)
        own = {name for name in infos if "final" not in name}
        assert own == names
        for numbers in (observations, rewards, *(infos[name] for name in own - {"separation"})):
            assert np.isfinite(numbers).all()
        assert ((infos["served"] >= 0) & (infos["served"] <= 1)).all()
    env.close()


def test_agents_of_pettingzoo_get_the_same_infos_at_reset_and_at_every_step():
    env = bulletuav.parallel_env("mobile_users", horizon=4, **SMALL)
    observations, infos = env.reset(seed=0)
    names = set(infos["drone_0"])
    assert {"served", "power", "charge", "reward/service_time"} <= names
    while env.agents:
        assert all(
            env.observation_space(agent).contains(observations[agent]) for agent in env.agents
        )
        flying = list(env.agents)
        observations, _, _, truncated, infos = env.step(
            dict.fromkeys(flying, np.zeros(3, np.float32))
        )
        assert all(set(infos[agent]) == names for agent in flying)
    assert all(truncated.values())
    env.close()


def test_the_number_of_processes_changes_no_bit():
    rows = []
    for workers in (1, 2):
        env = bulletuav.batch_env(
            "mobile_users", 3, workers=workers, seed=3, horizon=4, mobility="hotspot", **SMALL
        )
        rng, own = np.random.default_rng(0), [env.reset()[0].tobytes()]
        for _ in range(9):
            observations, rewards, *_, infos = env.step(rng.uniform(-1, 1, (3, 3, 3)))
            own += [
                observations.tobytes(),
                rewards.tobytes(),
                np.asarray(infos["served"]).tobytes(),
            ]
        rows.append(own)
        env.close()
    assert rows[0] == rows[1]
