"""The presets named after UrbanMARL: sizes, spaces and formulas.

Their source: docs/explanation/radio_and_edge.md.
"""

import math

import numpy as np
import pytest
from placing import SMALL

import bulletuav
from bulletuav.tasks import find_task

OBSERVED = {
    "default": 7,
    "navigation": 7,
    "lidar_navigation": 15,
    "los": 4,
    "coverage": 4,
    "mobile_users": 158,
    "mec": 8,
    "mec_advanced": 22,
}
"""Numbers of an observation: positions 3, charge 1; the rest: docs/explanation/radio_and_edge.md"""
TWO = {"area": 250.0, "num_layouts": 2}
USERS = {"los": 50, "mobile_users": 50, "mec": 50, "mec_advanced": 10}
TOP = {"lidar_navigation": 120, "mec_advanced": 120}
WEIGHTS = {
    "default": {"progress": 1, "goal": 5, "collision": -1},
    "navigation": {"progress": 0.05, "goal": 5, "collision": -1},
    "lidar_navigation": {
        "distance": -1 / 734.8469228,
        "goal": 5,
        "collision": -5,
        "proximity": -0.25,
    },
    "los": {"sight": 1, "collision": -1},
    "coverage": {"sight": 1, "close": -5, "collision": -1},
    "mobile_users": {"sight": 1, "dwell_time": 0.5, "collision": -2},
    "mec": {"tasks": 1, "latency": -0.5, "energy": -0.1, "dwell_time": 0.3, "collision": -2},
    "mec_advanced": {"tasks": 2, "latency": -1.5, "dwell_time": 0.5, "collision": -5},
}


@pytest.mark.parametrize("task", OBSERVED)
def test_each_scenario_has_the_sizes_and_weights_that_the_docs_tell(task):
    env = bulletuav.parallel_env(task, preset="urbanmarl")
    options, config = env.aviary.options, env.aviary.task.config
    sizes = (options.num_drones, options.decision_hz, options.horizon, options.max_climb)
    assert sizes == (3, 1, 100, 12)
    assert (options.max_speed, config.height) == (20, (20, TOP.get(task, 150)))
    np.testing.assert_array_equal(env.aviary.task.arena_low, (-250, -250, 0))
    np.testing.assert_array_equal(env.aviary.task.arena_high, (250, 250, 200))
    assert getattr(config, "num_users", None) == USERS.get(task)
    assert env.observation_space("drone_0").shape == (OBSERVED[task],)
    assert env.action_space("drone_0").shape == (3,)
    paid = {name: weight for name, weight in env.aviary.task.weights.items() if weight}
    assert paid == pytest.approx(WEIGHTS[task])
    env.close()


@pytest.mark.parametrize("task", OBSERVED)
def test_each_scenario_flies_and_tells_the_same_keys_at_reset_and_step(task):
    env = bulletuav.parallel_env(task, preset="urbanmarl", num_layouts=1)
    seen, infos = env.reset(seed=0)
    keys = infos["drone_0"].keys()
    assert {"city_alpha", "city_beta", "city_gamma"} <= keys
    rng = np.random.default_rng(0)
    for _ in range(10):
        if not env.agents:
            break
        actions = {agent: rng.uniform(-1, 1, 3) * (0.2, 0.2, 0.2) for agent in env.agents}
        seen, _, _, _, infos = env.step(actions)
        assert all(env.observation_space(agent).contains(one) for agent, one in seen.items())
        assert all(info.keys() == keys for info in infos.values())
        assert env.state_space.contains(env.state())
    env.close()


@pytest.fixture
def started():
    """Makes environments of the preset, and closes them."""
    made = []

    def start(task, **options):
        small = SMALL if options.pop("small", True) else {"num_layouts": 1}
        made.append(bulletuav.Aviary(task, preset="urbanmarl", **{**small, **options}))
        made[-1].reset(seeds=0)
        return made[-1]

    yield start
    for aviary in made:
        aviary.close()


def paid(aviary, frame):
    """Rewards (N,) of a frame."""
    task = aviary.task
    task.terminated(frame)  # derives what terms read
    terms = task.reward_terms(frame)
    return sum(task.weights[name] * term for name, term in terms.items())[0]


