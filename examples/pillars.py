"""Fly a swarm among pillars by body rates and thrust: a custom task and a custom policy.

The arena is that of quad-swarm-rl (Z. Huang et al., Collision avoidance and navigation for a
quadrotor swarm using end-to-end deep reinforcement learning, ICRA 2024): a room of 10 m with 8 x 8
cells of 1 m in its centre. Pillars with a diameter of 0.6 m stand in a fraction of the cells, the
density. Drones fly from free cells to free cells in 15 s. The episode of a drone ends on contact.

Actions are body rates and thrust at 25 Hz. The policy `Teacher` reads the true state: it samples
velocities, selects the best, and converts it to rates and thrust. A network that observes six
pillars and six drones is trained on it in `dagger.py`.

Run it:

    python examples/pillars.py --density 0.8 --drones 8
    python examples/pillars.py --policy dagger

Takes 10 seconds to a minute. Plots the paths of one flight, `pillars/paths.png`.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from matplotlib.patches import Circle
from scipy.spatial.transform import Rotation

import bulletuav
from bulletuav.analysis.recording import fly_episode
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.rotation import Vec3
from bulletuav.policies import Policy, find_policy
from bulletuav.report.pictures import blank_figure
from bulletuav.sensors import Label
from bulletuav.tasks import Spawn, Task, TaskConfig, block
from bulletuav.tasks.ends import at_goal, collision, leaves_arena

CELLS = 8  # along each side
RADIUS, HEIGHT = 0.3, 10.0  # of a pillar, m
LOWEST, HIGHEST = 1.0, 3.0  # altitudes of starts and goals, m
STOREY = 1.5  # m between drones that start above each other, if there are too few cells
SEEN = 6  # number of observed pillars
SPEED = 1.5  # of the teacher, m/s
LEVEL, FLAT = np.float32([[1.0, 1.0, 0.0], [1.0, 1.0, 0.6]])
"""Weights of the axes: pillars are tall; below a drone its wake requires more separation"""
FAR, TINY = 100.0, 1e-9
SCALE = 2 * np.pi, 2 * np.pi, np.pi, 1.0  # of action `rates`, rad/s, and of the thrust


@dataclass(frozen=True)
class PillarsConfig(TaskConfig):
    """Fraction of cells with pillars, radius of the goal (m), and `d_safe` (m)."""

    density: float = field(default=0.6, metadata={"least": 0.0, "most": 0.9})
    goal_radius: float = 0.5
    d_safe: float = 0.3


@block(
    tuple(
        Label(f"obstacle {k} position {axis}", "m", -10.0, 10.0)
        for k in range(1, SEEN + 1)
        for axis in "xy"
    )
)
def pillars(known_position: Vec3, all_obstacle: np.ndarray, out: np.ndarray) -> None:
    """Offsets to the nearest pillars, nearest first; zeros if there are fewer."""
    before = -1.0
    for k in range(SEEN):
        nearest, x, y = np.inf, 0.0, 0.0
        for j in range(len(all_obstacle)):
            east = all_obstacle[j, 0] - known_position[0]
            north = all_obstacle[j, 1] - known_position[1]
            square = east * east + north * north
            if before < square < nearest:
                nearest, x, y = square, east, north
        out[2 * k] = x
        out[2 * k + 1] = y
        before = nearest


class Pillars(Task[PillarsConfig]):
    """Fly a swarm among pillars, from free cells to free cells."""

    name = "pillars"
    defaults: ClassVar = {
        "num_drones": 8,
        "airframe": "cf2x",
        "action": "rates",
        "dynamics": "rigid_body",
        "physics_hz": 200,
        "decision_hz": 25,
        "horizon": 375,
        "max_speed": 3.0,
        "num_neighbours": 6,
    }
    observation = ("goal_offset", "velocity", "attitude", "rates", pillars, "intruders")
    reward: ClassVar = {"progress": 1.0, "collision": -3.0}
    ends = (collision, leaves_arena)
    success = at_goal

    def __init__(self, config: PillarsConfig, context: Any) -> None:
        super().__init__(config, context)
        self.arena_low, self.arena_high = np.array([[-5.0, -5.0, 0.0], [5.0, 5.0, 10.0]])
        self._count = int(config.density * CELLS**2)

    def obstacles(self) -> Sequence[Obstacle]:
        """Return the pillars."""
        return [Obstacle("cylinder", (RADIUS, HEIGHT))] * self._count

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Sample cells for pillars, starts and goals."""
        cell = rng.permutation(CELLS**2)
        middle = np.stack([cell % CELLS, cell // CELLS], axis=1) - (CELLS - 1) / 2
        taken, free = np.split(middle, [self._count])
        start, goal = (self._places(free, rng) for _ in range(2))
        pillar = np.column_stack([taken, np.full(self._count, HEIGHT / 2)])
        return Spawn(position=start, goal=goal, obstacle=pillar, obstacle_velocity=0 * pillar)

    def _places(self, free: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Sample positions in free cells (F, 2), in several layers if there are more drones."""
        drone = np.arange(self.context.num_drones)
        storey, cell = np.divmod(drone, len(free))
        spread = HIGHEST - LOWEST if len(drone) <= len(free) else 0.5
        height = LOWEST + STOREY * storey + rng.uniform(0.0, spread, len(drone))
        return np.column_stack([rng.permutation(free)[cell], height])


class Teacher(Policy):
    """Policy that reads the true state, and selects the best of many sampled velocities."""

    name = "teacher"
    actions = ("rates",)
    reads_swarm = True

    def __init__(self, aviary: Any) -> None:
        super().__init__(aviary)
        turn = 2 * np.pi * np.arange(16) / 16
        level = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
        climbs = [[0.0, 0.0, climb] for climb in (-0.6, -0.3, 0.0, 0.3, 0.6)]
        ways = [share * level + climb for share in (0.35, 0.7, 1.0) for climb in climbs[1:4]]
        self._tries = SPEED * np.float32([*climbs, *np.concatenate(ways)])  # (T, 3)
        self._airframe = bulletuav.load_airframe(Pillars.defaults["airframe"])

    def reset(self, mask: np.ndarray) -> None:
        """Do nothing: the policy has no memory."""

    def act(self, observations: Any, swarm: Any) -> np.ndarray:
        """Return body rates and thrust of all drones, (W, N, 4)."""
        velocity = self._velocity(*(np.float32(part) for part in (swarm.position, swarm.velocity)))
        # Acceleration from the velocity error, at most 6 m/s^2, plus gravity
        push = (velocity - swarm.velocity) * (4.0, 4.0, 6.0)
        push *= np.minimum(1.0, 6.0 / (norm(push) + TINY))
        push[..., 2] += 9.81
        # Rates that turn the thrust axis to the force, and the nose to the east
        turn = Rotation.from_quat(swarm.quaternion.reshape(-1, 4)).as_matrix()
        turn = turn.reshape(*push.shape, 3)
        ahead, left, up = np.moveaxis((push[..., None] * turn).sum(axis=-2) / norm(push), -1, 0)
        thrust = 2 * self._airframe.mass * norm(push)[..., 0] * up / self._airframe.max_thrust - 1
        rates = (-7 * left, 7 * ahead, -1.5 * np.arctan2(turn[..., 1, 0], turn[..., 0, 0]))
        scaled = np.stack([*rates, thrust], axis=-1) / SCALE
        return np.clip(scaled, -1.0, 1.0)

    def _velocity(self, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Select velocities (W, N, 3), m/s."""
        scene, alive = self.aviary.scene, self.aviary.alive
        # Preferred velocity: towards the goal, slower near it
        gap = np.float32(scene.goal) - position
        wish = gap * np.minimum(SPEED / (norm(gap) + TINY), 1.2)
        # Candidates: the preferred velocity, the present velocity, and a fixed set
        same = np.broadcast_to(self._tries, (*wish.shape[:2], *self._tries.shape))
        tries = np.concatenate([wish[:, :, None], velocity[:, :, None], same], axis=2)
        # Nearest pillars: within the margin, the present distance is the limit
        gap = (np.float32(scene.obstacle)[:, None] - position[:, :, None]) * LEVEL
        gap = np.take_along_axis(gap, nearest(gap, 8), axis=2)
        reach = np.clip(norm(gap)[..., 0], RADIUS + 0.06, RADIUS + 0.14)
        pillar = time_to(gap, tries * LEVEL, 0 * gap, reach)
        # Nearest drones: each does half of the avoidance (J. van den Berg et al.,
        # Reciprocal velocity obstacles, ICRA 2008)
        gap = (position[:, None] - position[:, :, None]) * FLAT
        hidden = ~alive[:, None] | np.eye(alive.shape[1], dtype=bool)
        gap[hidden] = FAR
        moved = np.broadcast_to((velocity[:, None] + velocity[:, :, None]) * FLAT, gap.shape)
        order = nearest(gap, 7)
        moved, gap = (np.take_along_axis(part, order, axis=2) for part in (moved, gap))
        reach = np.clip(0.95 * norm(gap)[..., 0], 0.15, 0.5)
        drone = time_to(gap, 2 * tries * FLAT, moved, reach)
        left = np.maximum(0.0, position[:, :, None, 2] - 0.3)
        floor = left / np.maximum(-tries[..., 2], TINY)
        # Cost: deviation from the preferred velocity, change of velocity, and early contacts
        off = norm(tries - tries[:, :, :1]) + 0.15 * norm(tries - tries[:, :, 1:2])
        soon = np.maximum(0.0, 1 / (pillar + 0.05) - 0.8)
        soon += np.maximum(0.0, 1 / (drone + 0.05) - 0.4)
        soon += np.maximum(0.0, 1 / (floor + 0.05) - 0.8)
        best = (off[..., 0] + 0.8 * soon).argmin(axis=-1)
        return np.take_along_axis(tries, best[..., None, None], axis=2)[:, :, 0]


def norm(vectors: np.ndarray) -> np.ndarray:
    """Return the norms (..., 1) of vectors (..., 3)."""
    return np.linalg.norm(vectors, axis=-1, keepdims=True)


def nearest(gap: np.ndarray, count: int) -> np.ndarray:
    """Return the indices (W, N, count, 1) of the shortest of offsets (W, N, K, 3)."""
    return norm(gap).argsort(axis=2)[:, :, :count]


def time_to(gap: np.ndarray, tries: np.ndarray, moved: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Return the time of the first contact with any other, for each candidate velocity.

    The offsets `gap` are (W, N, K, 3) in m, the candidates `tries` (W, N, T, 3) in m/s, the contact
    distances `reach` (W, N, K) in m. `moved` (W, N, K, 3) is subtracted from the candidates to
    obtain closing velocities. Returns (W, N, T) in s.
    """
    clear = ((gap * gap).sum(-1) - reach * reach)[..., None]
    tries = np.moveaxis(tries, -1, -2)
    closing = gap @ tries - (gap * moved).sum(-1)[..., None]
    speed = (tries * tries).sum(-2)[:, :, None] - 2 * moved @ tries
    speed += (moved * moved).sum(-1)[..., None]
    # First root of |gap - t v| = reach
    square = closing * closing - clear * speed
    meets = (closing > 0.0) & (square > 0.0)
    later = closing + np.sqrt(np.where(meets, square, 1.0))
    time = np.where(meets, np.maximum(0.0, clear) / np.where(meets, later, 1.0), np.inf)
    return time.min(axis=2, initial=np.inf)


class lost:  # noqa: N801  # its name in tables
    """Fraction of the drones that had a contact, or left the room."""

    def __init__(self, aviary: Any) -> None:
        self.lost = np.zeros((aviary.num_worlds, aviary.num_drones), dtype=bool)

    def __call__(self, step: Any, aviary: Any) -> np.ndarray:
        """Update with one step; return the fraction so far for each world, (W,)."""
        self.lost |= step.terminated
        return self.lost.mean(axis=1)


def show(policy: Any, density: float, drones: int, episodes: int) -> str:
    """Evaluate a policy; return a text with the fractions of drones at the goal and lost."""
    options = {"density": density, "num_drones": drones, "metrics": (lost,), "trust": True}
    found = bulletuav.evaluate(Pillars, policy, episodes, 1000, **options).estimates()
    there, gone = (
        f"{name} {found[key].mean:.3f} ({found[key].low:.3f} to {found[key].high:.3f})"
        for name, key in (("at the goal", "drone_success"), ("lost", "lost"))
    )
    return f"density {density}, {drones} drones: {there}, {gone}"


def draw(policy: Any, density: float, drones: int, file: Path) -> None:
    """Plot the paths of one flight from above."""
    aviary = bulletuav.Aviary(Pillars, 1, density=density, num_drones=drones)
    flight = fly_episode(aviary, find_policy(policy, Pillars, trust=True)(aviary), seed=1000)
    paths = np.where(flight.alive[..., None], flight.position, np.nan)
    figure = blank_figure(6, 6)
    axes = figure.subplots()
    for x, y, _ in flight.obstacle[0]:
        axes.add_patch(Circle((x, y), RADIUS, color="0.8"))
    axes.plot(*np.moveaxis(paths[..., :2], -1, 0))
    axes.plot(*flight.goal[0, :, :2].T, "k*", label="goals")
    axes.set(xlabel="east (m)", ylabel="north (m)", xlim=(-5, 5), ylim=(-5, 5), aspect="equal")
    axes.legend()
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file)


def main() -> None:
    """Evaluate a policy, and plot one of its flights."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--density", type=float, default=0.8)
    parser.add_argument("--drones", type=int, default=8)
    parser.add_argument("--policy", type=Path, help="folder of a network (default: the teacher)")
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--out", type=Path, default=Path("pillars"), help="folder for the picture")
    args = parser.parse_args()
    policy = args.policy or Teacher
    print(show(policy, args.density, args.drones, args.episodes))
    draw(policy, args.density, args.drones, args.out / "paths.png")


if __name__ == "__main__":
    main()
