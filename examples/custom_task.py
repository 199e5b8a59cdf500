"""Write a custom task, patrolling a perimeter, and two simple policies for it.

Shows the parts of a task: start, memory, reward, success and infos. Drones start close together and
patrol a circle, each of whose sectors should be visited often. The measure is idleness, the time
since the last visit of a sector (A. Machado et al., Multi-agent patrolling, 2002).

Plots the worst idleness over time for two policies. With the first, each drone flies around the
circle, and the worst idleness stays that of a cluster. With the second, each drone keeps the middle
between its neighbours, and the worst idleness falls to that of evenly spaced drones.

Run it:

    python examples/custom_task.py
    python examples/custom_task.py --seconds 300 --drones 8 --out patrol

Takes 10 s.
"""

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

import bulletuav
from bulletuav.policies import Policy
from bulletuav.report.pictures import blank_figure
from bulletuav.tasks import Frame, Spawn, Task, TaskConfig, end
from bulletuav.tasks.ends import collision

NUM_SECTORS = 36
CRUISE_SPEED = 10.0  # m/s
DECISION_HZ = 10


@dataclass(frozen=True)
class PatrolConfig(TaskConfig):
    """Options of `patrol`.

    Attributes:
        d_safe: Separation below which drones conflict; also the range of visiting a sector, m.
        radius: Radius of the circle, m.
        height: Height of the circle above the ground, m.
        gap: Distance between drones at the start, along the circle, m.
        longest: Maximum worst idleness of a successful patrol, s.
    """

    d_safe: float = 5.0
    radius: float = 60.0
    height: float = 20.0
    gap: float = 15.0
    longest: float = 10.0


def worst_idleness(frame: Frame) -> np.ndarray:
    """Return the idleness of the worst sector, s, the same for all drones of a world."""
    worst = frame.scene.memory["idle"].max(axis=1, keepdims=True)
    return np.broadcast_to(worst, frame.alive.shape)


@end
def seen_soon(idleness: float, longest: float) -> bool:
    """Return True if the worst idleness is within the limit."""
    return idleness <= longest


