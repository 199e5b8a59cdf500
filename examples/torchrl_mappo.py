"""Train four drones with MAPPO in TorchRL to cross an airspace.

The environment is a TorchRL environment: worlds are the batch, and the drones are a group of
agents. The loop is TorchRL's multi-agent PPO tutorial in plain PyTorch. All drones share one
policy, which uses the observation of each drone. The critic also uses the state of the whole world
(MAPPO), or only the observation (IPPO). Drones leave at their goals: "mask" marks the decisions of
active drones, and other decisions are dropped. Training uses `point_mass`, which is fast; the
evaluation uses `bullet` with all forces, and compares with a random policy.

Run it:

    python examples/torchrl_mappo.py
    python examples/torchrl_mappo.py --critic own --steps 500000 --seed 1 --out ippo

Takes about 2 minutes on one core. Needs the extra `torchrl`.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn
from torchrl.objectives.value.functional import vec_generalized_advantage_estimate

import bulletuav
from bulletuav.adapters.torchrl import DroneTensorEnv

# Smaller than the default weights of the task, so that returns are of the order of 1
WEIGHTS = {
    "progress": 0.05,
    "goal": 2.0,
    "conflict": -3.0,
    "warning": -0.1,
    "collision": -5.0,
    "out_of_bounds": -5.0,
    "energy": -0.0005,
    "time": -0.02,
}
DIFFICULTY = "easy"
GROUP = "agents"  # TorchRL's name for one group of all agents
WORLDS, DECISIONS, BATCH, EPOCHS = 32, 64, 2048, 5
GAMMA, LAMBDA, CLIP, RATE = 0.99, 0.95, 0.2, 1e-3


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--steps", type=int, default=2_000_000, help="total decisions of all drones"
    )
    parser.add_argument("--critic", choices=("state", "own"), default="state")
    parser.add_argument("--episodes", type=int, default=50, help="episodes of each evaluation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--out", type=Path, default=Path("torchrl_mappo"), help="folder for the policy"
    )
    return parser.parse_args()


def network(inputs: int, outputs: int, gain: float) -> nn.Sequential:
    """Return a small network; the gain scales its initial outputs."""
    layers = [nn.Linear(inputs, 64), nn.Linear(64, 64), nn.Linear(64, outputs)]
    for layer, scale in zip(layers, (2**0.5, 2**0.5, gain), strict=True):
        nn.init.orthogonal_(layer.weight, scale)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(layers[0], nn.Tanh(), layers[1], nn.Tanh(), layers[2])


def compress(numbers: torch.Tensor) -> torch.Tensor:
    """Return the symlog of numbers, which compresses large distances."""
    return torch.sign(numbers) * torch.log1p(torch.abs(numbers))


class Agent(nn.Module):
    """Actor and critic shared by all drones."""

    def __init__(self, env: DroneTensorEnv, central: bool) -> None:
        super().__init__()
        seen = env.observation_spec[GROUP, "observation"].shape[-1]
        state_size = env.observation_spec["state"].shape[-1] if central else 0
        size = env.full_action_spec[GROUP, "action"].shape[-1]
        self.central = central
        self.actor, self.critic = network(seen, size, 0.01), network(seen + state_size, 1, 1.0)
        self.log_std = nn.Parameter(torch.full((size,), -1.0))

    def policy(self, observation: torch.Tensor) -> torch.distributions.Independent:
        """Return the distribution of actions."""
        mean = self.actor(compress(observation))
        normal = torch.distributions.Normal(mean, self.log_std.exp())
        return torch.distributions.Independent(normal, 1)

    def critic_input(self, tensors: Any) -> torch.Tensor:
        """Return the inputs of the critic for each drone."""
        seen = tensors[GROUP, "observation"]
        if self.central:
            state = tensors["state"].unsqueeze(-2)
            seen = torch.cat([seen, state.expand(*seen.shape[:-1], -1)], dim=-1)
        return compress(seen)


@torch.no_grad()
def collect(env: DroneTensorEnv, agent: Agent, now: Any) -> tuple[Any, Any]:
    """Collect a rollout (W, T); return it and the next state of the worlds."""
    flown = []
    for _ in range(DECISIONS):
        choice = agent.policy(now[GROUP, "observation"])
        action = choice.sample()
        now[GROUP, "action"], now[GROUP, "log_prob"] = action, choice.log_prob(action)
        step, now = env.step_and_maybe_reset(now)
        flown.append(step)
    return torch.stack(flown, dim=1), now


@torch.no_grad()
def advantages(agent: Agent, flight: Any) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return advantages, value targets, and inputs of the critic."""
    inputs, after = agent.critic_input(flight), agent.critic_input(flight["next"])
    ends = [flight["next", GROUP, name] for name in ("reward", "done", "terminated")]
    # The axes are (W, T, N, 1): time is axis 1
    advantage, target = vec_generalized_advantage_estimate(
        GAMMA, LAMBDA, agent.critic(inputs), agent.critic(after), *ends, time_dim=1
    )
    return advantage.squeeze(-1), target.squeeze(-1), inputs


