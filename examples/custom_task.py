"""A task of one's own, patrolling a perimeter, and two simple policies that fly it.

Drones start close together and are to watch a circle: each of its sectors should be seen again soon. The measure is
idleness, the time since a sector was last seen (A. Machado et al., Multi-agent patrolling, 2002). One sees what goes into a
task (start, memory, reward, success, infos) and a picture: where each drone just goes round, the worst idleness stays that
of a crowd; where each keeps the middle between its neighbours, it falls to that of drones spread evenly. Takes 10 s.

    python examples/custom_task.py
    python examples/custom_task.py --seconds 300 --drones 8 --out patrol
"""

import argparse
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np

import bulletuav
from bulletuav.policies import Policy
from bulletuav.report.pictures import blank_figure
from bulletuav.tasks.base import Frame, Spawn, StepResult, Task

SECTORS, CRUISE = 36, 10.0  # m/s


@dataclass(frozen=True)
class PatrolConfig:
    """Options of `patrol`, m and s: drones start `gap` apart on the circle; success is worst idleness up to `longest`."""

    d_safe: float = 5.0
    radius: float = 60.0
    height: float = 20.0
    gap: float = 15.0
    longest: float = 10.0
    weights: Mapping[str, float] = field(default_factory=dict)


class Patrol(Task):
    """See all sectors of a circle again and again. Reward: idleness -0.1 a second of the worst sector's; conflict -10."""

    name = "patrol"
    Config = PatrolConfig
    defaults: ClassVar = {
        "num_drones": 5,
        "num_neighbours": 16,
        "airframe": "hummingbird",
        "action": "velocity",
        "decision_hz": 10,
        "horizon": 1200,
        "max_speed": 15.0,
    }
    difficulties: ClassVar = {"easy": {}}
    observation = ("position", "neighbours")
    reward_weights: ClassVar = {"idleness": -0.1, "conflict": -10.0}
    arena_low, arena_high = np.array([-150.0, -150.0, 0.0]), np.array([150.0, 150.0, 60.0])

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """All on a short piece of the circle, at rest."""
        n, radius = self.context.num_drones, self.config.radius
        angle = rng.uniform(0, 2 * np.pi) + np.arange(n) * self.config.gap / radius
        place = np.stack(
            [radius * np.cos(angle), radius * np.sin(angle), np.full(n, self.config.height)], axis=1
        )
        still = np.zeros((n, 3))
        return Spawn(place, np.tile([0.0, 0.0, 0.0, 1.0], (n, 1)), still, still, goal=place)

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Seconds since each sector was last seen."""
        return {"idle": (SECTORS,)}

    def update_memory(self, frame: Frame, rng) -> None:
        """A drone sees the sector that it is in."""
        x, y, _ = np.moveaxis(frame.after.position, -1, 0)
        sector = np.floor(np.arctan2(y, x) / (2 * np.pi) * SECTORS) % SECTORS
        near = frame.alive & (np.abs(np.hypot(x, y) - self.config.radius) < self.config.d_safe)
        seen = np.any(near[..., None] & (sector[..., None] == np.arange(SECTORS)), axis=1)
        frame.scene.memory["idle"][:] = np.where(
            seen, 0.0, frame.scene.memory["idle"] + self.context.period
        )

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """The worst idleness, the same for all drones."""
        return {
            "idleness": np.broadcast_to(
                frame.scene.memory["idle"].max(axis=1, keepdims=True), frame.alive.shape
            )
        }

    def evaluate_step(self, frame: Frame) -> StepResult:
        """By the worst idleness, and by conflicts that begin."""
        idleness = self.info(frame)["idleness"]
        terms = {"idleness": idleness, "conflict": frame.conflict.onsets.astype(float)}
        return StepResult(
            terms, terminated=frame.collision, success=idleness <= self.config.longest
        )


class Rounds(Policy):
    """Round the circle to the left at one speed."""

    name, actions, reads_swarm = "rounds", ("velocity",), False
    gain = 0.0  # m/s, by how much a drone is at most faster or slower

    def reset(self, mask):
        """Nothing to forget."""

    def act(self, observations, swarm):
        """Along the circle, and back to it."""
        position, config = observations[..., :3].astype(float), self.aviary.task.config
        others = observations[..., 3:].reshape(
            *position.shape[:2], -1, 7
        )  # distance, position, velocity of each
        there, angle = (
            position[:, :, None] + others[..., 1:4],
            np.arctan2(position[..., 1], position[..., 0]),
        )
        gaps = (np.arctan2(there[..., 1], there[..., 0]) - angle[..., None]) % (2 * np.pi)
        ahead = np.min(gaps, axis=-1, where=others[..., 0] > 0, initial=2 * np.pi)
        behind = 2 * np.pi - np.max(gaps, axis=-1, where=others[..., 0] > 0, initial=0.0)
        speed = CRUISE + self.gain * (ahead - behind) / (ahead + behind)
        x, y, climb = np.cos(angle), np.sin(angle), config.height - position[..., 2]
        off = np.hypot(position[..., 0], position[..., 1]) - config.radius
        return self.encoded(np.stack([-y * speed - x * off, x * speed - y * off, climb], axis=-1))


class Evenly(Rounds):
    """Round the circle, faster where the one ahead is farther away than the one behind."""

    name, gain = "evenly", 4.0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=int, default=120, help="of each flight")
    parser.add_argument("--drones", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("custom_task"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)

    options = {"num_drones": args.drones, "horizon": 10 * args.seconds}
    figure = blank_figure(8, 4.5)
    axes = figure.subplots()
    for policy in (Rounds, Evenly):
        result = bulletuav.evaluate(
            Patrol, policy, episodes=10, seed=args.seed, **options
        ).estimates()
        aviary = bulletuav.Aviary(Patrol, **options)
        observations, pilot, worst = aviary.reset(seeds=args.seed), policy(aviary), []
        while aviary.alive.any():
            observations, *_, info = aviary.step(pilot.act(observations, aviary.swarm))
            worst.append(info["idleness"][0, 0])
        aviary.close()
        told = f"success {result['success'].mean:.2f}, conflicts {result['conflicts'].mean:.1f}"
        print(f"{policy.name}: {told}, worst idleness at the end {worst[-1]:.1f} s")
        axes.plot(np.arange(1, len(worst) + 1) / 10, worst, label=policy.name)
    ideal = (
        2 * np.pi * PatrolConfig.radius * (1 / args.drones - 1 / SECTORS) / CRUISE
    )  # from leaving to being back
    axes.axhline(ideal, color="0.5", ls="--", label="evenly spread")
    axes.set(
        xlabel="time (s)", ylabel="worst idleness (s)", title=f"{args.drones} drones on patrol"
    )
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(args.out / "idleness.png", dpi=110)
    print(f"the picture is {args.out / 'idleness.png'}")
