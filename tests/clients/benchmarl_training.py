"""BenchMARL's MAPPO on `crossing`, easy, beside random flight. By hand; takes some ten minutes:

python tests/clients/benchmarl_training.py
"""

import time
import warnings

import torch
from benchmarl.algorithms import MappoConfig
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig
from torchrl.envs.utils import ExplorationType, set_exploration_type

from bulletuav.adapters.benchmarl import DroneTask

OPTIONS = {
    "num_drones": 4,
    "dynamics": "point_mass",
    "difficulty": "easy",
    "horizon": 200,
    "goal_radius": 5.0,
    "normalise": True,
    # Smaller than the task's own weights, as networks like returns of the order of 1
    "weights": {
        "progress": 0.05,
        "goal": 2.0,
        "conflict": -3.0,
        "warning": -0.1,
        "collision": -5.0,
        "out_of_bounds": -5.0,
        "energy": -0.0005,
        "time": -0.02,
    },
}
TRAINING = {
    "max_n_frames": 720_000,
    "max_n_iters": None,
    "loggers": [],
    "evaluation": False,
    "render": False,
    "lr": 1e-3,
    "gamma": 0.99,
    "on_policy_collected_frames_per_batch": 9600,
    "on_policy_n_envs_per_worker": 48,
    "on_policy_minibatch_size": 1200,
    "on_policy_n_minibatch_iters": 8,
}
EPISODES, SEED = 50, 1000


def interval(values):
    """Mean with its 95 % interval."""
    half = 1.96 * values.std() / len(values) ** 0.5
    return f"{values.mean():.2f} ({values.mean() - half:.2f} to {values.mean() + half:.2f})"


def fly(policy):
    """Fly an episode in each world; tell returns, and drones at their goals."""
    task = DroneTask.CROSSING.get_task(OPTIONS)
    env = task.get_env_fun(EPISODES, continuous_actions=True, seed=SEED, device="cpu")()
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        flown = env.rollout(OPTIONS["horizon"], policy=policy, break_when_any_done=False)
    env.close()
    done = flown["next", "done"][..., 0]
    # Worlds start anew: their first episodes count
    first = (done.int().cumsum(1) - done.int() == 0)[..., None]
    told = [flown["next", group] for group in env.group_map]  # teams
    reward = torch.cat([one["reward"] for one in told], dim=2)[..., 0]
    success = torch.cat([one["info", "success"] for one in told], dim=2).squeeze(-1)
    returns = (reward * first).sum(1).mean(-1)
    arrived = (success.float() * first).amax(1).mean(-1)
    return f"return {interval(returns)}, {interval(arrived)} of the drones at their goals"


def main():
    """Train, and compare."""
    torch.set_num_threads(1)
    warnings.simplefilter("ignore", DeprecationWarning)
    config = ExperimentConfig.get_from_yaml()
    for name, value in TRAINING.items():
        setattr(config, name, value)
    model = MlpConfig.get_from_yaml()
    model.num_cells = [128, 128]
    experiment = Experiment(
        task=DroneTask.CROSSING.get_task(OPTIONS),
        algorithm_config=MappoConfig.get_from_yaml(),
        model_config=model,
        critic_model_config=MlpConfig.get_from_yaml(),
        seed=0,
        config=config,
    )
    print(f"random: {fly(None)}", flush=True)
    began = time.perf_counter()
    experiment.run()
    print(f"{experiment.total_frames} decisions of worlds, {time.perf_counter() - began:.0f} s")
    print(f"MAPPO: {fly(experiment.policy)}")


if __name__ == "__main__":
    main()
