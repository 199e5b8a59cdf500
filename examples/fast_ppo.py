"""Train with PPO in one file, as fast as one core can: hover in a minute, crossing in two.

The training loop is plain PyTorch over `batch_env`, whose step is compiled. One policy is trained
on batches of worlds of several sizes: `SwarmFeatures` are invariant to the number and order of
other drones. With `--critic state` the critic sees the state of the whole world (MAPPO), otherwise
the observation of the drone (IPPO). The output folder flies without PyTorch: `--policy FOLDER`.

`hover` controls the rotors of a Crazyflie. `crossing` has 8 drones, `swarm` 8 to 64 drones that
cross or converge, and `race` two drones that fly laps through gates; these use `point_mass`.

Run it:

    python examples/fast_ppo.py crossing
    python examples/fast_ppo.py hover --seed 1 --out hover-1

Takes 1 to 5 minutes on one core. `hover` may need another seed. Needs the extra `sb3`.
"""

import argparse
import math
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from safetensors.numpy import save_file
from torch import nn

import bulletuav
from bulletuav.adapters.swarm_features import SwarmFeatures
from bulletuav.policies.neural_network import HIGH, LOW
from bulletuav.policies.run import CHECKPOINTS, CONFIG, POLICY, RunConfig
from bulletuav.policies.swarm_features import find_layout

# Smaller than the default weights of the task, so that returns are of the order of 1
PAID = {"progress": 0.05, "goal": 2.0, "energy": -0.0005, "time": -0.02}
TRAFFIC = {**PAID, "conflict": -6.0, "warning": -0.1, "collision": -5.0, "out_of_bounds": -5.0}
SEEN = ["velocity", "goal", "intruders"]  # no absolute position
CLIP, LAMBDA, VALUE = 0.2, 0.95, 0.5
MEDIUM = {"difficulty": "medium"}


class Plan(NamedTuple):
    """Training plan: the task, its options, batches of worlds, and settings of PPO."""

    task: str
    options: dict[str, Any]
    batches: list[dict[str, Any]]
    steps: int  # total decisions
    decisions: int = 64  # per rollout
    minibatch: int = 2048
    epochs: int = 4
    rate: float = 1e-3
    gamma: float = 0.99
    log_std: float = -1.0
    scale: float = 1.0
    decay: float = 1.0  # final fraction of the training over which the learning rate falls
    evaluation: dict[str, Any] = MEDIUM  # options of the environment in the evaluation
    width: int = 64  # of hidden layers
    features: str = "swarm"  # as in run.yaml


