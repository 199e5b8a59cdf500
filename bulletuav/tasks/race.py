"""Task `race`: drones fly through numbered gates, as fast as they can."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from bulletuav.geometry.closest_approach import fill_paired_distances
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.registry import register
from bulletuav.sensors.base import Label, vector_labels
from bulletuav.tasks.base import Task
from bulletuav.tasks.ends import leaves_arena
from bulletuav.tasks.frame import Frame, Scene, Spawn, TaskContext
from bulletuav.tasks.ingredients import reward
from bulletuav.tasks.observations.base import Block, of_drones
from bulletuav.tasks.parts.base import Rngs
from bulletuav.tasks.parts.gates import cross_gates, rank_drones, ways_left
from bulletuav.tasks.parts.race_course import RaceConfig, RaceCourse


@reward
def progress(way: float, way_before: float) -> float:
    """Metres nearer to the finish, straight from gate to gate."""
    return way_before - way


@reward
def gate(passing: float) -> float:
    """1 where a gate was passed."""
    return passing


@reward
def miss(missing: float) -> float:
    """1 where the next gate's plane was crossed beside its opening."""
    return missing


@reward
def finish(finished: bool) -> float:
    """1 on passing the last gate."""
    return 1.0 if finished else 0.0


@reward
def overtake(overtaken: float) -> float:
    """Drones that were before it and are behind it now."""
    return overtaken


