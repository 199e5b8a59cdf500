"""PPO in one page: PyTorch over `batch_env`, with one policy for all drones.

`collect` flies all worlds by the present policy and estimates how much better than expected each
action was; `learn` makes better actions more likely. With `--critic state` the critic also sees the
state of the whole world (MAPPO). Settings are those of `bulletuav train --algo fast_ppo`, which is
the same algorithm in compiled kernels, and faster. It learns tasks with vectors and continuous
actions, in their first stage, with the usual constants of PPO and rewards of each drone's own. The
output folder flies without PyTorch: `--policy FOLDER`.

Run it:

    python examples/fast_ppo.py crossing
    python examples/fast_ppo.py hover

Takes a minute on one core. Needs the extra `sb3`.

J. Schulman et al., Proximal policy optimization algorithms (2017).
"""

import argparse
import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.numpy import save_file
from torch import nn

import bulletuav
from bulletuav.adapters.swarm_features import SwarmFeatures
from bulletuav.policies.neural_network import HIGH, LOW
from bulletuav.policies.run import CONFIG, POLICY, RunConfig
from bulletuav.policies.swarm_features import find_layout
from bulletuav.training.schedules import default_run

CLIP, LAMBDA, VALUE, MAX_NORM = 0.2, 0.95, 0.5, 0.5  # the usual constants of PPO


def hidden(inputs: int, widths: list[int]) -> nn.Sequential:
    """Return hidden layers with tanh and orthogonal weights."""
    layers = [nn.Linear(*pair) for pair in itertools.pairwise([inputs, *widths])]
    for layer in layers:
        nn.init.orthogonal_(layer.weight, 2**0.5)
    return nn.Sequential(*(part for layer in layers for part in (layer, nn.Tanh())))


class Agent(nn.Module):
    """Actor and critic of all drones, with the parameter names of stable-baselines3."""

    def __init__(self, features: Any, actions: int, config: RunConfig, state: int = 0) -> None:
        super().__init__()
        policy, inputs = config.settings["policy_kwargs"], features.features_dim
        self.features_extractor, widths = features, policy["net_arch"]
        networks = {
            "policy_net": hidden(inputs, widths),
            "value_net": hidden(inputs + state, widths),
        }
        self.mlp_extractor = nn.ModuleDict(networks)
        self.action_net, self.value_net = nn.Linear(widths[-1], actions), nn.Linear(widths[-1], 1)
        nn.init.orthogonal_(self.action_net.weight, 0.01)
        nn.init.orthogonal_(self.value_net.weight, 1.0)
        self.log_std = nn.Parameter(torch.full((actions,), float(policy["log_std_init"])))

    def forward(self, seen: Any, state: Any) -> tuple[torch.distributions.Normal, torch.Tensor]:
        """Return the distributions of actions (M, A), and values (M,)."""
        known = self.features_extractor(seen)
        mean = self.action_net(self.mlp_extractor["policy_net"](known))
        all_known = torch.cat([known, state.sign() * state.abs().log1p()], 1)
        value = self.value_net(self.mlp_extractor["value_net"](all_known))[:, 0]
        return torch.distributions.Normal(mean, self.log_std.exp(), validate_args=False), value


class Worlds:
    """Worlds of `batch_env`, whose drones are the rows of arrays."""

    def __init__(self, config: RunConfig, central: bool = False) -> None:
        self.env = bulletuav.batch_env(config.task, config.worlds, **config.options)
        self._central = central
        self.seen = self.rows(self.env.reset(seed=config.seed)[0])

    def rows(self, array: Any) -> torch.Tensor:
        """Reshape an array (W, N, ...) to (M, ...)."""
        rows = np.reshape(array, (self.env.num_envs * self.env.num_drones, -1))
        return torch.from_numpy(rows.astype(np.float32))

    def state(self) -> torch.Tensor:
        """Return the state that the critic sees, (M, K); K = 0 without a central critic."""
        if not self._central:
            return torch.zeros(len(self.seen), 0)
        return torch.from_numpy(self.env.state()).repeat_interleave(self.env.num_drones, 0)

    def step(self, actions: torch.Tensor) -> torch.Tensor:
        """Step all worlds; return (4, M): flown, reward, terminated, done."""
        flown = self.env.alive.copy()
        actions = actions.clamp(-1, 1).reshape(*flown.shape, -1)
        # A world whose episode is over is reset in the next step, in which no drone flies
        seen, reward, ended, cut, _ = self.env.step(actions.numpy())
        self.seen = self.rows(seen)
        return torch.stack([self.rows(one)[:, 0] for one in (flown, reward, ended, ended | cut)])