def test_the_reward_of_mobile_users_is_that_of_its_formula(started):
    """Sees 6 of 10 users, 10 s in the mean, no contact: 0.6 + 0.5 tanh(1) = 0.9807971."""
    aviary = started("mobile_users", num_users=10)
    frame = aviary.worlds.frame
    frame.readings["sight"][:] = np.arange(10) < 6
    frame.scene.memory["mean_dwell_time"][:] = 10.0
    np.testing.assert_allclose(paid(aviary, frame), 0.9807971, atol=1e-7)


@pytest.mark.parametrize(
    ("distance", "shortest", "expected"), [(100.0, 6.0, -0.2860828), (3.0, 60.0, 4.9959175)]
)
def test_the_reward_of_lidar_navigation_is_that_of_its_formula(
    started, distance, shortest, expected
):
    """-d / 734.847 + 5 reached - max(0, 0.25 - r / 60 m): 100 m off, 6 m from a wall; and 3 m off.

    The goal that was reached is paid by its own distance, and another is drawn.
    """
    aviary = started("lidar_navigation", small=False)
    aviary.scene.goal[:] = aviary.swarm.position + (distance, 0, 0)
    aviary.step(np.zeros((1, 3, 3)))
    frame = aviary.worlds.frame
    frame.readings["lidar"][:] = shortest
    np.testing.assert_allclose(paid(aviary, frame), expected, atol=1e-7)
    assert (aviary.scene.memory["goals"] == (distance == 3)).all()


def test_drones_that_are_close_pay_alike(started):
    """Three within 100 m of each other: each has two neighbours and pays 10 for them."""
    aviary = started("coverage", min_separation=20.0)
    aviary.task.config.__dict__["min_separation"] = 100.0
    aviary.swarm.position[0] = [(0, 0, 150), (50, 0, 150), (0, 50, 150)]
    step = aviary.step(np.zeros((1, 3, 3)))
    np.testing.assert_array_equal(step.info["reward/close"], [[-10, -10, -10]])


def test_own_sight_of_coverage_is_the_share_of_the_squares_of_its_own_city():
    """Of two layouts the shorter list of squares is padded: padding does not count."""
    aviary = bulletuav.Aviary("coverage", 6, weights={"sight": 1.0}, irregularity=0.5, **TWO)
    aviary.reset(seeds=0)
    step = aviary.step(np.zeros((6, 3, 3)))
    counts = aviary.task.active_targets(aviary.scene)
    assert len(set(counts.sum(axis=1).tolist())) == 2
    for w in range(6):
        own = aviary.sight[w][:, counts[w]].mean(axis=1)
        np.testing.assert_allclose(step.info["reward/sight"][w], own)
    aviary.close()


def test_climbs_are_limited_to_12_m_s(started):
    aviary = started("los", small=False)
    before = aviary.swarm.position.copy()
    aviary.step(np.broadcast_to((0.0, 0.0, 0.5), (1, 3, 3)))
    np.testing.assert_allclose(aviary.swarm.position - before, [[(0, 0, 6)] * 3], atol=1e-9)


BAD = [
    ("los", {"preset": "urbanmal"}, "unknown preset 'urbanmal': did you mean 'urbanmarl'"),
    ("hover", {"preset": "urbanmarl"}, "preset"),
    ("mobile_users", {"mobility": "manhatan"}, "did you mean 'manhattan'"),
    ("mec", {"distance_weight": 1.5}, "distance_weight is 1.5: at most 1 is possible"),
    ("mec", {"distance_weight": math.nan}, "distance_weight is nan"),
    ("mec", {"activity": 1.2}, "activity is 1.2: at most 1 is possible"),
    ("mec", {"activity": "lod"}, "unknown activity 'lod': did you mean 'load'"),
    ("los", {"area": (300.0, -1.0)}, "area is -1 m: it must be above 0"),
    ("los", {"area": (300.0,)}, "area is"),
    ("los", {"area": (300.0, 60.0)}, "area is 60 m: its side is 60"),
    ("los", {"area": "large"}, "area is 'large': a finite number"),
    ("navigation", {"at_goal": "respwan"}, "did you mean 'respawn'"),
    ("converge", {"at_goal": "respawn"}, "unknown at_goal 'respawn'"),
]


@pytest.mark.parametrize(("task", "options", "said"), BAD)
def test_what_cannot_be_is_refused(task, options, said):
    with pytest.raises(ValueError, match=said):
        bulletuav.Aviary(task, **options)


def test_presets_of_a_task_change_only_options_that_it_has():
    for task in OBSERVED:
        kind = find_task(task)
        assert kind.presets["urbanmarl"].get("weights", {}).keys() <= kind.reward.keys()
