"""Train IPPO of XuanCe in the parallel environment, by an environment class as XuanCe asks for."""

from argparse import Namespace
from pathlib import Path

import numpy as np
import xuance
import yaml
from library import OPTIONS, TASK, report
from xuance.environment import REGISTRY_MULTI_AGENT_ENV, RawMultiAgentEnv, make_envs
from xuance.torch.agents import REGISTRY_Agents

import bulletuav

WORLDS = 4
STEPS = 2000


class DroneEnv(RawMultiAgentEnv):
    """Parallel environment with the calls of XuanCe; drones that are done stay until the end."""

    def __init__(self, config):
        super().__init__()
        self.env = bulletuav.parallel_env(config.env_id, **OPTIONS)
        self.agents = list(self.env.possible_agents)
        self.num_agents = len(self.agents)
        self.state_space = self.env.state_space
        self.observation_space = {one: self.env.observation_space(one) for one in self.agents}
        self.action_space = {one: self.env.action_space(one) for one in self.agents}
        self.max_episode_steps = self.env.aviary.options.horizon

    def reset(self):
        self.seen, infos = self.env.reset()
        self.rewards = dict.fromkeys(self.agents, 0.0)
        return self.seen, {"infos": infos, "individual_episode_rewards": self.rewards}

    def step(self, actions):
        flown = {one: np.clip(actions[one], -1, 1) for one in self.env.agents}
        seen, rewards, ended, _, infos = self.env.step(flown)
        self.seen = {**self.seen, **seen}
        rewards = {**dict.fromkeys(self.agents, 0.0), **rewards}
        self.rewards = {one: self.rewards[one] + rewards[one] for one in self.agents}
        ended = {one: ended.get(one, one not in self.env.agents) for one in self.agents}
        info = {"infos": infos, "individual_episode_rewards": self.rewards}
        return self.seen, rewards, ended, not self.env.agents, info

    def state(self):
        return self.env.state()

    def agent_mask(self):
        return {one: one in self.env.agents for one in self.agents}

    def avail_actions(self):
        return None

    def render(self, *args):
        return None

    def close(self):
        self.env.close()


def configure():
    """Return the settings that XuanCe has for IPPO, with this environment."""
    folder = Path(xuance.__file__).parent / "configs"
    settings = yaml.safe_load((folder / "basic.yaml").read_text())
    settings |= yaml.safe_load((folder / "ippo" / "mpe" / "simple_spread_v3.yaml").read_text())
    settings |= {"env_name": "bulletuav", "env_id": TASK, "parallels": WORLDS}
    settings |= {"vectorize": "DummyVecMultiAgentEnv", "buffer_size": 400 * WORLDS}
    settings |= {"running_steps": STEPS, "activation_action": "tanh", "logger": "tensorboard"}
    return Namespace(**settings)


REGISTRY_MULTI_AGENT_ENV["bulletuav"] = DroneEnv


def collect():
    """Return a function that flies a decision by the vector environment."""
    envs = make_envs(configure())
    envs.reset()
    actions = [{one: envs.action_space[one].sample() for one in envs.agents}] * WORLDS
    return lambda: envs.step(actions)


def train():
    """Train, and return the number of decisions."""
    config = configure()
    envs = make_envs(config)
    learner = REGISTRY_Agents["IPPO"](config=config, envs=envs)
    before = [part.clone() for part in learner.policy.parameters()]
    learner.train(STEPS // WORLDS)
    after = list(learner.policy.parameters())
    assert any((old != new).any() for old, new in zip(before, after, strict=True))
    return STEPS * OPTIONS["num_drones"]


if __name__ == "__main__":
    report(["xuance", "torch"], "IPPO, 4 worlds", [DroneEnv], WORLDS, collect, train)
