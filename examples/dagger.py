"""Imitate a policy with access to the true state from observations: DAgger in one file.

The network flies, the teacher labels the visited states with its actions, and the network is
trained on them, round by round. S. Ross et al., A reduction of imitation learning and structured
prediction to no-regret online learning, AISTATS 2011.

`pillars` has swarms of 8 and 32 Crazyflies among pillars, controlled by body rates and thrust:
`pillars.py` defines the task and the teacher. `race` imitates the `race_pilot`, which has planned a
line through all gates; the network observes the next two.

Run it:

    python examples/dagger.py pillars --out swarm
    python examples/pillars.py --policy swarm --density 0.8 --drones 32

Takes 15 to 30 minutes on one core. Needs the extra `sb3`. The output folder can be flown without
PyTorch: `--policy FOLDER`.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from fast_ppo import Agent, Worlds, save, swarm_features
from pillars import Teacher
from streets import Batches

from bulletuav.policies import find_policy
from bulletuav.policies.run import RunConfig

PILLARS = [(0.2, 8, 4), (0.4, 8, 4), (0.6, 8, 6), (0.8, 8, 8), (0.6, 32, 2), (0.8, 32, 2)]
"""Density, drones and worlds of the training batches"""
MINIBATCH = 4096
MODEL = {"features": "swarm", "policy_kwargs": {"net_arch": [64, 64], "log_std_init": -2.0}}


class Lesson(NamedTuple):
    """Task, its options, further options of each batch of worlds, and the teacher."""

    task: str
    options: dict[str, Any]
    batches: list[tuple[int, dict[str, Any]]]  # numbers of worlds and options
    teacher: Any
    rounds: int = 60
    decisions: int = 250  # of all drones in a round
    updates: int = 200  # of the network in a round
    noise: float = 0.08  # of actions, to visit states off the teacher's path


AMONG = [(worlds, {"density": d, "num_drones": n}) for d, n, worlds in PILLARS]
RACE = [(64, {"difficulty": "easy", "dynamics": "rigid_body"})]
SEEN = ["velocity", "goal", "body_velocity", "attitude", "next_gates", "neighbours"]
LESSONS = {
    "pillars": Lesson("pillars:Pillars", {}, AMONG, Teacher, rounds=80),
    "race": Lesson("race", {"observation": SEEN}, RACE, "race_pilot", rounds=40),
}


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=form)
    parser.add_argument("lesson", choices=LESSONS)
    parser.add_argument("--rounds", type=int, help="number of rounds")
    parser.add_argument("--decisions", type=int, help="decisions of each round")
    parser.add_argument("--updates", type=int, help="network updates of each round")
    parser.add_argument("--rate", type=float, default=2e-3)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("dagger"), help="folder for the policy")
    return parser.parse_args()


class School:
    """Worlds with teachers, and the data set of observations and labels."""

    def __init__(self, lesson: Lesson, worlds: Batches) -> None:
        self.worlds = worlds
        self.envs = [part.env for part in worlds.parts]
        self._noise, self._decisions = lesson.noise, lesson.decisions
        self._teachers = [find_policy(lesson.teacher, lesson.task)(env.aviary) for env in self.envs]
        for teacher, env in zip(self._teachers, self.envs, strict=True):
            teacher.reset(np.ones(env.num_envs, dtype=bool))
        self.seen = torch.zeros(0, self.worlds.seen.shape[1])
        self.taught = torch.zeros(0, self.envs[0].action_space.shape[0])

    @torch.no_grad()
    def fly(self, agent: Agent | None) -> None:
        """Collect observations and labels, with actions of the network or of the teacher."""
        seen, taught = [self.seen], [self.taught]
        for _ in range(self._decisions):
            known, right = self.worlds.seen, self._right()
            action = agent(known, self.worlds.state())[0].mean if agent else right
            begins = [env.ended for env in self.envs]
            lived = self.worlds.step(action + self._noise * torch.randn_like(action))[0].bool()
            for teacher, fresh in zip(self._teachers, begins, strict=True):
                teacher.reset(fresh)
            seen.append(known[lived])
            taught.append(right[lived])
        self.seen, self.taught = torch.cat(seen), torch.cat(taught)

    def train(self, agent: Agent, lesson: Lesson, rate: float) -> None:
        """Alternate collection and training."""
        optimiser = torch.optim.Adam(agent.parameters(), rate)
        steps = lesson.rounds * lesson.updates
        falls = torch.optim.lr_scheduler.LambdaLR(optimiser, lambda step: 1 - step / steps)
        for k in range(lesson.rounds):
            self.fly(agent if k else None)
            for _ in range(lesson.updates):
                chosen = torch.randint(len(self.seen), (MINIBATCH,))
                choice, _ = agent(self.seen[chosen], torch.zeros(MINIBATCH, 0))
                loss = (choice.mean - self.taught[chosen]).square().mean()
                optimiser.zero_grad()
                loss.backward()
                torch.nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
                optimiser.step()
                falls.step()
            if k % 5 == 0 or k == lesson.rounds - 1:
                print(f"{len(self.seen):8d} decisions: loss {loss.item():.5f}", flush=True)

    def _right(self) -> torch.Tensor:
        """Return the actions of the teachers, (M, A)."""
        pairs = zip(self._teachers, self.envs, strict=True)
        actions = [teacher.act(None, env.aviary.swarm) for teacher, env in pairs]
        rows = np.concatenate([one.reshape(-1, one.shape[-1]) for one in actions])
        return torch.from_numpy(rows.astype(np.float32)).clamp(-1.0, 1.0)


def learn(lesson: Lesson, args: argparse.Namespace) -> None:
    """Train and save the policy."""
    torch.manual_seed(args.seed)
    config = RunConfig(lesson.task, seed=args.seed, options=lesson.options, model=MODEL)
    parts = []
    for k, (count, options) in enumerate(lesson.batches):
        seed, whole = args.seed + 10_000 * k, {**lesson.options, **options}
        parts.append(Worlds(replace(config, worlds=count, seed=seed, options=whole)))
    school = School(lesson, Batches(parts))
    env = school.envs[0]
    agent = Agent(swarm_features(env, config), env.action_space.shape[0], config)
    school.train(agent, lesson, args.rate)
    save(agent, replace(config, steps=len(school.seen)), args.out, "dagger")


def main() -> None:
    """Train and save the policy."""
    args = parse_arguments()
    torch.set_num_threads(1)
    begin = time.perf_counter(), time.process_time()
    given = {name: getattr(args, name) for name in ("rounds", "decisions", "updates")}
    lesson = LESSONS[args.lesson]
    learn(lesson._replace(**{name: value for name, value in given.items() if value}), args)
    wall, cpu = time.perf_counter() - begin[0], time.process_time() - begin[1]
    print(f"learned for {wall:.0f} s, {cpu:.0f} s of one core")


if __name__ == "__main__":
    main()
