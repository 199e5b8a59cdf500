"""Whole episodes of edge computing: options, bounds, processes and what is worth doing."""

import numpy as np
import pytest
from edge_users import EDGE, STAY, hovered
from gymnasium.vector import AutoresetMode
from placing import OPEN, SMALL, fly

import bulletuav
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.resolve_options import resolve_options
from bulletuav.policies import find_policy
from bulletuav.tasks import find_task


@pytest.mark.parametrize(("task", "users"), [("mec", 50), ("mec_advanced", 10)])
def test_the_preset_has_the_sizes_that_it_is_named_after(make, task, users):
    options, config, _ = resolve_options(find_task(task), {"preset": "urbanmarl"})
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
    assert {"served", "completed", "latency", "reward/tasks"} <= names
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


@pytest.mark.parametrize("preset", [None, "urbanmarl"])
@pytest.mark.parametrize("task", EDGE)
def test_to_serve_pays_more_than_to_hover_and_that_more_than_to_crash(task, preset):
    returns = {}
    for name in ("crash", "hover", "oracle"):
        aviary = bulletuav.Aviary(task, 4, preset=preset)
        observations = aviary.reset(seeds=0)
        policy = find_policy("oracle")(aviary)
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
    assert returns["hover"] + 5 < returns["oracle"]


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
