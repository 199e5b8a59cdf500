"""Learn to fly a swarm among pillars, at thrust level, from a teacher that sees everything.

A network sees its goal, its own motion, the six nearest pillars and six drones, and gives body
rates and thrust. It flies, the `Teacher` of `pillars.py` tells what it would have done there, and
the network learns that, round by round. S. Ross et al., A reduction of imitation learning and
structured prediction to no-regret online learning (DAgger), AISTATS 2011.

Run it:

    python examples/pillars_learn.py
    python examples/pillars.py --policy pillars_learn --density 0.8 --drones 32

Takes about 15 minutes on one core. Needs the extra `sb3`. The folder it writes flies without
PyTorch.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import torch
from fast_ppo import Agent, Plan, Worlds, save, write_settings
from pillars import Pillars, Teacher, show

BATCHES = [(0.2, 8, 4), (0.4, 8, 4), (0.6, 8, 6), (0.8, 8, 8), (0.6, 32, 1), (0.8, 32, 2)]
"""Density, drones and worlds that are learned from"""
TABLE = [(0.2, 8), (0.6, 8), (0.8, 8), (0.6, 32), (0.8, 32)]
"""Density and drones that are flown to see what was learned"""
MINIBATCH, NOISE = 4096, 0.08
WEIGHT = torch.tensor([1.0, 1.0, 1.0, 2.0])  # of errors in rates and thrust


def learn(args: argparse.Namespace) -> None:
    """Let the network fly, and learn what the teacher would have done."""
    torch.set_num_threads(1)
    torch.manual_seed(args.seed)
    batches = [
        {"task": Pillars, "density": density, "num_drones": drones, "num_envs": worlds}
        for density, drones, worlds in BATCHES
    ]
    plan = Plan("pillars:Pillars", {}, batches, args.rounds * args.decisions, log_std=-2.0)
    worlds = Worlds(plan, args.seed, with_state=False)
    teachers = [Teacher(env.aviary) for env in worlds.envs]
    agent = Agent(worlds.envs[0], plan, told=0)
    optimiser = torch.optim.Adam(agent.parameters(), args.rate)
    steps = args.rounds * args.updates
    falls = torch.optim.lr_scheduler.LambdaLR(optimiser, lambda step: 1 - step / steps)
    flown: list[tuple[torch.Tensor, torch.Tensor]] = []
    for k in range(args.rounds):
        flown += fly(worlds, teachers, None if k == 0 else agent, args.decisions)
        seen, taught = (torch.cat(part) for part in zip(*flown, strict=True))
        flown = [(seen, taught)]
        for _ in range(args.updates):
            chosen = torch.randint(len(seen), (MINIBATCH,))
            mean, _ = agent(seen[chosen], torch.zeros(MINIBATCH, 0))
            loss = ((mean - taught[chosen]).square() * WEIGHT).mean()
            optimiser.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
            optimiser.step()
            falls.step()
        if k % 5 == 0 or k == args.rounds - 1:
            print(f"{len(seen):8d} decisions: loss {loss.item():.5f}", flush=True)
    for env in worlds.envs:
        env.close()
    save(agent, args.out)
    write_settings(plan, args.seed, args.out, "pillars_learn")


@torch.no_grad()
def fly(worlds: Worlds, teachers: list[Teacher], agent: Agent | None, decisions: int) -> list[Any]:
    """Fly some time; gives what living drones saw, and what the teacher would have done."""
    flown = []
    for _ in range(decisions):
        pairs = zip(teachers, worlds.envs, strict=True)
        taught = [teacher.act(None, env.aviary.swarm).reshape(-1, 4) for teacher, env in pairs]
        right = torch.from_numpy(np.concatenate(taught).astype(np.float32))
        seen = worlds.seen
        action = agent(seen, torch.zeros(len(seen), 0))[0] if agent else right
        # What is off a little shows how to come back
        lived = worlds.step(action + NOISE * torch.randn_like(action))[0].bool()
        flown.append((seen[lived], right[lived]))
    return flown


def main() -> None:
    """Learn, and show what was learned."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=60, help="of flying and learning")
    parser.add_argument("--decisions", type=int, default=250, help="of all drones in a round")
    parser.add_argument("--updates", type=int, default=200, help="of the network in each round")
    parser.add_argument("--rate", type=float, default=2e-3)
    parser.add_argument("--episodes", type=int, default=50, help="of each evaluation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("pillars_learn"), help="for the policy")
    args = parser.parse_args()
    learn(args)
    for density, drones in TABLE:
        print(show(args.out, density, drones, args.episodes))


if __name__ == "__main__":
    main()
