"""BenchMARL: an iteration of each algorithm, by code and by its command line, and clear refusals.

Files go to the folder where it is started.
"""

import subprocess
import sys
import warnings

import torch
from benchmarl.algorithms import algorithm_config_registry
from benchmarl.environments import task_config_registry
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig

import bulletuav
from bulletuav.adapters.benchmarl import DroneTask, DroneTaskClass

ALGORITHMS = ("mappo", "ippo", "qmix", "vdn", "maddpg", "iql")
OPTIONS = {"num_drones": 4, "dynamics": "single_integrator", "difficulty": "easy", "horizon": 40}
COMMAND = (sys.executable, "-m", "bulletuav.adapters.benchmarl")
SHORT = {
    "max_n_iters": 1,
    "max_n_frames": None,
    "loggers": [],
    "evaluation_episodes": 2,
    "evaluation_interval": 400,
    "on_policy_collected_frames_per_batch": 400,
    "on_policy_n_envs_per_worker": 8,
    "on_policy_n_minibatch_iters": 1,
    "off_policy_collected_frames_per_batch": 400,
    "off_policy_n_envs_per_worker": 8,
    "off_policy_n_optimizer_steps": 3,
    "render": True,
}
REFUSALS = {
    "algorithm=mapo task=bulletuav/crossing": "unknown algorithm 'mapo': did you mean 'mappo'",
    "algorithm=mappo task=bulletuav/crosing": "unknown task 'bulletuav/crosing': did you mean",
    "algorithm=mappo task=bulletuav/crossing task.num_drone=4": "did you mean 'num_drones'",
    "algorithm=mappo task=bulletuav/crossing task.num_drones=0": "num_drones is 0: a whole number",
    "algorithm=mappo task=bulletuav/crossing task.observation=[velocity,rgb]": "has pictures",
    "algorithm=qmix task=bulletuav/crossing task.action=velocity": "is not compatible",
}
"""Arguments of the command line, and what the line that refuses them says"""


def train(name, options):
    """An experiment after its iteration."""
    config = ExperimentConfig.get_from_yaml()
    for key, value in SHORT.items():
        setattr(config, key, value)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        experiment = Experiment(
            task=DroneTask.CROSSING.get_task(options),
            algorithm_config=algorithm_config_registry[name].get_from_yaml(),
            model_config=MlpConfig.get_from_yaml(),
            critic_model_config=MlpConfig.get_from_yaml(),
            seed=0,
            config=config,
        )
        experiment.run()
    assert experiment.n_iters_performed == 1
    assert experiment.total_frames == 400
    return experiment


def check_tasks():
    """All tasks are there, with and without options."""
    assert [task.name.lower() for task in DroneTask] == bulletuav.list_tasks()
    assert all(f"bulletuav/{name}" in task_config_registry for name in bulletuav.list_tasks())
    task = DroneTask.CROSSING.get_task()
    assert task.config == {}
    assert task.max_steps(None) == 500
    assert task == DroneTaskClass("crossing", {}) or task.name == "CROSSING"
    discrete = DroneTask.HOVER.get_task({"action": "discrete"})
    assert not discrete.supports_continuous_actions()
    assert discrete.supports_discrete_actions()
    bare = DroneTask.CROSSING.get_task({"return_state": False, "infos": (), **OPTIONS})
    env = bare.get_env_fun(2, continuous_actions=True, seed=0, device="cpu")()
    assert bare.state_spec(env) is None
    assert bare.info_spec(env) is None
    assert bare.log_info(env.rollout(3)) == {}
    env.close()


def check_command_line():
    """The command line trains, and refuses in one line what cannot be."""
    given = [f"experiment.{key}={value}" for key, value in SHORT.items()]
    given = [one.replace("None", "null").replace("True", "true") for one in given]
    options = [f"task.{key}={value}" for key, value in OPTIONS.items()]
    fixed = ["algorithm=mappo", "task=bulletuav/crossing"]
    subprocess.run([*COMMAND, *fixed, *options, *given], check=True, capture_output=True)
    for arguments, expected in REFUSALS.items():
        command = [*COMMAND, *arguments.split(), *given]
        done = subprocess.run(command, capture_output=True, text=True)
        last = done.stderr.strip().splitlines()[-1]
        assert done.returncode == 1, arguments
        assert last.startswith("bulletuav: "), done.stderr
        assert expected in last, last


def main():
    """Train, and check."""
    torch.set_num_threads(1)
    check_tasks()
    for name in ALGORITHMS:
        experiment = train(name, OPTIONS)
        kind = "continuous" if experiment.continuous_actions else "discrete"
        print(f"benchmarl: {name}, {kind}, mean return {experiment.mean_return:.1f}")
    one_group = {**OPTIONS, "group_map": "ALL_IN_ONE_GROUP", "render_mode": "rgb_array"}
    train("mappo", one_group)
    check_command_line()
    print("benchmarl: the command line trains, and refuses what cannot be")


if __name__ == "__main__":
    main()
