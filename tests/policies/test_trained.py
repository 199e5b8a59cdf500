"""Trained policies, flown by NumPy from numbers in a file."""

import contextlib

import numpy as np
import pytest
from gymnasium.spaces import Box
from safetensors.numpy import save_file

import bulletuav
from bulletuav.policies import find_policy
from bulletuav.policies import run as run_module
from bulletuav.policies.features import UserFeatures, log_path_gain, symlog
from bulletuav.policies.neural_network import Network, is_plain, read_weights
from bulletuav.policies.run import FAST, SHIPPED, RunConfig, shipped_tasks
from bulletuav.policies.trained import Trained
from bulletuav.registry import find

CALM = {
    "dynamics": "single_integrator",
    "num_drones": 2,
    "difficulty": "easy",
    "horizon": 8,
    "observation": ["goal"],
}


def with_critic(weights):
    """Add what stable-baselines3 has besides the actor: copies of its features, and a critic."""
    whole = {name.replace("policy_net", "value_net"): array for name, array in weights.items()}
    whole |= {
        f"{kind}_{name}": array
        for name, array in weights.items()
        for kind in ("pi", "vf")
        if name.startswith("features_extractor")
    }
    whole["value_net.weight"] = np.zeros((1, weights["action_net.weight"].shape[1]), np.float32)
    whole["value_net.bias"] = np.zeros(1, np.float32)
    whole["log_std"] = np.zeros_like(weights["action_net.bias"])
    return weights | whole


@pytest.mark.filterwarnings("ignore:the package's policy")
@pytest.mark.parametrize("task", shipped_tasks())
def test_numpy_flies_as_pytorch_learned(task):
    """In double precision; in single precision PyTorch is off by 1e-6 in the sums over users."""
    import torch

    from bulletuav.adapters.sb3_policy import policy_network

    pilot, config = find_policy("trained", task), RunConfig.read(SHIPPED / task / "run.yaml")
    aviary = bulletuav.Aviary(task, 2, **pilot.options)
    policy, observations = pilot(aviary), aviary.reset(seeds=0)
    weights = read_weights(pilot.models[0])
    space, action = (
        aviary.observer.space(),
        bulletuav.batch_env(task, 1, **pilot.options).action_space,
    )
    about = (aviary.num_drones, aviary.observer.labels)
    # stable-baselines3 has no FAST, whose networks are those of its PPO
    algo = "ppo" if config.algo == FAST else config.algo
    settings = {name: config.settings[name] for name in ("features", "policy_kwargs")}
    if config.algo == FAST:
        weights = with_critic(weights)
    chosen = policy_network(algo, settings, space, action, *about, weights)
    learned = chosen.__closure__[0].cell_contents.double()
    for _ in range(20):
        actions = policy.act(observations, aviary.swarm)
        rows = observations.reshape(-1, observations.shape[-1])
        with torch.no_grad():
            features = learned.pi_features_extractor(torch.as_tensor(rows).double())
            exact = (
                learned.action_net(learned.mlp_extractor.forward_actor(features))
                .numpy()
                .reshape(actions.shape)
            )
        np.testing.assert_allclose(actions, np.clip(exact, action.low, action.high), atol=1e-9)
        observations = aviary.step(actions).observations
    aviary.close()


CASES = {
    "ppo": {},
    "a2c": {"policy_kwargs": {"net_arch": []}},
    "dqn": {},
    "sac": {"policy_kwargs": {"net_arch": [8, 8, 8]}},
    "td3": {"features": None},
    "ddpg": {"policy_kwargs": {"features_extractor_kwargs": {"scale": 3.0}}},
    "ppo, noise of states": {"use_sde": True},
    "sac, noise of states": {"use_sde": True},
}


@pytest.mark.filterwarnings("ignore:the package's policy")
@pytest.mark.parametrize("task", shipped_tasks())
def test_actions_depend_on_no_other_row_of_the_batch(task):
    pilot = find_policy("trained", task)
    aviary = bulletuav.Aviary(task, 3, **pilot.complete(task, {}))
    policy, observations = pilot(aviary), aviary.reset(seeds=0)
    rows = observations.reshape(-1, observations.shape[-1])
    actions = policy._choose_rows(rows)
    order = np.random.default_rng(0).permutation(len(rows))
    np.testing.assert_array_equal(policy._choose_rows(rows[order]), actions[order])
    for row, action in zip(rows, actions, strict=True):
        np.testing.assert_array_equal(policy._choose_rows(row[None])[0], action)
    aviary.close()


# Features of users, of swarms, and none
@pytest.mark.filterwarnings("ignore:the package's policy")
@pytest.mark.parametrize("task", ["mec", "mec_advanced", "hover"])
def test_flights_do_not_depend_on_the_number_of_workers(task):
    flown = [
        bulletuav.evaluate(task, "trained", 20, workers=count, dynamics="rigid_body", horizon=4)
        for count in (1, 2)
    ]
    assert flown[0].hash == flown[1].hash


