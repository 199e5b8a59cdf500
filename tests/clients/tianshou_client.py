"""Train PPO of Tianshou 2 in Gymnasium's environment, whose agent commands all drones."""

import numpy as np
import torch
from library import OPTIONS, TASK, report
from tianshou.algorithm import PPO
from tianshou.algorithm.modelfree.reinforce import ProbabilisticActorPolicy
from tianshou.algorithm.optim import AdamOptimizerFactory
from tianshou.data import Collector, CollectStats, VectorReplayBuffer
from tianshou.env import DummyVectorEnv
from tianshou.trainer import OnPolicyTrainerParams
from tianshou.utils.net.common import Net
from tianshou.utils.net.continuous import ContinuousActorProbabilistic, ContinuousCritic
from torch.distributions import Independent, Normal

from bulletuav.envs.gymnasium import CentralAviary

WORLDS = 4
STEPS = 2048
"""Decisions of worlds"""


def make_envs():
    """Make the vector environment."""
    return DummyVectorEnv([lambda: CentralAviary(TASK, **OPTIONS) for _ in range(WORLDS)])


def collect():
    """Return a function that flies a decision by the vector environment."""
    envs = make_envs()
    envs.reset()
    actions = np.stack([space.sample() for space in envs.action_space])

    def step():
        _, _, terminated, truncated, _ = envs.step(actions)
        over = np.flatnonzero(terminated | truncated)
        if len(over):
            envs.reset(over)

    return step


def train():
    """Train, and return the number of decisions."""
    envs = make_envs()
    seen, act = envs.observation_space[0], envs.action_space[0]
    actor, critic = (Net(state_shape=seen.shape, hidden_sizes=(64,)) for _ in range(2))
    actor = ContinuousActorProbabilistic(
        preprocess_net=actor, action_shape=act.shape, unbounded=True
    )
    policy = ProbabilisticActorPolicy(
        actor=actor,
        dist_fn=lambda given: Independent(Normal(*given), 1),
        action_space=act,
    )
    learner = PPO(
        policy=policy,
        critic=ContinuousCritic(preprocess_net=critic),
        optim=AdamOptimizerFactory(lr=3e-4),
    )
    before = [part.clone() for part in actor.parameters()]
    collector = Collector[CollectStats](policy, envs, VectorReplayBuffer(STEPS, WORLDS))
    learner.run_training(
        OnPolicyTrainerParams(
            training_collector=collector,
            max_epochs=1,
            epoch_num_steps=STEPS,
            collection_step_num_env_steps=STEPS // 2,
            update_step_num_repetitions=4,
        )
    )
    after = actor.parameters()
    assert any(not torch.equal(old, new) for old, new in zip(before, after, strict=True))
    return STEPS * OPTIONS["num_drones"]


if __name__ == "__main__":
    how = f"PPO, {WORLDS} worlds of Gymnasium's environment"
    report(["tianshou", "torch"], how, [make_envs], WORLDS, collect, train)