class Patrol(Task[PatrolConfig]):
    """Visit all sectors of a circle repeatedly.

    Reward: -0.1 for each second of the worst idleness; -10 for a conflict that begins.
    """

    name = "patrol"
    defaults: ClassVar = {
        "num_drones": 5,
        "num_neighbours": 16,
        "decision_hz": DECISION_HZ,
        "horizon": 1200,
        "max_speed": 15.0,
    }
    observation = ("position", "neighbours")
    reward: ClassVar = {"idleness": (worst_idleness, -0.1), "conflict": -10.0}
    ends = (collision,)
    success = seen_soon
    arena_low = np.array([-150.0, -150.0, 0.0])
    arena_high = np.array([150.0, 150.0, 60.0])

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Sample starts of all drones on a short arc of the circle, at rest."""
        num_drones, radius = self.context.num_drones, self.config.radius
        angle = rng.uniform(0, 2 * np.pi) + np.arange(num_drones) * self.config.gap / radius
        height = np.full(num_drones, self.config.height)
        start = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)
        return Spawn(position=start, goal=start)

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the arrays that the task stores in each world: idleness of sectors, s."""
        return {"idle": (NUM_SECTORS,)}

    def update_memory(self, frame: Frame, rng) -> None:
        """Update the idleness: reset visited sectors, and add the time step to all others."""
        x, y, _ = np.moveaxis(frame.after.position, -1, 0)
        sector = np.floor(np.arctan2(y, x) / (2 * np.pi) * NUM_SECTORS) % NUM_SECTORS
        is_near = frame.alive & (np.abs(np.hypot(x, y) - self.config.radius) < self.config.d_safe)
        is_there = sector[..., None] == np.arange(NUM_SECTORS)  # (worlds, drones, sectors)
        is_seen = np.any(is_near[..., None] & is_there, axis=1)
        idle = frame.scene.memory["idle"]
        idle[:] = np.where(is_seen, 0.0, idle + self.context.period)

    def quantities(self) -> Mapping[str, Any]:
        """Return the quantities for terms, ends and success: the worst idleness."""
        return {"idleness": worst_idleness}

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Return the worst idleness."""
        return {"idleness": worst_idleness(frame)}


class Rounds(Policy):
    """Fly around the circle to the left at constant speed."""

    name = "rounds"
    actions = ("velocity",)
    reads_swarm = False
    gain: float = 0.0  # m/s, maximum change of speed

    def reset(self, mask):
        """Do nothing: the policy has no memory."""

    def act(self, observations, swarm):
        """Return velocities along the circle, and back to it."""
        position = observations[..., :3].astype(float)
        # Each neighbour has distance (0 if absent), offset and velocity
        neighbours = observations[..., 3:].reshape(*position.shape[:2], -1, 7)
        is_there = neighbours[..., 0] > 0
        other = position[:, :, None] + neighbours[..., 1:4]

        # Angles along the circle to the next drone ahead and behind
        angle = np.arctan2(position[..., 1], position[..., 0])
        other_angle = np.arctan2(other[..., 1], other[..., 0])
        gaps = (other_angle - angle[..., None]) % (2 * np.pi)
        ahead = np.min(gaps, axis=-1, where=is_there, initial=2 * np.pi)
        behind = 2 * np.pi - np.max(gaps, axis=-1, where=is_there, initial=0.0)
        speed = CRUISE_SPEED + self.gain * (ahead - behind) / (ahead + behind)

        # Velocity along the tangent, and radial correction
        config = self.aviary.task.config
        x, y = np.cos(angle), np.sin(angle)
        off = np.hypot(position[..., 0], position[..., 1]) - config.radius
        climb = config.height - position[..., 2]
        return self.encoded(np.stack([-y * speed - x * off, x * speed - y * off, climb], axis=-1))


class Evenly(Rounds):
    """Fly around the circle, faster if the drone ahead is farther away than the one behind."""

    name = "evenly"
    gain = 4.0


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=int, default=120, help="duration of each flight")
    parser.add_argument("--drones", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--out", type=Path, default=Path("custom_task"), help="folder for the files"
    )
    return parser.parse_args()


def fly(policy: type[Policy], seed: int, options: dict) -> list[float]:
    """Fly one episode; return the worst idleness after each decision, s."""
    aviary = bulletuav.Aviary(Patrol, **options)
    observations = aviary.reset(seeds=seed)
    pilot = policy(aviary)
    worst = []
    while aviary.alive.any():
        observations, *_, info = aviary.step(pilot.act(observations, aviary.swarm))
        worst.append(info["idleness"][0, 0])
    aviary.close()
    return worst


def main() -> None:
    """Evaluate both policies, and plot one flight of each."""
    args = parse_arguments()
    args.out.mkdir(parents=True, exist_ok=True)

    options = {"num_drones": args.drones, "horizon": DECISION_HZ * args.seconds}
    figure = blank_figure(8, 4.5)
    axes = figure.subplots()
    for policy in (Rounds, Evenly):
        result = bulletuav.evaluate(Patrol, policy, episodes=10, seed=args.seed, **options)
        estimates = result.estimates()
        worst = fly(policy, args.seed, options)
        print(
            f"{policy.name}: success {estimates['success'].mean:.2f}, "
            f"conflicts {estimates['conflicts'].mean:.1f}, "
            f"worst idleness at the end {worst[-1]:.1f} s"
        )
        axes.plot(np.arange(1, len(worst) + 1) / DECISION_HZ, worst, label=policy.name)

    # A sector is idle from the departure of one drone to the arrival of the next
    idle_share = 1 / args.drones - 1 / NUM_SECTORS
    ideal = 2 * np.pi * PatrolConfig.radius * idle_share / CRUISE_SPEED
    axes.axhline(ideal, color="0.5", ls="--", label="evenly spread")
    title = f"{args.drones} drones on patrol"
    axes.set(xlabel="time (s)", ylabel="worst idleness (s)", title=title)
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(args.out / "idleness.png", dpi=110)
    print(f"the picture is {args.out / 'idleness.png'}")


if __name__ == "__main__":
    main()