def learn(agent: Agent, optimiser: torch.optim.Optimizer, flight: Any) -> None:
    """Update policy and critic on a rollout by PPO."""
    advantage, target, inputs = advantages(agent, flight)
    lived = flight[GROUP, "mask"]
    names = ("observation", "action", "log_prob")
    rows = [flight[GROUP, name][lived] for name in names]
    rows += [part[lived] for part in (advantage, target, inputs)]
    for _ in range(EPOCHS):
        for chosen in torch.randperm(len(rows[0])).split(BATCH):
            seen, action, before, gain, value, known = (part[chosen] for part in rows)
            gain = (gain - gain.mean()) / (gain.std(correction=0) + 1e-8)
            ratio = (agent.policy(seen).log_prob(action) - before).exp()
            clipped = ratio.clamp(1 - CLIP, 1 + CLIP)
            loss = -torch.minimum(ratio * gain, clipped * gain).mean()
            loss = loss + 0.5 * (agent.critic(known).squeeze(-1) - value).square().mean()
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
            optimiser.step()


def train(steps: int, central: bool, seed: int) -> Agent:
    """Train in `point_mass`, and print the mean reward of decisions."""
    env = DroneTensorEnv(
        "crossing",
        WORLDS,
        group_map="ALL_IN_ONE_GROUP",
        return_state=central,
        dynamics="point_mass",
        difficulty=DIFFICULTY,
        weights=WEIGHTS,
    )
    torch.manual_seed(seed)
    env.set_seed(seed)
    agent = Agent(env, central)
    optimiser = torch.optim.Adam(agent.parameters(), RATE, eps=1e-5)
    rounds = max(1, steps // (WORLDS * DECISIONS * env.n_agents))
    now = env.reset()
    for k in range(rounds):
        optimiser.param_groups[0]["lr"] = RATE * (1 - k / rounds)
        flight, now = collect(env, agent, now)
        learn(agent, optimiser, flight)
        if k % 20 == 0 or k == rounds - 1:
            lived = flight[GROUP, "mask"]
            reward = flight["next", GROUP, "reward"].squeeze(-1)[lived].mean().item()
            decisions = (k + 1) * WORLDS * DECISIONS * env.n_agents
            print(f"{decisions:9d} decisions: mean reward {reward:.3f}")
    env.close()
    return agent


def as_policy(agent: Agent) -> Callable[[np.ndarray], np.ndarray]:
    """Return the policy as a function from observations (M, D) to actions (M, A)."""

    def mappo(observations: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            return agent.actor(compress(torch.from_numpy(observations))).clamp(-1, 1).numpy()

    return mappo


def main() -> None:
    """Train, save, and compare with a random policy."""
    args = parse_arguments()
    torch.set_num_threads(1)  # networks this small are no faster on more
    begin = time.perf_counter()
    agent = train(args.steps, args.critic == "state", args.seed)
    print(f"trained for {time.perf_counter() - begin:.0f} s")
    args.out.mkdir(parents=True, exist_ok=True)
    torch.save(agent.state_dict(), args.out / "agent.pt")
    for name, policy in {"trained": as_policy(agent), "random": "random"}.items():
        result = bulletuav.evaluate(
            "crossing", policy, episodes=args.episodes, seed=1000, difficulty=DIFFICULTY
        )
        for metric in ("drone_success", "conflicts"):
            found = result.estimates()[metric]
            print(
                f"{name} in bullet: {metric} {found.mean:.3f} ({found.low:.3f} to {found.high:.3f})"
            )


if __name__ == "__main__":
    main()
