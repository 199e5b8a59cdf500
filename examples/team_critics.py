"""Train drones with critics of the whole team, by VDN, QMIX or MADDPG, in one file.

All drones share one network and act on their own observations. `vdn` has discrete actions: the Q
values of a team add up to the value of the team reward (P. Sunehag et al., Value-decomposition
networks, 2017). `qmix` mixes them by a network whose weights depend on all observations (T. Rashid
et al., QMIX: Monotonic value function factorisation, 2018). `maddpg` has velocities as actions, and
a critic with the observations and actions of all drones (R. Lowe et al., Multi-agent actor-critic
for mixed cooperative-competitive environments, 2017). The output folder can be flown without
PyTorch: `--policy FOLDER`.

Run it:

    python examples/team_critics.py vdn
    python examples/team_critics.py qmix
    python examples/team_critics.py maddpg --steps 400000 --seed 1 --out maddpg

Takes 1 to 3 minutes on one core. Needs the extra `sb3`.
"""

import argparse
import copy
import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from safetensors.numpy import save_file
from torch import nn

import bulletuav
from bulletuav.adapters.swarm_features import SwarmFeatures
from bulletuav.policies.neural_network import HIGH, LOW
from bulletuav.policies.run import CONFIG, POLICY, RunConfig
from bulletuav.policies.swarm_features import find_layout

Array = torch.Tensor
Look = Callable[[int, Callable[[Path], None]], None]
# Smaller than the default weights of the task, so that returns are of the order of 1
WEIGHTS = {"progress": 0.1, "goal": 1.0, "conflict": -4.0, "warning": -0.1, "collision": -4.0}
WEIGHTS |= {"out_of_bounds": -1.0, "energy": -0.0002, "time": -0.01}


