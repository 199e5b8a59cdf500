"""Task `formation`: drones hold a shape around a moving and turning leader."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from bulletuav.compiled.functions import cos, sin
from bulletuav.geometry.rotation import Vec3
from bulletuav.registry import register
from bulletuav.sensors.base import Label, vector_labels
from bulletuav.tasks.frame import Frame, Scene, Spawn, TaskContext
from bulletuav.tasks.given import GivenPositions
from bulletuav.tasks.goal_flight import REWARD_WEIGHTS, TRAINING_WEIGHTS, GoalFlight
from bulletuav.tasks.ingredients import block, reward
from bulletuav.tasks.observations.base import Block
from bulletuav.tasks.parts.airspace import circle_arena, clearance, min_start_distance
from bulletuav.tasks.parts.base import Rngs
from bulletuav.tasks.parts.difficulties import AIRSPACE_DIFFICULTIES
from bulletuav.tasks.parts.formation_plan import FormationConfig, FormationPlan
from bulletuav.tasks.parts.formations import Course, Leader, in_world, off_places, off_shape
from bulletuav.tasks.parts.holding import HoldingWhere


@reward
def approach(remaining_distance: float, remaining_distance_before: float) -> float:
    """Decrease of the distance to the place, m, including the motion of the place."""
    return remaining_distance_before - remaining_distance


def leader_labels(task: Any) -> tuple[Label, ...]:
    """Return the labels of the leader's motion."""
    fastest = task.context.max_speed
    level = (Label(f"leader velocity {axis}", "m/s", -fastest, fastest) for axis in "xy")
    return (*level, Label("leader turn", "rad/s", -np.pi, np.pi))


@block(leader_labels)
def leader(all_leader_velocity: np.ndarray, turn: float) -> Vec3:
    """Horizontal velocity of the leader, world axes, and its turn rate, positive to the left."""
    return all_leader_velocity[0], all_leader_velocity[1], turn