@torch.no_grad()
def collect(worlds: Any, agent: Agent, settings: dict[str, Any]) -> list[torch.Tensor]:
    """Collect a rollout: observation, state, action, log density, advantage and return."""
    decisions, gamma = settings["n_steps"], settings["gamma"]
    rows, values, results = [], [], []
    for _ in range(decisions):
        seen, state = worlds.seen, worlds.state()
        choice, value = agent(seen, state)
        action = choice.sample()
        rows.append((seen, state, action, choice.log_prob(action).sum(1)))
        values.append(value)
        results.append(worlds.step(action))
    values.append(agent(worlds.seen, worlds.state())[1])
    flown, reward, ended, done = torch.stack(results, 1)
    advantage, after = torch.zeros_like(reward), torch.zeros_like(values[0])
    for t in reversed(range(decisions)):
        # Generalised advantage estimation, which does not cross the end of an episode
        error = reward[t] + gamma * (1 - ended[t]) * values[t + 1] - values[t]
        after = advantage[t] = flown[t] * (error + gamma * LAMBDA * (1 - done[t]) * after)
    parts = [torch.stack(one) for one in zip(*rows, strict=True)]
    parts += [advantage, advantage + torch.stack(values[:-1])]
    return [part[flown.bool()] for part in parts]


def learn(agent: Agent, optimizer: Any, rows: list[torch.Tensor], settings: Any) -> None:
    """Update actor and critic on a rollout."""
    count = len(rows[0])
    batches = max(1, round(count / settings["batch_size"]))
    for _ in range(settings["n_epochs"]):
        for chosen in torch.randperm(count).tensor_split(batches):
            seen, state, action, before, gain, goal = (part[chosen] for part in rows)
            choice, value = agent(seen, state)
            gain = (gain - gain.mean()) / (gain.std(correction=0) + 1e-8)
            ratio = (choice.log_prob(action).sum(1) - before).exp()
            loss = -torch.minimum(ratio * gain, ratio.clamp(1 - CLIP, 1 + CLIP) * gain).mean()
            loss = loss + VALUE * (value - goal).square().mean()
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), MAX_NORM)
            optimizer.step()


def train(agent: Agent, worlds: Any, config: RunConfig) -> None:
    """Alternate both until all steps are done, while the learning rate falls."""
    settings = config.settings
    first, last = settings["learning_rate"]
    optimizer = torch.optim.Adam(agent.parameters(), first, eps=1e-5)
    each = settings["n_steps"] * len(worlds.seen)
    rounds = max(1, config.steps // each)
    for k in range(rounds):
        optimizer.param_groups[0]["lr"] = first + (last - first) * k / rounds
        rows = collect(worlds, agent, settings)
        learn(agent, optimizer, rows, settings)
        if k % 10 == 0 or k == rounds - 1:
            print(f"{(k + 1) * each:9d} decisions: mean return {rows[-1].mean().item():.3f}")


def save(agent: Agent, config: RunConfig, folder: Path, by: str) -> None:
    """Write policy and settings in the format of `bulletuav train`."""
    folder.mkdir(parents=True, exist_ok=True)
    arrays = {name: part.numpy() for name, part in agent.state_dict().items()}
    # Actor and critic share their features, which stable-baselines3 stores three times
    shared = [name for name in arrays if name.startswith("features_extractor")]
    arrays |= {f"{net}_{name}": arrays[name].copy() for net in ("pi", "vf") for name in shared}
    ones = np.ones_like(arrays["log_std"])
    save_file({**arrays, LOW: -ones, HIGH: ones}, folder / POLICY)
    text = config.text("algo", "seed", "steps", "options", "model", "constants")
    (folder / CONFIG).write_text(f"# Learned by `examples/{by}.py`.\n{text}")


def swarm_features(env: Any, config: RunConfig) -> SwarmFeatures:
    """Return features of vectors, which do not depend on number and order of other drones."""
    arguments = config.settings["policy_kwargs"].get("features_extractor_kwargs", {})
    return SwarmFeatures(env.observation_space, find_layout(env.observation_labels), **arguments)


def main() -> None:
    """Train, save, and evaluate the saved policy."""
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=form)
    parser.add_argument("task", nargs="?", default="crossing", help="a task (crossing)")
    parser.add_argument("--critic", choices=("own", "state"), default="own")
    parser.add_argument("--steps", type=int, help="decisions of all drones")
    parser.add_argument("--episodes", type=int, default=50, help="episodes of the evaluation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("fast_ppo"), help="folder for the policy")
    args = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(args.seed)
    config = default_run(args.task, "fast_ppo")
    config = replace(config, seed=args.seed, steps=args.steps or config.steps)
    worlds = Worlds(config, args.critic == "state")
    actions, state = worlds.env.action_space.shape[0], worlds.state().shape[1]
    agent = Agent(swarm_features(worlds.env, config), actions, config, state)
    train(agent, worlds, config)
    save(agent, config, args.out, "fast_ppo")
    result = bulletuav.evaluate(args.task, args.out, args.episodes, 1000, **config.evaluated)
    for name in ("success", "conflict"):
        found = result.estimates()[name]
        print(f"in bullet: {name} {found.mean:.3f} ({found.low:.3f} to {found.high:.3f})")


if __name__ == "__main__":
    main()
