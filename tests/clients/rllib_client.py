"""Ray RLlib's PPO (new API stack) through Ray's own `ParallelPettingZooEnv`: two small iterations.

Drones leave early, and ends are mixed: see `swarm.py`.
"""

import os
import tempfile

from swarm import make_env


def count_ends(episode, metrics_logger, **_):
    """Count episodes with drones that left early, and those whose last step mixes both ends.

    Ray calls an episode terminated, but not truncated, when not all who flew last were truncated.
    """
    agents = episode.agent_episodes.values()
    early = any(agent.is_done and agent.t < episode.env_t for agent in agents)
    mixed = not episode.is_truncated and any(agent.is_truncated for agent in agents)
    for name, value in (("episodes", 1), ("early", early), ("mixed", mixed)):
        metrics_logger.log_value(name, int(value), reduce="lifetime_sum")


def train(folder):
    """Results of two iterations; `folder` is for whatever Ray writes."""
    os.environ.update(  # read when Ray is imported; its results go to ~/ray_results
        HOME=folder, RAY_AUTH_MODE="disabled", RAY_USAGE_STATS_ENABLED="0"
    )
    import ray
    from ray.rllib.algorithms.ppo import PPOConfig
    from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig
    from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
    from ray.tune.registry import register_env

    def make(_):
        return ParallelPettingZooEnv(make_env())

    register_env("crossing", make)
    config = (
        PPOConfig()
        .environment("crossing")
        .env_runners(num_env_runners=0)
        .learners(num_learners=0)
        .multi_agent(policies={"shared"}, policy_mapping_fn=lambda agent, episode, **_: "shared")
        .rl_module(model_config=DefaultModelConfig(fcnet_hiddens=[16, 16]))
        .training(train_batch_size_per_learner=256, minibatch_size=64, num_epochs=1)
        .callbacks(on_episode_end=count_ends)
        .debugging(seed=0)
    )
    ray.init(num_cpus=1, include_dashboard=False, log_to_driver=False, _temp_dir=folder)
    try:
        algorithm = config.build_algo()
        try:
            return [algorithm.train() for _ in range(2)]
        finally:
            algorithm.stop()
    finally:
        ray.shutdown()


def main():
    """Train, and check that the ends that matter did happen."""
    with tempfile.TemporaryDirectory(prefix="ray", ignore_cleanup_errors=True) as folder:
        last = train(folder)[-1]["env_runners"]
    episodes, early, mixed = (int(last[name]) for name in ("episodes", "early", "mixed"))
    assert early > 0, "no drone left early"
    assert mixed > 0, "no last step mixed terminations with truncations"
    steps, returns = last["num_env_steps_sampled_lifetime"], last["episode_return_mean"]
    print(
        f"rllib: 2 iterations, {steps:.0f} steps, {episodes} episodes, {early} with early leavers, "
        f"{mixed} with mixed ends, mean return {returns:.1f}"
    )


if __name__ == "__main__":
    main()