POINTS = {"dynamics": "point_mass"}  # which are fast
CROSSING = {"observation": SEEN, "num_neighbours": 4, "weights": TRAFFIC}
STAY = {"alive": 0.2, "holding": 0.5, "distance": -0.3, "speed": -0.05}
HOVER = {**MEDIUM, "weights": STAY}
# A separation of 6.5 m leaves a margin for noise and for situations rare in training
APART = {**CROSSING, "num_neighbours": 6, "d_safe": 6.5}
EIGHT = {"task": "crossing", **POINTS, "num_envs": 32, "num_drones": 8}
# A collision costs two gates. With the default weights it costs a lap, and drones learn to wait.
GATES = {"progress": 0.1, "gate": 1.0, "miss": -0.5, "finish": 2.0, "collision": -2.0}
GATES |= {"out_of_bounds": -2.0, "energy": -0.0002, "time": 0.0}
EASY = {"difficulty": "easy", **POINTS}
LAPS = {"task": "race", "num_envs": 128}
RACE = {**EASY, "weights": GATES}
SIZES = [("crossing", 5, 8), ("crossing", 4, 16), ("crossing", 3, 32), ("crossing", 1, 64)]
SIZES += [("converge", 4, 8), ("converge", 4, 16), ("converge", 2, 32)]
SWARM = [{"task": task, **POINTS, "num_envs": w, "num_drones": n} for task, w, n in SIZES]
ALONE = [{"task": "hover", "num_envs": 128}]
PLANS = {
    "hover": Plan("hover", HOVER, ALONE, 1_200_000, 48, 1536, 5, 2e-3, 0.98, -1.8, 5.0, 0.5),
    "crossing": Plan("crossing", CROSSING, [EIGHT], 1_800_000),
    "swarm": Plan("crossing", APART, SWARM, 6_000_000),
    "race": Plan("race", RACE, [LAPS], 4_000_000, gamma=0.98, evaluation=EASY),
}


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=form)
    parser.add_argument("plan", choices=PLANS)
    parser.add_argument("--steps", type=int, help="total decisions of all drones")
    parser.add_argument("--critic", choices=("own", "state"), default="own")
    parser.add_argument("--episodes", type=int, default=100, help="episodes of the evaluation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("fast_ppo"), help="folder for the policy")
    return parser.parse_args()


class Agent(nn.Module):
    """Actor and critic shared by all drones, with the parameter names of stable-baselines3."""

    def __init__(self, features: Any, size: int, plan: Plan, state_size: int) -> None:
        super().__init__()
        self.features_extractor = features
        inputs = features.features_dim
        actor, critic = (two_layers(count, plan.width) for count in (inputs, inputs + state_size))
        self.mlp_extractor = nn.ModuleDict({"policy_net": actor, "value_net": critic})
        self.action_net = scaled(nn.Linear(plan.width, size), 0.01)
        self.value_net = scaled(nn.Linear(plan.width, 1), 1.0)
        self.log_std = nn.Parameter(torch.full((size,), plan.log_std))

    def forward(self, seen: torch.Tensor, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return mean actions (M, A) and values (M,)."""
        known = self.features_extractor(seen)
        critic_input = torch.cat([known, torch.sign(state) * torch.log1p(state.abs())], 1)
        mean = self.action_net(self.mlp_extractor["policy_net"](known))
        return mean, self.value_net(self.mlp_extractor["value_net"](critic_input)).squeeze(-1)

    def log_prob(self, mean: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        """Return the log probability density of actions."""
        away = (action - mean) * (-self.log_std).exp()
        return (-0.5 * away.square() - self.log_std - 0.5 * math.log(2 * math.pi)).sum(-1)


def scaled(layer: nn.Linear, gain: float) -> nn.Linear:
    """Initialise a layer with orthogonal weights of the given gain."""
    nn.init.orthogonal_(layer.weight, gain)
    return layer


def two_layers(inputs: int, width: int) -> nn.Sequential:
    """Return two hidden layers with tanh."""
    first, second = (scaled(nn.Linear(size, width), 2**0.5) for size in (inputs, width))
    return nn.Sequential(first, nn.Tanh(), second, nn.Tanh())


class Worlds:
    """Batches of worlds, with the drones of all batches as rows of one array."""

    def __init__(self, plan: Plan, seed: int, with_state: bool) -> None:
        self.envs = [bulletuav.batch_env(**plan.options, **one) for one in plan.batches]
        self.sizes = [env.num_envs * env.num_drones for env in self.envs]
        self._ends = np.cumsum(self.sizes)[:-1]
        self._with_state = with_state
        starts = [env.reset(seed=seed + 10_000 * k)[0] for k, env in enumerate(self.envs)]
        self.seen = self._rows(starts)

    def _rows(self, arrays: list[np.ndarray]) -> torch.Tensor:
        """Concatenate arrays (W, N, ...) of all batches to rows (M, ...)."""
        rows = [np.reshape(one, (size, -1)) for one, size in zip(arrays, self.sizes, strict=True)]
        return torch.from_numpy(np.concatenate(rows).astype(np.float32))

    def state(self) -> torch.Tensor:
        """Return the state for the critic, (M, K); K = 0 without state."""
        if not self._with_state:
            return torch.zeros(len(self.seen), 0)
        states = [np.repeat(env.state(), env.num_drones, axis=0) for env in self.envs]
        most = max(one.shape[1] for one in states)  # smaller ones are padded with zeros
        return self._rows([np.pad(one, ((0, 0), (0, most - one.shape[1]))) for one in states])

    def step(self, actions: torch.Tensor) -> torch.Tensor:
        """Step all worlds; return (4, M): flown, reward, terminated, done."""
        flown = self._rows([env.alive for env in self.envs])
        parts = np.split(actions.clamp(-1, 1).numpy(), self._ends)
        shapes = [(env.num_envs, env.num_drones, -1) for env in self.envs]
        flights = zip(self.envs, parts, shapes, strict=True)
        steps = [env.step(part.reshape(shape)) for env, part, shape in flights]
        # A world whose episode is over is reset in the next step, in which no drone flies
        self.seen = self._rows([step[0] for step in steps])
        reward, ended, cut = (self._rows([step[k] for step in steps]) for k in (1, 2, 3))
        return torch.stack([flown, reward, ended, torch.maximum(ended, cut)])[..., 0]


@torch.no_grad()
def collect(worlds: Worlds, agent: Agent, plan: Plan) -> list[torch.Tensor]:
    """Collect a rollout: observation, state, action, log density, advantage and return."""
    seen, states, actions, before, values, results = [], [], [], [], [], []
    for _ in range(plan.decisions):
        seen.append(worlds.seen)
        states.append(worlds.state())
        mean, value = agent(seen[-1], states[-1])
        actions.append(mean + agent.log_std.exp() * torch.randn_like(mean))
        before.append(agent.log_prob(mean, actions[-1]))
        values.append(value)
        results.append(worlds.step(actions[-1]))
    values.append(agent(worlds.seen, worlds.state())[1])
    flown, reward, ended, done = torch.stack(results, 1)
    advantage, after = torch.zeros_like(reward), torch.zeros(len(worlds.seen))
    for t in reversed(range(plan.decisions)):
        # Advantages do not cross the end of an episode
        error = reward[t] + plan.gamma * (1 - ended[t]) * values[t + 1] - values[t]
        after = advantage[t] = flown[t] * (error + plan.gamma * LAMBDA * (1 - done[t]) * after)
    lived = flown.bool()
    parts = [torch.stack(one)[lived] for one in (seen, states, actions, before)]
    return [*parts, advantage[lived], (advantage + torch.stack(values[:-1]))[lived]]


def learn(agent: Agent, optimiser: Any, rows: list[torch.Tensor], plan: Plan) -> None:
    """Update actor and critic on a rollout by PPO."""
    count = len(rows[0])
    for _ in range(plan.epochs):
        for chosen in torch.randperm(count).tensor_split(max(1, round(count / plan.minibatch))):
            seen, state, action, before, gain, goal = (part[chosen] for part in rows)
            mean, value = agent(seen, state)
            gain = (gain - gain.mean()) / (gain.std(correction=0) + 1e-8)
            ratio = (agent.log_prob(mean, action) - before).exp()
            loss = -torch.minimum(ratio * gain, ratio.clamp(1 - CLIP, 1 + CLIP) * gain).mean()
            loss = loss + VALUE * (value - goal).square().mean()
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
            optimiser.step()


def swarm_features(worlds: Worlds, plan: Plan) -> SwarmFeatures:
    """Make the feature extractor of vectors, which is invariant to the order of other drones."""
    env = worlds.envs[0]
    layout = find_layout(env.observation_labels)
    return SwarmFeatures(env.observation_space, layout, scale=plan.scale)


def train(
    plan: Plan,
    seed: int,
    central: bool,
    folder: Path,
    look: Any = None,
    by: str = "fast_ppo",
    make_worlds: Any = Worlds,
    make_features: Any = swarm_features,
    prepare: Any = None,
) -> Agent:
    """Train, print the mean return, save the policy before and after training, and return it."""
    torch.manual_seed(seed)
    worlds = make_worlds(plan, seed, central)
    size = worlds.envs[0].action_space.shape[0]
    agent = Agent(make_features(worlds, plan), size, plan, worlds.state().shape[1])
    if prepare:  # callback that trains the agent by other means first
        prepare(worlds, agent)
    save(agent, folder / CHECKPOINTS / "000")
    write_settings(plan, seed, folder, by)
    optimiser = torch.optim.Adam(agent.parameters(), plan.rate, eps=1e-5)
    each = len(worlds.seen) * plan.decisions
    rounds = max(1, plan.steps // each)
    for k in range(rounds):
        optimiser.param_groups[0]["lr"] = plan.rate * min(1.0, (1 - k / rounds) / plan.decay)
        rows = collect(worlds, agent, plan)
        learn(agent, optimiser, rows, plan)
        if k % 10 == 0 or k == rounds - 1:
            print(f"{(k + 1) * each:9d} decisions: mean return {rows[-1].mean().item():.3f}")
        if look:  # callback with the steps so far and a function that saves the policy
            look((k + 1) * each, lambda place: save(agent, place))
    for env in worlds.envs:
        env.close()
    save(agent, folder)
    return agent


def save(agent: Agent, folder: Path) -> None:
    """Write the policy in the format of `bulletuav train`."""
    folder.mkdir(parents=True, exist_ok=True)
    arrays = {name: part.numpy() for name, part in agent.state_dict().items()}
    # Actor and critic share their features, which stable-baselines3 stores three times
    shared = [name for name in arrays if name.startswith("features_extractor")]
    arrays |= {f"{net}_{name}": arrays[name].copy() for net in ("pi", "vf") for name in shared}
    ones = np.ones_like(arrays["log_std"])
    save_file({**arrays, LOW: -ones, HIGH: ones}, folder / POLICY)


def write_settings(plan: Plan, seed: int, folder: Path, by: str) -> None:
    """Write the settings of the policy to run.yaml, as `bulletuav train` does."""
    features = {"features_extractor_kwargs": {"scale": plan.scale}}
    model = {"features": plan.features, "policy_kwargs": {"net_arch": [plan.width] * 2, **features}}
    config = RunConfig(plan.task, seed=seed, steps=plan.steps, options=plan.options, model=model)
    text = config.text("algo", "seed", "steps", "options", "model", "constants")
    (folder / CONFIG).write_text(f"# Learned by `examples/{by}.py`.\n{text}")


def main() -> None:
    """Train, save, and evaluate the saved policy."""
    args = parse_arguments()
    torch.set_num_threads(1)
    plan = PLANS[args.plan]._replace(steps=args.steps or PLANS[args.plan].steps)
    begin = time.perf_counter(), time.process_time()
    train(plan, args.seed, args.critic == "state", args.out)
    trained = time.perf_counter() - begin[0]
    result = bulletuav.evaluate(plan.task, args.out, args.episodes, 1000, **plan.evaluation)
    where = result.about["options"]["dynamics"]
    for metric in ("success", "conflict"):
        found = result.estimates()[metric]
        print(f"in {where}: {metric} {found.mean:.3f} ({found.low:.3f} to {found.high:.3f})")
    wall, cpu = time.perf_counter() - begin[0], time.process_time() - begin[1]
    print(f"trained for {trained:.0f} s; with the evaluation {wall:.0f} s, {cpu:.0f} s of one core")


if __name__ == "__main__":
    main()