@pytest.mark.parametrize("case", CASES)
def test_every_algorithms_actor_is_flown_as_it_is_learned(case, tmp_path):
    """To 1e-6 of stable-baselines3's own deterministic actions, from the file of a checkpoint."""
    from bulletuav.adapters.sb3 import DroneVecEnv
    from bulletuav.training import checkpoint
    from bulletuav.training.models import make_model

    algo = case.partition(",")[0]
    options = {**CALM, "action": "discrete"} if algo == "dqn" else CALM
    config = RunConfig("converge", algo, options=options, model=CASES[case], worlds=1)
    env = DroneVecEnv("converge", 1, **options)
    model = make_model(config, env)
    if isinstance(model.action_space, Box):
        model.action_space.low[0], model.action_space.high[0] = -0.3, 0.7  # not symmetric
    checkpoint.save_checkpoint(model, tmp_path)
    aviary = bulletuav.Aviary("converge", 1, **options)
    policy, rng = Trained(aviary, config, tmp_path / "policy.safetensors"), np.random.default_rng(0)
    aviary.reset(seeds=0)
    for size in (0.0, 0.1, 3.0):
        observations = (size * rng.normal(size=(1, 2, *env.observation_space.shape))).astype(
            np.float32
        )
        expected, _ = model.predict(observations[0], deterministic=True)
        np.testing.assert_allclose(
            policy.act(observations, aviary.swarm)[0],
            np.reshape(expected, (2, -1)),
            atol=1e-6,
            rtol=0,
        )
    assert is_plain(algo, config.settings) == (case != "sac, noise of states")
    aviary.close()
    env.close()


def test_a_network_by_hand():
    """tanh(1 * 0.5) * 2 + 0.25 = 1.17423..., clipped to 1; ReLU and tanh into [2, 6] for TD3."""
    layers = {"policy_net.0": ([[1.0]], [0.0])}
    weights = {
        f"mlp_extractor.{name}.weight": np.array(w, dtype=np.float32)
        for name, (w, _) in layers.items()
    }
    weights |= {
        f"mlp_extractor.{name}.bias": np.array(b, dtype=np.float32)
        for name, (_, b) in layers.items()
    }
    weights |= {
        "action_net.weight": np.array([[2.0]], np.float32),
        "action_net.bias": np.array([0.25], np.float32),
    }
    bounds = {
        "action.low": np.array([-1.0], np.float32),
        "action.high": np.array([1.0], np.float32),
    }
    free = {"action.low": np.array([-9.0], np.float32), "action.high": np.array([9.0], np.float32)}
    model = {"features": None}
    assert Network(weights | free, "ppo", model)(np.array([[0.5]]))[0, 0] == pytest.approx(
        2 * np.tanh(0.5) + 0.25, abs=1e-12
    )
    assert Network(weights | bounds, "ppo", model)(np.array([[0.5]]))[0, 0] == 1.0
    td3 = {
        "actor.mu.0.weight": np.array([[1.0], [-1.0]], np.float32),
        "actor.mu.0.bias": np.zeros(2, np.float32),
    }
    td3 |= {
        "actor.mu.2.weight": np.array([[0.5, 0.5]], np.float32),
        "actor.mu.2.bias": np.zeros(1, np.float32),
    }
    td3 |= {"action.low": np.array([2.0], np.float32), "action.high": np.array([6.0], np.float32)}
    assert Network(td3, "td3", model)(np.array([[-3.0]]))[0, 0] == pytest.approx(
        4 + 2 * np.tanh(1.5), abs=1e-12
    )


def test_features_by_hand():
    np.testing.assert_allclose(
        symlog(np.array([-2.0, 0.0, 1.0]), 3.0), [-np.log(7), 0.0, np.log(4)], rtol=1e-15
    )
    gains = log_path_gain(np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 0.0]]), np.array([1.0, 0.0]))
    np.testing.assert_allclose(gains, [-2 * np.log(6), 0.0], atol=1e-15)


