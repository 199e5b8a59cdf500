"""Task `race`: drones fly through a sequence of gates as fast as possible."""

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
from bulletuav.tasks.observations.base import Block, make_drone_block
from bulletuav.tasks.parts.base import Rngs
from bulletuav.tasks.parts.gates import compute_remaining_distances, cross_gates, rank_drones
from bulletuav.tasks.parts.race_course import RaceConfig, RaceCourse
from bulletuav.tasks.parts.safety import Safety


@reward
def progress(remaining_distance: float, remaining_distance_before: float) -> float:
    """Decrease of the remaining distance to the finish, from gate to gate, m."""
    return remaining_distance_before - remaining_distance


@reward
def gate(passing: float) -> float:
    """Count the gates that were passed, at most 1 unless gates are very close."""
    return passing


@reward
def miss(missing: float) -> float:
    """1 if the plane of the next gate was crossed beside its opening."""
    return missing


@reward
def finish(finished: bool) -> float:
    """1 on passing the last gate."""
    return 1.0 if finished else 0.0


@reward
def overtake(overtaken: float) -> float:
    """Count the drones that were ahead before the decision and are behind now."""
    return overtaken


@register("task")
class Race(Task[RaceConfig]):
    """Drones race through a sequence of gates with solid frames.

    Drones start on blocks on the ground, in rows of four, at least 6 m before the first gate. Gates
    have to be passed in order, each through its opening and in its direction. A drone that crosses
    the plane of its next gate beside the opening misses the gate and has to return to it. The track
    is drawn for each episode: 6 gates around a circle of 25 m, at heights of 2 to 5 m. A drone's
    goal is the centre of its next gate.

    Observation, Box(48) per drone with the defaults: velocity in body axes (forward, left, up);
    attitude as a quaternion, body to world; the next two gates in body axes: position, direction to
    fly, velocity, width of the opening; the nearest active drones, in world axes.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: commanded velocity divided by
    max_speed = 15 m/s, in world axes. Its norm is limited to max_speed. There are 20 decisions a
    second. Human pilots command `rates`: thrust and body rates.

    Reward per decision, the weighted sum of these terms:

    - progress 1: decrease of the remaining distance to the finish, from gate to gate, m.
    - gate 10: 1 if a gate was passed.
    - miss -5: 1 if the plane of the next gate was crossed beside its opening.
    - finish 50: 1 on passing the last gate.
    - overtake 0: number of drones overtaken.
    - conflict -100: number of drones whose separation falls below d_safe = 1 m.
    - collision -100: 1 on contact, except with the ground when landing.
    - out_of_bounds -50: 1 outside the arena.
    - energy -0.001: squared change of velocity, (m/s)^2.
    - time -0.5: 1 per decision until the finish; if the episode terminates before, also 1 per
      remaining decision.

    End: terminated on passing the last gate, on contact, when the battery is empty, or outside the
    arena. Truncated after 600 decisions; hard and extreme have 800.

    Success: the last gate was passed, without conflict or collision in the episode.

    Infos: `gates`, number of gates passed; `missed`, number of gates missed; `rank` from 1, by
    remaining distance; `overtakes`, number of drones overtaken; `split`, time at which the last
    gate was passed, s; `lap_time` of the last complete lap, s, or the elapsed time before;
    `contacts`, number of contacts; `race_time`, time to the finish, or the elapsed time, plus
    `penalty` = 2 s for each missed gate and each contact.

    Difficulties: easy has 2 drones and upright square gates. medium has 4; gates are square or
    round, and tilted. hard has 6 drones, 2 laps, smaller gates, and wind. extreme has 8 drones;
    gates oscillate, and drones differ in mass, thrust and drag.
    """

    version = 2
    name = "race"
    baseline = "race_pilot"
    shirkers: ClassVar = (
        "race_stop",
        "race_alone",
        "race_beside",
        "race_waiting",
        "race_rush",
    )
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
        "conflict": -100.0,
        "collision": -100.0,
        "out_of_bounds": -50.0,
        "energy": -0.001,
        "time": -0.5,
    }
    # A contact costs little, as drones otherwise learn to keep away from gates
    training_weights: ClassVar[Mapping[str, float]] = {
        "progress": 0.2,
        "gate": 2.0,
        "miss": 0.0,
        "finish": 5.0,
        "conflict": -3.0,
        "collision": -0.5,
        "out_of_bounds": -3.0,
        "energy": 0.0,
        "time": -0.02,
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
        """Read the track, or set up random tracks, and set the arena.

        Raises:
            ValueError: If the track does not exist or cannot be flown.
        """
        super().__init__(config, context)
        self.safety = self.add(Safety(context.num_drones))
        self.course = RaceCourse(config, context)
        self.turns = self.course.turns
        self.arena_low, self.arena_high = self.course.arena

    def obstacles(self) -> Sequence[Obstacle]:
        """Return the bars of all gates."""
        return self.course.bodies

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shapes of the memory of gates and drones.

        Returns:
            Of G gates: "gate" and "gate_before" (G, 3), centres after and before the decision, m;
                "gate_velocity" (G, 3), m/s; "gate_axis" (G, 3, 3), axes; "gate_size" (G,), m;
                "gate_phase" (G,), phase of the oscillation, rad; "leg" (G,), distance from each
                gate to the next, m. Of drones: "passed" (N,), number of gates; "split" (N, laps G),
                time of passing each gate, s; "passing", "missing", "overtaken" (N,), see
                `bulletuav.tasks.parts.gates`; "missed", "overtakes", "contacts" (N,), totals;
                "touching" (N,), whether a contact persists; "remaining_distance",
                "remaining_distance_before" (N,), to the finish, m; "rank", "rank_before" (N,).
        """
        gates, drones = self.course.gates, (self.context.num_drones,)
        of_gates = {"gate": (3,), "gate_before": (3,), "gate_velocity": (3,), "gate_axis": (3, 3)}
        of_gates |= {"gate_size": (), "gate_phase": (), "leg": ()}
        counts = ("passed", "passing", "missing", "missed", "overtaken", "overtakes", "contacts")
        measures = ("remaining_distance", "remaining_distance_before", "rank", "rank_before")
        of_drones = dict.fromkeys((*counts, "touching", *measures), drones)
        shapes = {name: (gates, *shape) for name, shape in of_gates.items()}
        return {**super().memory(), **shapes, **of_drones, "split": (*drones, self.turns)}

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw a track, unless one is given, and place drones on its starting blocks."""
        return self.course.spawn(rng)

    def start_memory(self, frame: Frame) -> None:
        """Compute the remaining distances and ranks at the start."""
        memory = frame.scene.memory
        self._update_distances(frame)
        memory["remaining_distance_before"][:] = memory["remaining_distance"]

    def move_scene(self, scene: Scene, time: np.ndarray, flying: np.ndarray, rngs: Rngs) -> bool:
        """Move oscillating gates, and goals with them.

        Returns:
            Whether gates may have moved.
        """
        memory = scene.memory
        memory["gate_before"][flying] = memory["gate"][flying]
        if not self.config.gate_motion:
            return False
        self.course.move(scene, time, flying)
        self._aim(scene)
        return True

    def _aim(self, scene: Scene) -> None:
        """Set goals to the centres of the next gates, or of the last gate after the finish."""
        memory = scene.memory
        turn = np.minimum(memory["passed"], self.turns - 1).astype(int) % self.course.gates
        for goal, gate in ((scene.goal, "gate"), (scene.goal_velocity, "gate_velocity")):
            goal[:] = np.take_along_axis(memory[gate], turn[..., None], axis=1)

    def _update_distances(self, frame: Frame) -> None:
        """Update the remaining distances, the ranks and the numbers of drones overtaken."""
        memory = frame.scene.memory
        gates = (memory["passed"], memory["gate"], memory["leg"], self.turns)
        compute_remaining_distances(frame.after.position, *gates, memory["remaining_distance"])
        last = memory["split"][..., -1]
        order = (memory["rank"], memory["rank_before"], memory["overtaken"])
        rank_drones(memory["remaining_distance"], last, frame.alive, *order)

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Update passed gates, ranks, and numbers of missed gates and contacts."""
        super().update_memory(frame, rngs)
        memory = frame.scene.memory
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
        memory["remaining_distance_before"][:] = memory["remaining_distance"]
        self._update_distances(frame)
        memory["missed"][:] += memory["missing"]
        memory["overtakes"][:] += memory["overtaken"]
        # A contact that persists counts once
        touching = frame.collision & frame.alive
        memory["contacts"][:] += touching & (memory["touching"] == 0)
        memory["touching"][:] = touching
        # Goals may have changed, so recompute the distances
        self._aim(frame.scene)
        fill_paired_distances(frame.scene.goal, frame.after.position, frame.distance)
        fill_paired_distances(frame.scene.goal, frame.known_position, frame.known_distance)

    def terminated(self, frame: Frame) -> np.ndarray:
        """Return which drones finished, crashed or left the arena; derive events for terms.

        Returns:
            (W, N) bool. Sets all `events` in `frame.derived`.
        """
        finished: np.ndarray = frame.alive & self.succeeded(frame)
        ended: np.ndarray = super().terminated(frame) | finished | frame.depleted
        if self.config.contact_ends == "drone":
            ended = ended | frame.collision
        frame.derived["finished"], frame.derived["terminated"] = finished, ended
        return ended

    def succeeded(self, frame: Frame) -> np.ndarray:
        """Return which drones passed the last gate, (W, N) bool."""
        finished: np.ndarray = frame.scene.memory["passed"] >= self.turns
        return finished

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Return ranks, times and faults; see the class docstring."""
        memory = frame.scene.memory
        passed, split = memory["passed"].astype(int), memory["split"]
        gates, now = self.course.gates, np.broadcast_to(frame.time[:, None], passed.shape)
        # Times at which laps ended, starting with 0
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
        """Return the poses and velocities of gates, and the number of gates passed by drones."""
        count, drones = self.course.gates, self.context.num_drones
        fast = np.full(3, self.course.fastest)
        labels: list[Label] = []
        for k in range(count):
            labels += vector_labels(f"gate {k}", "m", self.arena_low, self.arena_high)
            labels += vector_labels(f"gate {k} direction", "1", -np.ones(3), np.ones(3))
            labels += vector_labels(f"gate {k} velocity", "m/s", -fast, fast)

        def stands(frame: Frame, present: np.ndarray) -> np.ndarray:
            memory = frame.scene.memory
            columns = (memory["gate"], memory["gate_axis"][:, :, 0], memory["gate_velocity"])
            return np.concatenate(columns, axis=-1).reshape(len(present), -1)

        passed = make_drone_block("passed", "1", float(self.turns), drones)
        return {"gates": Block(tuple(labels), stands), "passed": passed}
