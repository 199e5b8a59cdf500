"""RLlib's PPO and APPO (new API stack) with the package's own environments: small iterations.

Drones leave early, and ends are mixed: see `swarm.py`. Ends that the horizon made stay such in what
is learned from, which they do not with Ray's `ParallelPettingZooEnv`.
"""

# ruff: noqa: E402 - Ray reads variables when it is imported
import os
import tempfile
from pathlib import Path

FOLDER = tempfile.TemporaryDirectory(prefix="ray", ignore_cleanup_errors=True)
os.environ.setdefault("XDG_CACHE_HOME", str(Path.home() / ".cache"))
os.environ.update(HOME=FOLDER.name, RAY_AUTH_MODE="disabled", RAY_USAGE_STATS_ENABLED="0")

import numpy as np
import ray
from ray.rllib.algorithms.appo import APPOConfig
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig
from ray.rllib.core.rl_module.rl_module import RLModuleSpec
from ray.rllib.env.multi_agent_env_runner import MultiAgentEnvRunner
from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
from ray.rllib.examples.rl_modules.classes.action_masking_rlm import (
    ActionMaskingTorchRLModule,
)
from swarm import HORIZON, OPTIONS, make_env

import bulletuav
from bulletuav.adapters.rllib import (
    DroneMultiAgentEnv,
    connect,
    log_outcomes,
    policies,
    rows_function,
)
from bulletuav.adapters.rllib_vector import BatchEnvRunner

CONFIG = {name: value for name, value in OPTIONS.items() if name != "seed"} | {"task": "crossing"}
RUNNERS = {"own vector": MultiAgentEnvRunner, "at once": BatchEnvRunner}


def configure(made, runner, config=CONFIG, by="swarm"):
    """Configure an algorithm with few worlds and a small network."""
    task = {name: value for name, value in config.items() if name not in ("task", "symlog")}
    return (
        made.environment(DroneMultiAgentEnv, env_config=config)
        .env_runners(num_env_runners=0, num_envs_per_env_runner=4, env_runner_cls=runner)
        .learners(num_learners=0)
        .multi_agent(**policies(config["task"], by=by, **task))
        .rl_module(model_config=DefaultModelConfig(fcnet_hiddens=[16, 16]))
        .callbacks(on_episode_end=log_outcomes)
        .debugging(seed=0)
    )


def count_ends(episodes):
    """Count drones by how their episodes ended: (by the task, by the horizon, both at once)."""
    ends = np.zeros(3, dtype=int)
    for episode in episodes:
        if episode.is_done:
            drones = episode.agent_episodes.values()
            ended = [drone.is_terminated for drone in drones]
            cut = [drone.is_truncated and not drone.is_terminated for drone in drones]
            ends += (sum(ended), sum(cut), any(ended) and any(cut))
    return ends


def check_ends():
    """The horizon truncates: nobody whom it stopped counts as terminated."""
    for name, runner in RUNNERS.items():
        flown = runner(config=configure(PPOConfig(), runner))
        terminated, cut, mixed = count_ends(flown.sample(num_episodes=60))
        assert min(terminated, cut, mixed) > 10, f"{name}: {terminated}, {cut}, {mixed}"
        print(f"ends, {name}: {terminated} drones terminated, {cut} truncated, {mixed} mixed")
    # Ray's own wrapper of the PettingZoo environment, for comparison
    config = configure(PPOConfig(), MultiAgentEnvRunner)
    config.environment(lambda _: ParallelPettingZooEnv(make_env()))
    config.callbacks(on_episode_end=lambda **_: None)
    terminated, cut, _ = count_ends(MultiAgentEnvRunner(config=config).sample(num_episodes=60))
    print(f"ends, Ray's wrapper: {terminated} drones terminated, {cut} truncated")


def check_training():
    """Both algorithms train, with each grouping, on numbers and on choices."""
    cases = (
        ("ppo", PPOConfig(), "swarm", {}),
        ("ppo", PPOConfig(), "team", {"symlog": True}),
        ("ppo", PPOConfig(), "drone", {"action": "discrete"}),
        ("appo", APPOConfig(), "swarm", {}),
    )
    for name, made, by, more in cases:
        for kind, runner in RUNNERS.items():
            config = configure(made.copy(copy_frozen=False), runner, CONFIG | more, by)
            config.training(train_batch_size_per_learner=256)
            if name == "ppo":
                config.training(minibatch_size=64, num_epochs=1)
            algorithm = config.build_algo()
            told = [algorithm.train() for _ in range(2)][-1]["env_runners"]
            check_flight(algorithm, sorted(algorithm.config.policies), more)
            algorithm.stop()
            print(
                f"{name}, {by}, {kind}, {more}: "
                f"{told['num_env_steps_sampled_lifetime']:.0f} decisions, "
                f"return {told['episode_return_mean']:.1f}, success {told['success']:.2f}"
            )


def check_masks():
    """PPO trains with RLlib's own module for masks, and never chooses an invalid move."""
    # A small arena, at whose bounds moves are invalid
    arena = {"difficulty": "easy", "radius": 20.0, "margin": 10.0, "horizon": 60}
    masked = {"action": "discrete", "action_masks": True, "dynamics": "point_mass", **arena}
    for kind, runner in RUNNERS.items():
        config = configure(PPOConfig(), runner, {"task": "converge", "num_drones": 4, **masked})
        config.rl_module(rl_module_spec=RLModuleSpec(module_class=ActionMaskingTorchRLModule))
        config.training(train_batch_size_per_learner=256, minibatch_size=64, num_epochs=1)
        algorithm = config.build_algo()
        results = algorithm.train()["env_runners"]
        chosen, invalid = 0, 0
        for episode in algorithm.env_runner.sample(num_episodes=4):
            for drone in episode.agent_episodes.values():
                observations, actions = drone.get_observations(), drone.get_actions()
                masks = observations["action_mask"][: len(actions)]
                chosen += len(actions)
                assert masks[np.arange(len(actions)), actions].all()
                invalid += int((masks == 0).sum())
        assert chosen > 20
        assert invalid > 0
        function = rows_function(algorithm)
        result = bulletuav.evaluate("converge", function, episodes=2, num_drones=4, **masked)
        assert result.estimates()["length"].mean <= 60
        algorithm.stop()
        print(
            f"ppo, masks, {kind}: return {results['episode_return_mean']:.1f}, {chosen} valid "
            f"choices, where {invalid} were invalid"
        )


def check_flight(algorithm, names, more):
    """What was learned flies by the package's own evaluation."""
    function = rows_function(algorithm, names[0])
    flown = {name: value for name, value in (CONFIG | more).items() if name != "symlog"}
    result = bulletuav.evaluate(flown.pop("task"), function, episodes=2, **flown)
    assert result.estimates()["length"].mean <= HORIZON


def main():
    """Train on this machine alone."""
    connect(num_cpus=1, log_to_driver=False, _temp_dir=FOLDER.name)
    check_ends()
    check_training()
    check_masks()
    ray.shutdown()


if __name__ == "__main__":
    main()