def test_users_count_whatever_their_order():
    rng = np.random.default_rng(1)
    features = UserFeatures([(rng.normal(size=(5, 14)), rng.normal(size=5))])
    assert features.num_drones == 3
    row = rng.normal(size=(1, sum(features.sizes(3 + 12 + 7 * 11))))
    parts = np.split(row, np.cumsum(features.sizes(row.shape[1]))[:-1], axis=1)
    order = rng.permutation(7)
    parts[2] = parts[2].reshape(7, 4)[order].reshape(1, -1)
    parts[3], parts[4] = (part.reshape(-1, 7)[:, order].reshape(1, -1) for part in parts[3:])
    np.testing.assert_allclose(features(np.concatenate(parts, axis=1)), features(row), rtol=1e-12)
    with pytest.raises(ValueError, match="do not fit 20 numbers"):
        features.sizes(20)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda w: {name: array for name, array in w.items() if name != "action_net.bias"},
            "lacks action_net.bias",
        ),
        (
            lambda w: {**w, "action_net.weight": np.zeros((3, 7), np.float32)},
            "does not match the layer before",
        ),
        (
            lambda w: {**w, "action_net.bias": np.zeros((3, 1), np.float32)},
            "does not match the layer before",
        ),
        (lambda w: {**w, "action_net.bias": np.full(3, np.nan, np.float32)}, "not finite"),
        (
            lambda w: {name: array for name, array in w.items() if not name.startswith("action.")},
            "to 3 choices",
        ),
        (lambda w: {**w, "log_std": np.zeros(3, int)}, "log_std is of int64, and floats are"),
        (lambda w: {**w, "log_std": np.zeros(3, bool)}, "log_std is of bool, and floats are"),
        (lambda w: {**w, "action.high": w["action.low"]}, "action.low must be below action.high"),
        (lambda w: {}, "lacks action_net.weight"),
    ],
)
def test_a_damaged_policy_is_refused(change, said, tmp_path):
    config = RunConfig.read(SHIPPED / "crossing" / "run.yaml")
    path = tmp_path / "policy.safetensors"
    save_file(change(read_weights(SHIPPED / "crossing" / "policy.safetensors")), path)
    aviary = bulletuav.Aviary("crossing", **config.interface)
    with pytest.raises(ValueError, match=said):
        Trained(aviary, config, path)
    aviary.close()
    with pytest.raises(FileNotFoundError, match="no policy"):
        read_weights(tmp_path / "none.safetensors")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"observation": ["velocity", "goal_offset", "intruders"]}, "observation is"),
        ({"normalise": True}, "normalise is True"),
    ],
)
def test_observations_of_another_meaning_are_refused(options, said):
    pilot = find_policy("trained", "crossing")
    aviary = bulletuav.Aviary("crossing", 1, **{**pilot.options, **options})
    remedy = r"task 'crossing' with .* and velocity actions: leave .* train crossing --set"
    with pytest.raises(ValueError, match=rf"{said}.*{remedy}"):
        pilot(aviary)
    aviary.close()


@pytest.mark.parametrize("option", [{"max_range": 30.0}, {"lidar_frame": "world"}])
def test_options_of_a_lidar_concern_only_policies_that_observe_it(option):
    (name,) = option
    for task, fits in (("crossing", True), ("lidar_navigation", False)):
        pilot = find_policy("trained", task)
        aviary = bulletuav.Aviary(task, 1, **{**pilot.options, **option})
        expected = contextlib.nullcontext() if fits else pytest.raises(ValueError, match=name)
        with contextlib.closing(aviary), expected:
            pilot(aviary)


def test_a_policy_of_a_swarm_flies_with_other_numbers_of_neighbours_and_in_other_tasks():
    pilot = find_policy("trained", "crossing")
    for task, count in (("crossing", 3), ("converge", 6)):
        options = {**pilot.options, "num_neighbours": count}
        with contextlib.closing(bulletuav.Aviary(task, 1, **options)) as aviary:
            policy, observations = pilot(aviary), aviary.reset(seeds=0)
            assert np.isfinite(policy.act(observations, aviary.swarm)).all()


@pytest.mark.parametrize(
    ("task", "level"),
    [("transport", "easy"), ("transport", "medium"), ("pad_landing", "easy")],
)
def test_policies_of_the_package_set_loads_down_and_land(task, level):
    """Loads hang on one cable at easy, and on two at medium."""
    flown = bulletuav.evaluate(task, "trained", 3, 9_000_000, difficulty=level)
    assert flown.estimates()["safe_success"].mean > 0.6


def test_the_policy_of_transport_flies_with_other_numbers_of_drones():
    pilot = find_policy("trained", "transport")
    for drones in (1, 3):
        aviary = bulletuav.Aviary("transport", 1, **{**pilot.options, "num_drones": drones})
        with contextlib.closing(aviary):
            policy, observations = pilot(aviary), aviary.reset(seeds=0)
            actions = policy.act(observations, aviary.swarm)
            assert actions.shape == (1, drones, 3)
            assert np.isfinite(actions).all()


def test_a_block_may_be_an_object_where_the_training_named_it(tmp_path):
    config = RunConfig("converge", "fast_ppo", options=CALM, model={"features": None})
    weights = {
        "mlp_extractor.policy_net.0.weight": np.ones((1, 4), np.float32),
        "mlp_extractor.policy_net.0.bias": np.zeros(1, np.float32),
        "action_net.weight": np.ones((3, 1), np.float32),
        "action_net.bias": np.zeros(3, np.float32),
        "action.low": np.full(3, -1, np.float32),
        "action.high": np.ones(3, np.float32),
    }
    save_file(weights, tmp_path / "policy.safetensors")
    block = find("observation", "goal", callable)
    with contextlib.closing(
        bulletuav.Aviary("converge", 1, **{**CALM, "observation": [block]})
    ) as aviary:
        policy, observations = (
            Trained(aviary, config, tmp_path / "policy.safetensors"),
            aviary.reset(seeds=0),
        )
        assert policy.act(observations, aviary.swarm).shape == (1, 2, 3)


def test_a_task_without_a_policy_names_the_command_that_trains_one(monkeypatch):
    monkeypatch.setattr(run_module, "shipped_tasks", lambda: ["mec"])
    command = "only for mec: train one by bulletuav train converge, and"
    with pytest.raises(ValueError, match=command):
        find_policy("trained", "converge")
