"""Train IPPO of skrl in the parallel environment."""

import dataclasses

import gymnasium
import torch
from library import make_env, report
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.multi_agents.torch.ippo import IPPO, IPPO_CFG
from skrl.trainers.torch import SequentialTrainer
from torch import nn

STEPS = 256


class Actor(GaussianMixin, Model):
    """Gaussian policy."""

    def __init__(self, observation_space, action_space, device):
        Model.__init__(
            self, observation_space=observation_space, action_space=action_space, device=device
        )
        GaussianMixin.__init__(self)
        self.net = nn.Sequential(
            nn.Linear(self.num_observations, 64), nn.Tanh(), nn.Linear(64, self.num_actions)
        )
        self.log_std = nn.Parameter(torch.zeros(self.num_actions))

    def compute(self, inputs, role):
        """Return means and logarithms of standard deviations."""
        return self.net(inputs["observations"]), {"log_std": self.log_std}


class Critic(DeterministicMixin, Model):
    """Value."""

    def __init__(self, observation_space, action_space, device):
        Model.__init__(
            self, observation_space=observation_space, action_space=action_space, device=device
        )
        DeterministicMixin.__init__(self)
        self.net = nn.Sequential(nn.Linear(self.num_observations, 64), nn.Tanh(), nn.Linear(64, 1))

    def compute(self, inputs, role):
        """Return values."""
        return self.net(inputs["observations"]), {}


def empty_settings(agents):
    """Return the empty settings by agent: skrl 2.1.1 rejects its own defaults of them."""
    names = [field.name for field in dataclasses.fields(IPPO_CFG)]
    plain = IPPO_CFG()
    return {name: {agent: {} for agent in agents} for name in names if getattr(plain, name) == {}}


def collect():
    """Return a function that flies a decision by the wrapper."""
    env = wrap_env(make_env(), wrapper="pettingzoo")
    env.reset()
    actions = {
        agent: torch.as_tensor(env.action_space(agent).sample()).unsqueeze(0)
        for agent in env.possible_agents
    }

    def step():
        _, _, terminated, truncated, _ = env.step(actions)
        if all(bool(terminated[one] or truncated[one]) for one in terminated):
            env.reset()

    return step


def train():
    """Train, and return the number of decisions."""
    env = wrap_env(make_env(), wrapper="pettingzoo")
    spaces = {agent: env.observation_space(agent) for agent in env.possible_agents}
    acts = {agent: env.action_space(agent) for agent in env.possible_agents}
    assert isinstance(next(iter(spaces.values())), gymnasium.spaces.Box)
    models = {
        agent: {
            "policy": Actor(spaces[agent], acts[agent], env.device),
            "value": Critic(spaces[agent], acts[agent], env.device),
        }
        for agent in env.possible_agents
    }
    memories = {
        agent: RandomMemory(memory_size=64, num_envs=env.num_envs, device=env.device)
        for agent in env.possible_agents
    }
    learner = IPPO(
        possible_agents=env.possible_agents,
        models=models,
        memories=memories,
        observation_spaces=spaces,
        state_spaces=env.state_spaces,
        action_spaces=acts,
        device=env.device,
        cfg=IPPO_CFG(rollouts=64, **empty_settings(env.possible_agents)),
    )
    before = [part.clone() for part in models["drone_0"]["policy"].parameters()]
    trainer = SequentialTrainer(
        env=env, agents=learner, cfg={"timesteps": STEPS, "disable_progressbar": True}
    )
    trainer.train()
    after = models["drone_0"]["policy"].parameters()
    assert any(not torch.equal(old, new) for old, new in zip(before, after, strict=True))
    return STEPS * len(env.possible_agents)


if __name__ == "__main__":
    glue = [make_env, empty_settings]
    report(["skrl", "torch"], "IPPO, parallel environment", glue, 1, collect, train)