@register("task")
class Formation(GoalFlight[FormationConfig]):
    """Drones hold a formation around a virtual leader that moves, turns and changes the shape.

    The leader is not a drone but a point that moves horizontally at 5 m/s, in a direction drawn at
    the start, and turns by 2 degrees per second. Each drone's goal is its place in the leader's
    frame, which moves and turns with the leader. Drones start in a square block around the leader,
    in random order and at the leader's velocity. The shape is a V with arms at right angles and 12
    m between neighbours. After 25 s it changes to a line abreast.

    Observation, Box(61) per drone with the defaults, in world axes (east, north, up): position,
    velocity, direction and distance of the place, the place's velocity, the leader's velocity and
    turn rate, the nearest active drones, and the nearest obstacles. Drones and obstacles are
    relative to the drone, sorted by distance, and padded with zeros.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: commanded velocity divided by
    max_speed = 20 m/s. Its norm is limited to max_speed. There are 10 decisions a second.

    Reward per decision, the weighted sum of these terms (see `GoalFlight` for all terms):

    - progress 1: decrease of the distance to the moving place, m.
    - holding 1: 1 within 2 m of the place.
    - conflict -500: number of drones whose separation falls below d_safe = 5 m.
    - warning -1: sum over other drones of their proximity, linear from 0 at 10 m to 1 at 5 m.
    - collision -200: 1 on contact.
    - out_of_bounds -50: 1 outside the arena.
    - energy -0.01: squared change of velocity, (m/s)^2.
    - time -0.5: 1 per decision away from the place; if the episode terminates, also 1 per remaining
      decision.

    End: terminated on contact, when the battery is empty, or outside the arena. Truncated after 500
    decisions; hard has 750, extreme has 1,500.

    Success: the drone was at its place for `min_in_place` of the episode, without conflict or
    collision.

    Infos: `formation_error` is the root mean square of the active drones' distances from their
    places. `shape_error` is the residual after the optimal translation and rotation of the shape.
    `in_place` is the fraction of the time for which the drone was at its place. `time_to_form` is
    the time from the last change of shape or places until all active drones were at their places
    simultaneously, s; until then it is the time since the change.
    """

    name = "formation"
    version = 2
    baseline = "formation_pilot"
    shirkers: ClassVar = (
        "formation_unchanged",
        "formation_late",
        "formation_half",
        "formation_neighbour",
        "formation_shifted",
        "formation_on_leader",
    )
    presets: ClassVar[dict[str, Mapping[str, Any]]] = {}
    places: ClassVar[tuple[str, ...]] = ("start",)
    observation: ClassVar[tuple[Any, ...]] = (
        "position",
        "velocity",
        "goal",
        "goal_velocity",
        leader,
        "neighbours",
        "obstacles",
    )
    reward: ClassVar = {
        **REWARD_WEIGHTS,
        "progress": (approach, 1.0),
        "goal": 0.0,
        "conflict": -500.0,
        "warning": -1.0,
        "holding": 1.0,
    }
    training_weights: ClassVar[Mapping[str, float]] = {
        **TRAINING_WEIGHTS,
        "goal": 0.0,
        "holding": 0.1,
        "progress": 0.1,
        # With the -6 of other flights, drones do not come together within a million decisions
        "conflict": -3.0,
        "collision": -4.0,
        "out_of_bounds": -4.0,
    }
    shows: ClassVar = {
        "success": "success",
        "in_place": "in place",
        "formation_error": "off places (m)",
        "shape_error": "off shape (m)",
        "separation": "nearest (m)",
        "conflicts": "conflicts",
        "collision": "collisions",
    }
    difficulties: ClassVar = {
        "easy": {"exchange": 25.0, **AIRSPACE_DIFFICULTIES["easy"]},
        "medium": {
            "shapes": ("v", "line"),
            "turn_rate": 2.0,
            "min_in_place": 0.65,
            **AIRSPACE_DIFFICULTIES["medium"],
        },
        "hard": {
            "shapes": ("v", "ring", "line"),
            "turn_rate": 2.0,
            "horizon": 750,
            "min_in_place": 0.55,
            **AIRSPACE_DIFFICULTIES["hard"],
        },
        "extreme": {
            "shapes": ("ring", "letters"),
            "text": "SWARM",
            "turn_rate": 1.0,
            "change_every": 75.0,
            "horizon": 1500,
            "min_in_place": 0.55,
            **AIRSPACE_DIFFICULTIES["extreme"],
        },
    }

    def __init__(self, config: FormationConfig, context: TaskContext) -> None:
        """Find the places, check that drones can follow them, and set the arena.

        Raises:
            ValueError: If a shape is invalid, has too few places or places that are too close; if
                places move too fast or are too low; if shapes or places change too often; or if
                drones could start in conflict.
        """
        super().__init__(config, context)
        self.plan = FormationPlan(config, context)
        self.holding = self.add(HoldingWhere(config.min_in_place, context, self.finished))
        turn = float(np.radians(config.turn_rate))
        clock = (context.duration, context.period)
        self.course = Course(config.leader_speed, turn, config.altitude, *clock)
        self._block = self._starts(context.num_drones)
        self._lay_out()

    def _starts(self, drones: int) -> np.ndarray:
        """Return starts in a square block around the leader, (N, 3) m.

        Raises:
            ValueError: If neighbours could start in conflict.
        """
        config, apart = self.config, clearance(self.config, self.context)
        nearest = min_start_distance(config, config.spacing)
        if drones > 1 and nearest <= apart:
            raise ValueError(
                f"start positions may be in conflict: spacing {config.spacing:g} m with jitter "
                f"{config.jitter:g} m leaves {nearest:.3g} m between neighbours, "
                f"more than {apart:.3g} m (d_safe) is needed"
            )
        columns = int(np.ceil(np.sqrt(drones)))
        index = np.arange(drones)
        grid = np.stack([index // columns, index % columns, np.zeros(drones)], axis=1)
        block: np.ndarray = config.spacing * (grid - grid.mean(axis=0))
        return block

    def _lay_out(self) -> None:
        """Set an arena that contains all places, after checking that they are above the ground."""
        config = self.config
        every = np.concatenate([self._block, *self.plan.shapes])
        extent = float(np.linalg.norm(every[:, :2], axis=1).max())
        radius = self.course.radius + extent
        self.arena_low, self.arena_high = circle_arena(config, self.context, radius)
        self.arena_high[2] += every[:, 2].max()
        lowest = config.altitude + float(every[:, 2].min())
        if lowest <= self.context.collision_radius:
            raise ValueError(
                f"altitude {config.altitude:g} m is too low: the lowest place of shapes is "
                f"{lowest:.3g} m up, more than {self.context.collision_radius:.3g} m is needed"
            )

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shapes of the memory of `GoalFlight`, of the leader and of the places.

        Returns:
            Of the leader: "leader" (4,), position, m, and yaw, rad; "leader_velocity" (3,), m/s;
                "course" (), yaw at the start, rad; "turn" (), rad/s. "place" (N,), index of each
                drone's place. "asked" (), time of the last change of places, s; "formed" (),
                duration from this change until all drones were in place, s, 0 before.
        """
        drones = self.context.num_drones
        of_leader = {"leader": (4,), "leader_velocity": (3,), "course": (), "turn": ()}
        of_shape = {"place": (drones,), "asked": (), "formed": ()}
        return {**super().memory(), **of_leader, **of_shape}

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw starts in a block around the leader, in random order, in flight."""
        course = rng.uniform(-np.pi, np.pi)
        turn = self.course.turn if rng.uniform() < 0.5 else -self.course.turn
        leader = self.course.at(np.zeros(1), np.array([course]), np.array([turn]))
        in_order = self._block[rng.permutation(self.context.num_drones)]
        start = self.config.scattered(in_world(in_order[None], leader)[0][0], rng)
        memory = {
            "leader": np.append(leader.position, leader.yaw),
            "leader_velocity": leader.velocity[0],
            "course": np.array(course),
            "turn": np.array(turn),
        }
        along = np.tile((cos(course), sin(course), 0.0), (len(start), 1))
        spawn = self.launch(start, start, rng, along, memory=memory)
        return self._assign_start_places(spawn, start, leader)

    def _assign_start_places(self, spawn: Spawn, start: np.ndarray, leader: Leader) -> Spawn:
        """Assign places to drones that start at (N, 3), m, and set their goals."""
        place = self.plan.first(start, leader)
        goal, goal_velocity = in_world(self.plan.shapes[None, 0, place], leader)
        memory = {**spawn.memory, "place": place}
        return spawn._replace(goal=goal[0], goal_velocity=goal_velocity[0], memory=memory)

    def finish(self, spawn: Spawn, given: GivenPositions, rng: np.random.Generator) -> Spawn:
        """Apply given starts and assign drones to places from there.

        Raises:
            ValueError: If there is no space for obstacles.
        """
        if given.start is not None:
            course, turn = (np.atleast_1d(spawn.memory[name]) for name in ("course", "turn"))
            leader = self.course.at(np.zeros(1), course, turn)
            spawn = self._assign_start_places(spawn, given.start, leader)
        return super().finish(spawn, given, rng)

    def move_scene(self, scene: Scene, time: np.ndarray, flying: np.ndarray, rngs: Rngs) -> bool:
        """Move the leader, and the drones' places with it."""
        memory = scene.memory
        turn, period = memory["turn"][flying], self.context.period
        leader = self.course.at(time[flying] + period, memory["course"][flying], turn)
        memory["leader"][flying] = np.column_stack([leader.position, leader.yaw])
        memory["leader_velocity"][flying] = leader.velocity
        place = memory["place"][flying].astype(int)
        shape = self.plan.shape_at(time[flying])
        goal, goal_velocity = in_world(self.plan.shapes[shape[:, None], place], leader)
        scene.goal[flying], scene.goal_velocity[flying] = goal, goal_velocity
        return super().move_scene(scene, time, flying, rngs)

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Update times to form and in place, and reassign places when due."""
        memory = frame.scene.memory
        in_place = self.finished(frame) & frame.alive
        flies = frame.alive.any(axis=1)
        is_first = flies & (in_place | ~frame.alive).all(axis=1) & (memory["formed"] == 0)
        np.copyto(memory["formed"], frame.time - memory["asked"], where=is_first)
        # Places do not change at the end of an episode
        for w in np.flatnonzero(flies & ~frame.last).tolist():
            self._reassign_places(frame, w, rngs[w])
        super().update_memory(frame, rngs)

    def _reassign_places(self, frame: Frame, w: int, rng: np.random.Generator) -> None:
        """Reassign places to a world's active drones if the shape or the assignment changes."""
        now, memory = frame.time[w], frame.scene.memory
        due = self.plan.due(now, self.context.period)
        if not any(due):
            return
        leader = self.course.at(frame.time[[w]], memory["course"][[w]], memory["turn"][[w]])
        alive = np.flatnonzero(frame.alive[w])
        position = frame.after.position[w, alive]
        place = memory["place"][w]
        place[alive] = self.plan.reassign(place[alive], position, leader, now, due, rng)
        memory["asked"][w], memory["formed"][w] = now, 0.0

    def succeeded(self, frame: Frame) -> np.ndarray:
        """Return which drones were in place for long enough, (W, N) bool."""
        return self.holding.has_held(frame)

    def goals_end(self, frame: Frame, finished: np.ndarray) -> np.ndarray:
        """Return zeros, as places are to be held and end no episode."""
        return np.zeros_like(finished)

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Return the errors of formation and shape, and the times to form and in place."""
        memory, shape = frame.scene.memory, frame.alive.shape
        swarm = (frame.after.position, frame.scene.goal, frame.alive)
        so_far = frame.time - memory["asked"]
        formed = np.where(memory["formed"] > 0, memory["formed"], so_far)
        of_world = {
            "formation_error": off_places(*swarm),
            "shape_error": off_shape(*swarm),
            "time_to_form": formed,
        }
        by_name = {name: np.broadcast_to(one[:, None], shape) for name, one in of_world.items()}
        return {**super().info(frame), **by_name}

    def world_state(self) -> Mapping[str, Block]:
        """Return position, velocity and turn rate of the leader."""
        labels = (
            *vector_labels("leader", "m", self.arena_low, self.arena_high),
            *leader_labels(self),
        )

        def moved(frame: Frame, present: np.ndarray) -> np.ndarray:
            memory = frame.scene.memory
            return np.column_stack(
                [memory["leader"][:, :3], memory["leader_velocity"][:, :2], memory["turn"]]
            )

        return {**super().world_state(), "leader": Block(labels, moved)}