class Plan(NamedTuple):
    """Training plan: the task, its options, and settings of the algorithm."""

    task: str
    options: dict[str, Any]
    worlds: int = 32
    steps: int = 300_000  # total decisions of all drones
    kept: int = 200_000  # decisions in the replay buffer
    start: int = 10_000  # random decisions before training starts
    batch: int = 128  # decisions of whole worlds in a minibatch
    updates: int = 2  # after each decision of all worlds
    rate: float = 1e-3
    gamma: float = 0.98
    tau: float = 0.005  # rate of target updates
    noise: float = 0.2  # of continuous actions
    explore: float = 0.4  # fraction of the training until 5 % of the actions are random


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=form)
    parser.add_argument("algorithm", choices=LEARNERS)
    parser.add_argument("--task", default="crossing")
    parser.add_argument("--steps", type=int, default=300_000, help="decisions of all drones")
    parser.add_argument("--episodes", type=int, default=100, help="episodes of the evaluation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("team_critics"), help="output folder")
    return parser.parse_args()


def layers(*sizes: int) -> nn.Sequential:
    """Return dense layers with ReLU between them."""
    pairs = itertools.pairwise(sizes)
    parts = [part for before, after in pairs for part in (nn.Linear(before, after), nn.ReLU())]
    return nn.Sequential(*parts[:-1])


def shrink(seen: Array) -> Array:
    """Return observations of similar size, for critics."""
    return seen.sign() * seen.abs().log1p()


class Actor(nn.Module):
    """Actor or Q network of a drone, with the parameter names of `dqn` and `ddpg`."""

    def __init__(self, env: Any, outputs: int, head: str) -> None:
        super().__init__()
        layout = find_layout(env.observation_labels)
        self.features_extractor = SwarmFeatures(env.observation_space, layout)
        self.head = head
        self.add_module(head, layers(self.features_extractor.features_dim, 64, 64, outputs))

    def forward(self, seen: Array) -> Array:
        """Return outputs (..., outputs) of observations (..., D)."""
        known = self.features_extractor(seen.reshape(-1, seen.shape[-1]))
        return self.get_submodule(self.head)(known).reshape(*seen.shape[:-1], -1)


class Sum(nn.Module):
    """Value of a team: the sum of the values of its drones that fly."""

    def __init__(self, env: Any) -> None:
        super().__init__()
        team = torch.from_numpy(np.asarray(env.aviary.task.team))
        self.teams = nn.functional.one_hot(team).float().T  # (teams, N)

    def forward(self, value: Array, flies: Array, seen: Array) -> Array:
        """Return values (B, teams) for values (B, N) of drones and observations (B, N, D)."""
        return (value * flies) @ self.teams.T


class Mixer(Sum):
    """Value of a team: rises with that of each drone, as no weight of this network is negative."""

    def __init__(self, env: Any, hidden: int = 32) -> None:
        super().__init__(env)
        teams, drones = self.teams.shape
        state = drones * len(env.observation_labels) + teams
        self.shape = (drones, hidden)
        self.weights, self.biases = layers(state, drones * hidden), layers(state, hidden)
        self.last_weights, self.last_bias = layers(state, hidden), layers(state, hidden, 1)

    def forward(self, value: Array, flies: Array, seen: Array) -> Array:
        """Return values (B, teams) for values (B, N) of drones and observations (B, N, D)."""
        known = (shrink(seen) * flies.unsqueeze(-1)).flatten(1)
        each = torch.eye(len(self.teams)).expand(len(seen), -1, -1)
        state = torch.cat([known.unsqueeze(1).expand(-1, len(self.teams), -1), each], -1)
        own = flies.unsqueeze(1) * self.teams  # (B, teams, N)
        weights = self.weights(state).abs().unflatten(-1, self.shape)
        mixed = ((value.unsqueeze(1) * own).unsqueeze(-1) * weights).sum(-2) + self.biases(state)
        mixed = nn.functional.elu(mixed) * self.last_weights(state).abs()
        # A team of which no drone flies has no value
        return (mixed.sum(-1) + self.last_bias(state).squeeze(-1)) * own.amax(-1)


class Vdn:
    """Value decomposition: Q values that add up over a team, with double Q-learning."""

    form, action, mixer = "dqn", "discrete", Sum

    def __init__(self, env: Any, plan: Plan) -> None:
        self._choices = int(env.action_space.n)
        self.actor = Actor(env, self._choices, "q_net")
        self._nets = nn.ModuleList([self.actor, self.mixer(env)])
        self._targets = copy.deepcopy(self._nets)
        self.plan = plan
        self._optimiser = torch.optim.Adam(self._nets.parameters(), plan.rate)

    def random(self, seen: Array) -> Array:
        """Choose at random."""
        return torch.randint(self._choices, (*seen.shape[:-1], 1)).float()

    @torch.no_grad()
    def choose(self, seen: Array, done: float) -> Array:
        """Return epsilon-greedy actions; `done` is the finished fraction of the training."""
        best = self.actor(seen).argmax(-1, keepdim=True).float()
        share = max(0.05, 1 - 0.95 * done / self.plan.explore)
        return torch.where(torch.rand(best.shape) < share, self.random(seen), best)

    def learn(self, seen: Array, action: Array, results: Array, after: Array) -> None:
        """Update the Q values, and the network that mixes them."""
        reward, flown, goes_on = results.unbind(-1)
        (actor, mixer), (target_actor, target_mixer) = self._nets, self._targets
        value = actor(seen).gather(-1, action.long()).squeeze(-1)
        with torch.no_grad():
            best = actor(after).argmax(-1, keepdim=True)
            later = target_actor(after).gather(-1, best).squeeze(-1)
            goal = reward @ mixer.teams.T + self.plan.gamma * target_mixer(later, goes_on, after)
        error = nn.functional.smooth_l1_loss(mixer(value, flown, seen), goal)
        descend(self._optimiser, error, self._nets)
        follow(self._targets, self._nets, self.plan.tau)

    def arrays(self) -> dict[str, Array]:
        """Return the parameters under the names of stable-baselines3."""
        return {f"q_net.{name}": part for name, part in self.actor.state_dict().items()}


class Qmix(Vdn):
    """QMIX: Q values that a network mixes, with double Q-learning."""

    mixer = Mixer


class Maddpg:
    """One actor for all drones, and a critic with the observations and actions of all drones."""

    form, action = "ddpg", "velocity"

    def __init__(self, env: Any, plan: Plan) -> None:
        drones, self._size = env.num_drones, env.action_space.shape[0]
        self.actor = Actor(env, self._size, "mu")
        width = drones * (len(env.observation_labels) + self._size + 1)
        self.critic = layers(width, 128, 128, 1)
        self.targets = copy.deepcopy((self.actor, self.critic))
        self.plan = plan
        self._optimisers = [
            torch.optim.Adam(net.parameters(), plan.rate) for net in (self.actor, self.critic)
        ]
        # In the input of its critic each drone comes first, followed by the others in order
        self._order = (torch.arange(drones)[:, None] + torch.arange(drones)) % drones

    def random(self, seen: Array) -> Array:
        """Choose at random."""
        return 2 * torch.rand(*seen.shape[:-1], self._size) - 1

    @torch.no_grad()
    def choose(self, seen: Array, done: float) -> Array:
        """Return actions of the actor with noise."""
        best = torch.tanh(self.actor(seen))
        return (best + self.plan.noise * torch.randn_like(best)).clamp(-1, 1)

    def _joint(self, seen: Array, action: Array, flown: Array) -> Array:
        """Return the joint observations and actions (B, N, K), the input of the critic."""
        parts = torch.cat([shrink(seen), action, torch.ones_like(flown)], -1)
        return (parts * flown)[:, self._order].flatten(2)

    def learn(self, seen: Array, action: Array, results: Array, after: Array) -> None:
        """Update the critic, and then the actor."""
        reward, flown, goes_on = results.unsqueeze(-1).unbind(-2)
        actor, critic = self.targets
        with torch.no_grad():
            joint = self._joint(after, torch.tanh(actor(after)), goes_on)
            goal = reward + self.plan.gamma * goes_on * critic(joint)
        joint = self._joint(seen, action, flown)
        error = (self.critic(joint) - goal).square() * flown
        # Mean over active drones, of which there may be none
        count = flown.sum().clamp(min=1)
        descend(self._optimisers[1], error.sum() / count, self.critic)
        # Replace the drone's own action by that of the actor; others keep the recorded actions
        raw = self.actor(seen)
        own = slice(seen.shape[-1], seen.shape[-1] + self._size)
        joint = torch.cat([joint[..., : own.start], torch.tanh(raw), joint[..., own.stop :]], -1)
        gain = (self.critic(joint) - 1e-3 * raw.square().mean(-1, keepdim=True)) * flown
        descend(self._optimisers[0], -gain.sum() / count, self.actor)
        for target, net in zip(self.targets, (self.actor, self.critic), strict=True):
            follow(target, net, self.plan.tau)

    def arrays(self) -> dict[str, Array]:
        """Return the parameters under the names of stable-baselines3, and the action bounds."""
        ones = torch.ones(self._size)
        named = {f"actor.{name}": part for name, part in self.actor.state_dict().items()}
        return {**named, LOW: -ones, HIGH: ones}


LEARNERS = {"vdn": Vdn, "qmix": Qmix, "maddpg": Maddpg}


def descend(optimiser: torch.optim.Optimizer, loss: Array, net: nn.Module) -> None:
    """Take one optimiser step, with clipped gradients."""
    optimiser.zero_grad()
    loss.backward()
    nn.utils.clip_grad_norm_(net.parameters(), 1.0)
    optimiser.step()


@torch.no_grad()
def follow(target: nn.Module, net: nn.Module, share: float) -> None:
    """Move a target network towards a network."""
    for kept, new in zip(target.parameters(), net.parameters(), strict=True):
        kept.lerp_(new, share)


class Replay:
    """Ring buffer of the last decisions of all worlds."""

    def __init__(self, length: int) -> None:
        self._length, self._count = length, 0
        self._parts: list[Array] = []

    def add(self, *parts: Array) -> None:
        """Store observation, action and results of a decision, each (W, N, ...)."""
        if not self._parts:
            self._parts = [torch.zeros(self._length, *part.shape) for part in parts]
        for kept, part in zip(self._parts, parts, strict=True):
            kept[self._count % self._length] = part
        self._count += 1

    def sample(self, count: int) -> list[Array]:
        """Sample decisions of whole worlds; the next observation is the last entry."""
        # The newest decision has no next observation yet
        ages = torch.randint(2, min(self._count, self._length) + 1, (count,))
        world = torch.randint(self._parts[0].shape[1], (count,))
        row = (self._count - ages) % self._length
        chosen = [part[row, world] for part in self._parts]
        return [*chosen, self._parts[0][(row + 1) % self._length, world]]


def train(
    name: str, plan: Plan, seed: int, folder: Path, look: Look = lambda steps, keep: None
) -> None:
    """Train and save; `look` is called with the number of decisions and a save function."""
    torch.manual_seed(seed)
    plan = plan._replace(options={"action": LEARNERS[name].action, **plan.options})
    env = bulletuav.batch_env(plan.task, plan.worlds, **plan.options)
    each = env.num_envs * env.num_drones
    shape = (env.num_envs, env.num_drones, *env.action_space.shape)
    learner = LEARNERS[name](env, plan)
    write_settings(name, plan, seed, folder)
    replay, seen = Replay(plan.kept // each), torch.from_numpy(env.reset(seed=seed)[0])
    for steps in range(each, plan.steps + each, each):
        # The first decision has no next observation yet
        is_random = steps < max(plan.start, 2 * each)
        action = learner.random(seen) if is_random else learner.choose(seen, steps / plan.steps)
        flown = env.alive
        # A world whose episode is over is reset in the next step, in which no drone flies
        after, reward, ended, _, _ = env.step(action.reshape(shape).numpy())
        replay.add(seen, action, torch.from_numpy(np.stack([reward, flown, flown & ~ended], -1)))
        seen = torch.from_numpy(after)
        for _ in range(0 if is_random else plan.updates):
            learner.learn(*replay.sample(plan.batch))
        look(steps, lambda place: save(learner.arrays(), place))
    env.close()
    save(learner.arrays(), folder)


def save(arrays: dict[str, Array], folder: Path) -> None:
    """Write the policy in the format of `bulletuav train`."""
    folder.mkdir(parents=True, exist_ok=True)
    save_file({name: part.numpy() for name, part in arrays.items()}, folder / POLICY)


def write_settings(name: str, plan: Plan, seed: int, folder: Path) -> None:
    """Write the settings of the policy to run.yaml, as `bulletuav train` does."""
    model = {"features": "swarm", "policy_kwargs": {"net_arch": [64, 64]}}
    form = LEARNERS[name].form
    config = RunConfig(plan.task, form, seed, plan.steps, plan.worlds, plan.options, model=model)
    folder.mkdir(parents=True, exist_ok=True)
    source = f"`examples/team_critics.py {name}`, whose network has the form of `algo`"
    text = config.text("algo", "seed", "steps", "worlds", "options", "model", "constants")
    (folder / CONFIG).write_text(f"# Learned by {source}.\n{text}")


def main() -> None:
    """Train, and evaluate the saved policy."""
    args = parse_arguments()
    torch.set_num_threads(1)
    plan = Plan(args.task, {"dynamics": "point_mass", "weights": WEIGHTS}, steps=args.steps)
    train(args.algorithm, plan, args.seed, args.out)
    result = bulletuav.evaluate(args.task, args.out, args.episodes, 1000, dynamics="point_mass")
    for metric in ("drone_success", "conflict", "return"):
        found = result.estimates()[metric]
        print(f"{metric} {found.mean:.3f} ({found.low:.3f} to {found.high:.3f})")


if __name__ == "__main__":
    main()