@register("task")
class Race(Task[RaceConfig]):
    """Race through numbered gates, whose frames can be hit.

    Drones start on blocks on the ground, in rows of four, 6 m and more before the first gate. Gates
    are to be passed in turn, each through its opening and in its direction. Who crosses the next
    gate's plane beside the opening has missed it, and has to come back. The track is drawn for each
    episode: 6 gates round a circle of 25 m, 2 to 5 m high. A drone's goal is the middle of its next
    gate.

    Observation, Box(48) per drone with the defaults: velocity in body axes (forward, left, up);
    attitude as a quaternion, body to world; the next two gates in body axes: position, direction
    to fly, velocity, width of the opening; the nearest living drones, in world axes.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: velocity over max_speed = 15 m/s, in
    world axes. Its norm is limited to max_speed. There are 20 decisions a second. Racing pilots
    give `rates`: thrust and body rates.

    Reward per decision, the sum of these terms times their weights:

    - progress 1: metres nearer to the finish, straight from gate to gate.
    - gate 10: 1 where a gate was passed.
    - miss -5: 1 where the next gate's plane was crossed beside its opening.
    - finish 50: 1 on passing the last gate.
    - overtake 0: drones that were before it and are behind it now.
    - collision -100: 1 on contact with anything but, on landing, the ground.
    - out_of_bounds -50: 1 outside the arena.
    - energy -0.001: square of the velocity change, (m/s)^2.
    - time -0.5: 1 a decision until the finish. Whoever ends before pays for all that are left.

    End: terminated on passing the last gate, on contact, with an empty battery, or outside the
    arena. Truncated after 600 decisions; hard and extreme have 800.

    Success: the last gate was passed.

    Infos: `gates` passed; gates `missed`; `rank` from 1, by the way that is left; `overtakes`;
    `split`, when the last gate was passed, s; `lap_time` of the last whole lap, s, and before that
    the time so far; `contacts`, how often one began; `race_time`, time to the finish or so far,
    with `penalty` = 2 s for each gate missed and each contact.

    Difficulties: easy has 2 drones and upright square gates. medium has 4; gates are square or
    round, and tilted. hard has 6 drones, 2 laps, smaller gates, and wind. extreme has 8 drones;
    gates swing, and drones are not alike.
    """

    name = "race"
    baseline = "race_pilot"
    places: ClassVar[tuple[str, ...]] = ("start",)
    events = ("finished", "terminated")
    ends: ClassVar = (leaves_arena,)
    defaults: ClassVar = {
        "num_drones": 4,
        "airframe": "racer",
        "action": "velocity",
        "decision_hz": 20,
        "horizon": 600,
        "max_speed": 15.0,
        "difficulty": "medium",
    }
    difficulties: ClassVar = {
        "easy": {"num_drones": 2, "gate_shape": "square", "gate_size": 2.4, "gate_tilt": 0.0},
        "medium": {},
        "hard": {
            "num_drones": 6,
            "laps": 2,
            "horizon": 800,
            "gate_size": 1.8,
            "gate_tilt": 30.0,
            "randomization": {"wind": (-3.0, 3.0)},
        },
        "extreme": {
            "num_drones": 8,
            "laps": 2,
            "horizon": 800,
            "gate_size": 1.8,
            "gate_tilt": 30.0,
            "gate_motion": 1.0,
            "turbulence": "light",
            "randomization": {
                "mass": (0.9, 1.1),
                "thrust": (0.9, 1.1),
                "drag": (0.5, 1.5),
                "gps_noise": (0.0, 0.1),
                "wind": (-3.0, 3.0),
            },
        },
    }
    observation: ClassVar[tuple[Any, ...]] = (
        "body_velocity",
        "attitude",
        "next_gates",
        "neighbours",
    )
    reward: ClassVar = {
        "progress": (progress, 1.0),
        "gate": (gate, 10.0),
        "miss": (miss, -5.0),
        "finish": (finish, 50.0),
        "overtake": (overtake, 0.0),
        "collision": -100.0,
        "out_of_bounds": -50.0,
        "energy": -0.001,
        "time": -0.5,
    }
    shows: ClassVar = {
        "success": "finished",
        "goal_distance": "to gate (m)",
        "gates": "gates",
        "missed": "missed",
        "overtakes": "overtakes",
        "separation": "nearest (m)",
        "collision": "collisions",
    }

    def __init__(self, config: RaceConfig, context: TaskContext) -> None:
        """Read the track, or find out how to draw one, and lay out the arena.

        Raises:
            ValueError: There is no such track, or it cannot be flown.
        """
        super().__init__(config, context)
        self.course = RaceCourse(config, context)
        self.turns = self.course.turns
        self.arena_low, self.arena_high = self.course.arena

    def obstacles(self) -> Sequence[Obstacle]:
        """List the bars of all gates."""
        return self.course.bodies

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Tell the shapes of what is kept of gates and drones.

        Returns:
            Of G gates "gate" and "gate_before" (G, 3), middles after and before the decision, m;
            "gate_velocity" (G, 3), m/s; "gate_axis" (G, 3, 3), their axes; "gate_size" (G,), m;
            "gate_phase" (G,) of their swings, rad; "leg" (G,), from each to the next, m. Of drones
            "passed" (N,), gates; "split" (N, laps G), when each was passed, s; "passing",
            "missing", "overtaken" (N,), see `bulletuav.tasks.parts.gates`; "missed",
            "overtakes", "contacts" (N,), sums; "touching" (N,), whether a contact goes on; "way",
            "way_before" (N,), to the finish, m; "rank", "rank_before" (N,).
        """
        gates, drones = self.course.gates, (self.context.num_drones,)
        of_gates = {"gate": (3,), "gate_before": (3,), "gate_velocity": (3,), "gate_axis": (3, 3)}
        of_gates |= {"gate_size": (), "gate_phase": (), "leg": ()}
        counts = ("passed", "passing", "missing", "missed", "overtaken", "overtakes", "contacts")
        of_drones = dict.fromkeys(
            (*counts, "touching", "way", "way_before", "rank", "rank_before"), drones
        )
        shapes = {name: (gates, *shape) for name, shape in of_gates.items()}
        return {**shapes, **of_drones, "split": (*drones, self.turns)}

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw a track, unless one is given, and put drones on its blocks."""
        return self.course.spawn(rng)

    def start_memory(self, frame: Frame) -> None:
        """Find the ways to the finish from the start, and the order there."""
        memory = frame.scene.memory
        self._follow_ways(frame)
        memory["way_before"][:] = memory["way"]

    def move_scene(self, scene: Scene, time: np.ndarray, flying: np.ndarray, rngs: Rngs) -> bool:
        """Swing gates, and move goals with them.

        Returns:
            Whether gates can have moved.
        """
        memory = scene.memory
        memory["gate_before"][flying] = memory["gate"][flying]
        if not self.config.gate_motion:
            return False
        self.course.move(scene, time, flying)
        self._aim(scene)
        return True

    def _aim(self, scene: Scene) -> None:
        """Put drones' goals into the middles of their next gates; at the end into the last one."""
        memory = scene.memory
        turn = np.minimum(memory["passed"], self.turns - 1).astype(int) % self.course.gates
        for goal, gate in ((scene.goal, "gate"), (scene.goal_velocity, "gate_velocity")):
            goal[:] = np.take_along_axis(memory[gate], turn[..., None], axis=1)

    def _follow_ways(self, frame: Frame) -> None:
        """Bring the ways that are left up to date, and the order; count who was overtaken."""
        memory = frame.scene.memory
        gates = (memory["passed"], memory["gate"], memory["leg"], self.turns)
        ways_left(frame.after.position, *gates, memory["way"])
        last = memory["split"][..., -1]
        order = (memory["rank"], memory["rank_before"], memory["overtaken"])
        rank_drones(memory["way"], last, frame.alive, *order)

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Credit drones with gates, bring the order up to date, and count what went wrong."""
        memory = frame.scene.memory
        # Gates that moved are crossed in their own frame, between before and after
        cross_gates(
            frame.before.position,
            frame.after.position,
            frame.alive,
            frame.time,
            self.context.period,
            memory["gate_before"],
            memory["gate"],
            memory["gate_axis"],
            memory["gate_size"],
            self.course.sides,
            memory["passed"],
            memory["split"],
            memory["passing"],
            memory["missing"],
        )
        # Order by the ways left, now that gates are credited
        memory["way_before"][:] = memory["way"]
        self._follow_ways(frame)
        # Counts of the episode
        memory["missed"][:] += memory["missing"]
        memory["overtakes"][:] += memory["overtaken"]
        # A touch that lasts counts once
        touching = frame.collision & frame.alive
        memory["contacts"][:] += touching & (memory["touching"] == 0)
        memory["touching"][:] = touching
        # The next gate may be another goal, so distances are measured again
        self._aim(frame.scene)
        fill_paired_distances(frame.scene.goal, frame.after.position, frame.distance)
        fill_paired_distances(frame.scene.goal, frame.known_position, frame.known_distance)

    def terminated(self, frame: Frame) -> np.ndarray:
        """Tell who finished, crashed or left the arena; derive the events that terms read.

        Returns:
            (W, N) bool. `frame.derived` gets all of `events`.
        """
        finished: np.ndarray = frame.alive & self.succeeded(frame)
        ended: np.ndarray = super().terminated(frame) | finished | frame.depleted
        if self.config.contact_ends == "drone":
            ended = ended | frame.collision
        frame.derived["finished"], frame.derived["terminated"] = finished, ended
        return ended

    def succeeded(self, frame: Frame) -> np.ndarray:
        """Tell who passed the last gate, (W, N) bool."""
        finished: np.ndarray = frame.scene.memory["passed"] >= self.turns
        return finished

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Tell the order, times and faults of the race; see the class."""
        memory = frame.scene.memory
        passed, split = memory["passed"].astype(int), memory["split"]
        gates, now = self.course.gates, np.broadcast_to(frame.time[:, None], passed.shape)
        # Before the first lap is over, its time is the time so far; the start was at 0.
        ends = np.concatenate([np.zeros((*passed.shape, 1)), split[..., gates - 1 :: gates]], -1)
        lap = passed // gates
        last, first = (
            np.take_along_axis(ends, which[..., None], axis=-1)[..., 0]
            for which in (lap, np.maximum(lap - 1, 0))
        )
        finish = np.where(passed >= self.turns, split[..., -1], now)
        faults = memory["missed"] + memory["contacts"]
        return {
            "gates": passed,
            "missed": memory["missed"].astype(int),
            "contacts": memory["contacts"].astype(int),
            "rank": memory["rank"].astype(int),
            "overtakes": memory["overtakes"].astype(int),
            "split": split.max(axis=-1),
            "lap_time": np.where(lap > 0, last - first, now),
            "race_time": finish + self.config.penalty * faults,
        }

    def world_state(self) -> Mapping[str, Block]:
        """Tell where gates are, how they stand and move, and how many each drone has passed."""
        count, drones = self.course.gates, self.context.num_drones
        fast = np.full(3, self.course.fastest)
        # The global state tells all gates; drones observe the next ones
        labels: list[Label] = []
        for k in range(count):
            labels += vector_labels(f"gate {k}", "m", self.arena_low, self.arena_high)
            labels += vector_labels(f"gate {k} direction", "1", -np.ones(3), np.ones(3))
            labels += vector_labels(f"gate {k} velocity", "m/s", -fast, fast)

        def stands(frame: Frame, present: np.ndarray) -> np.ndarray:
            memory = frame.scene.memory
            told = (memory["gate"], memory["gate_axis"][:, :, 0], memory["gate_velocity"])
            return np.concatenate(told, axis=-1).reshape(len(present), -1)

        passed = of_drones("passed", "1", float(self.turns), drones)
        return {"gates": Block(tuple(labels), stands), "passed": passed}
