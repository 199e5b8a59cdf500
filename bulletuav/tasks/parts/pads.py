"""Landing pads: discs that may move and rock, each of which one drone may claim by landing."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from bulletuav.compiled.functions import cos, hypot, sin, tan
from bulletuav.compiled.kernel import func, kernel
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.rotation import axes, cross, exp_map, minus, plus, quat4, to_body, vec3
from bulletuav.sensors.base import Label, vector_labels
from bulletuav.tasks.frame import Frame, Scene
from bulletuav.tasks.observations.base import Block
from bulletuav.tasks.parts.base import Part, Rngs
from bulletuav.vehicle.swarm import FIRST_OBSTACLE, Swarm

PAD_RADIUS, PAD_THICKNESS = 0.6, 0.2
"""Radius and thickness of pads, m"""
MAX_VERTICAL_SPEED, MAX_HORIZONTAL_SPEED = 0.5, 0.6
"""Maximum speeds of a stable landing relative to the pad, m/s"""
MAX_LANDING_TILT = 0.26
"""Maximum roll and pitch of a stable landing relative to the pad, rad"""
STABLE_TIME = 0.5
"""Time of stable contact by which a drone claims a pad, s"""
GREEN = (0.2, 0.6, 0.3, 1.0)
"""Colour of pads, RGBA"""
ROUNDING = 1e-6
"""Tolerance of the time of contact, s, for decisions that are not exact"""


class PadMotion(NamedTuple):
    """Motion of all pads: together on circles, and rocking, each about a horizontal axis.

    Attributes:
        speed: Speed along the circles, m/s.
        radius: Radius of the circles, m.
        tilt: Amplitude of the rocking, rad.
        period: Period of the rocking, s.
    """

    speed: float
    radius: float
    tilt: float
    period: float

    @property
    def moves(self) -> bool:
        """Whether pads move or rock."""
        return self.speed > 0 or self.tilt > 0


class Pads(Part):
    """Pads of a world, which are its first obstacles, and the landings on them.

    A drone claims a pad by `STABLE_TIME` of uninterrupted contact on its top, in which its vertical
    and horizontal speed, roll and pitch relative to the pad are within the limits above. A pad can
    be claimed once.

    Attributes:
        count: Number of pads P.
        motion: Their motion.
    """

    def __init__(self, count: int, num_drones: int, period: float, motion: PadMotion) -> None:
        """Set the number of pads.

        Args:
            count: Number of pads of each world, P.
            num_drones: Number of drones of each world, N.
            period: Time between decisions, s.
            motion: Motion of the pads.
        """
        self.count, self._num_drones, self._period, self.motion = count, num_drones, period, motion

    def obstacles(self) -> Sequence[Obstacle]:
        """Return the pads."""
        return (Obstacle("cylinder", (PAD_RADIUS, PAD_THICKNESS), GREEN),) * self.count

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shapes of the memory of pads and landings.

        Returns:
            "pad_place" (P, 3), centres of the circles, m; "pad_phase" (), phase of the motion along
            the circles, rad; "pad_turn" (), 1 for counterclockwise, -1 for clockwise; "rock_axis"
            and "rock_phase" (P,), heading of the axis and phase of the rocking, rad; "pad_spin" (P,
            3), angular velocities, rad/s; "claimed" (P,), 1 + index of the drone that claimed the
            pad, or 0; "stable_time" (N,), time of stable contact so far, s; "touched_pad" (N,), 1 +
            index of the pad of this contact, or 0; "landing" (N,), 1 in the decision in which the
            drone claims a pad; "has_pad" (N,), 1 since then.
        """
        pads, drones = (self.count,), (self._num_drones,)
        return {
            "pad_place": (*pads, 3),
            "pad_phase": (),
            "pad_turn": (),
            "rock_axis": pads,
            "rock_phase": pads,
            "pad_spin": (*pads, 3),
            "claimed": pads,
            **dict.fromkeys(("stable_time", "touched_pad", "landing", "has_pad"), drones),
        }

    def draw(self, place: np.ndarray, rng: np.random.Generator) -> dict[str, np.ndarray]:
        """Draw the motion of pads.

        Args:
            place: (P, 3) centres of the circles, m.
            rng: Generator of the world.

        Returns:
            Memory of the start, by name.
        """
        phase, turn = rng.uniform(-np.pi, np.pi), float(rng.choice((-1.0, 1.0)))
        axis, rock = rng.uniform(-np.pi, np.pi, (2, self.count))
        memory = {"pad_place": place, "pad_phase": np.array(phase), "pad_turn": np.array(turn)}
        return memory | {"rock_axis": axis, "rock_phase": rock}

    def poses(
        self, memory: Mapping[str, np.ndarray], time: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return positions, velocities, attitudes and angular velocities of pads.

        Args:
            memory: Memory of worlds (W, ...).
            time: (W,) time since the start, s.

        Returns:
            (W, P, 3) m, (W, P, 3) m/s, (W, P, 4) body to world, and (W, P, 3) rad/s.
        """
        motion, place = self.motion, memory["pad_place"]
        aside, velocity = np.zeros((2, len(place), 3))
        if motion.speed:
            rate = memory["pad_turn"] * motion.speed / motion.radius
            angle = memory["pad_phase"] + rate * time
            aside[:, 0], aside[:, 1] = motion.radius * cos(angle), motion.radius * sin(angle)
            velocity[:, 0], velocity[:, 1] = -rate * aside[:, 1], rate * aside[:, 0]
        tilt, speed = np.zeros((2, *place.shape[:2]))
        if motion.tilt:
            frequency = 2 * np.pi / motion.period
            phase = memory["rock_phase"] + frequency * time[:, None]
            tilt, speed = motion.tilt * sin(phase), motion.tilt * frequency * cos(phase)
        heading = memory["rock_axis"]
        axis = np.stack([cos(heading), sin(heading), np.zeros(heading.shape)], axis=-1)
        quaternion = np.zeros((*place.shape[:2], 4))
        rotate_each(tilt[..., None] * axis, quaternion)
        spin = speed[..., None] * axis
        moved = np.broadcast_to(velocity[:, None], place.shape)
        return place + aside[:, None], moved, quaternion, spin

    def move_scene(self, scene: Scene, time: np.ndarray, flying: np.ndarray, rngs: Rngs) -> bool:
        """Move the pads of flying worlds through one decision; see `Part.move_scene`."""
        if not self.motion.moves:
            return False
        memory = {name: scene.memory[name][flying] for name in self.memory()}
        position, velocity, quaternion, spin = self.poses(memory, time[flying] + self._period)
        # The velocity is that of the straight motion in the decision
        moved = (position - scene.obstacle[flying, : self.count]) / self._period
        scene.obstacle_velocity[flying, : self.count] = moved if self.motion.speed else velocity
        scene.obstacle[flying, : self.count] = position
        scene.obstacle_quaternion[flying, : self.count] = quaternion
        scene.memory["pad_spin"][flying] = spin
        return True

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Update the times of stable contact, and the claims."""
        scene, memory = frame.scene, frame.scene.memory
        update_landings(
            self._find_touched(frame),
            frame.after,
            frame.alive,
            (scene.obstacle, scene.obstacle_quaternion, scene.obstacle_velocity),
            memory["pad_spin"],
            self._period,
            memory["stable_time"],
            memory["touched_pad"],
            memory["claimed"],
            memory["landing"],
            memory["has_pad"],
        )

    def _find_touched(self, frame: Frame) -> np.ndarray:
        """Return the pad that each drone stands on, (W, N) index, or -1."""
        touched = np.full(frame.alive.shape, -1)
        contacts = frame.contacts
        pad = FIRST_OBSTACLE - contacts.other
        rows = (pad >= 0) & (pad < self.count)
        touched[contacts.world[rows], contacts.drone[rows]] = pad[rows]
        touched[~frame.landed] = -1
        return touched

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Return "stable_time", the time of stable contact so far, s."""
        return {"stable_time": frame.scene.memory["stable_time"]}

    def world_state(self) -> Mapping[str, Block]:
        """Return the positions, axes and velocities of the pads, and whether they are claimed."""
        labels: list[Label] = []
        far, fast = np.full(3, 1000.0), np.full(3, max(self.motion.speed, 1.0))
        for k in range(self.count):
            labels += vector_labels(f"pad {k}", "m", -far, far)
            labels += vector_labels(f"pad {k} up", "1", -np.ones(3), np.ones(3))
            labels += vector_labels(f"pad {k} velocity", "m/s", -fast, fast)
            labels.append(Label(f"pad {k} claimed", "1", 0.0, 1.0))

        def compute(frame: Frame, present: np.ndarray) -> np.ndarray:
            scene = frame.scene
            shape = (len(present), self.count, 1)
            columns = (
                scene.obstacle[:, : self.count],
                pad_axes(scene.obstacle_quaternion[:, : self.count]),
                scene.obstacle_velocity[:, : self.count],
                (scene.memory["claimed"] > 0).reshape(shape),
            )
            return np.concatenate(columns, axis=-1).reshape(len(present), -1)

        return {"pads": Block(tuple(labels), compute)}

    def quantities(self) -> Mapping[str, Any]:
        """Return the number of pads."""
        return {"num_pads": self.count}


@kernel
def rotate_each(rotation: np.ndarray, quaternion: np.ndarray) -> None:
    """Write the quaternions (W, P, 4) of rotations (W, P, 3), axis times angle."""
    for w in range(rotation.shape[0]):
        for p in range(rotation.shape[1]):
            turned = exp_map(vec3(rotation, w, p))
            for k in range(4):
                quaternion[w, p, k] = turned[k]


def pad_axes(quaternion: np.ndarray) -> np.ndarray:
    """Return the upward axes (W, P, 3) of attitudes (W, P, 4)."""
    x, y, z, w = np.moveaxis(quaternion, -1, 0)
    up: np.ndarray = np.stack(
        [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=-1
    )
    return up


@func
def _is_stable(
    swarm: Swarm,
    pads: tuple[np.ndarray, np.ndarray, np.ndarray],
    spin: np.ndarray,
    w: int,
    i: int,
    p: int,
) -> bool:
    """Return True if the motion of drone i relative to pad p is that of a stable landing."""
    position, quaternion, velocity = pads
    arm = minus(vec3(swarm.position, w, i), vec3(position, w, p))
    carried = plus(vec3(velocity, w, p), 1.0, cross(vec3(spin, w, p), arm))
    east, north, up = minus(vec3(swarm.velocity, w, i), carried)
    if abs(up) > MAX_VERTICAL_SPEED or hypot(east, north) > MAX_HORIZONTAL_SPEED:
        return False
    # Axes of the drone in those of the pad: pitch = -asin(forward z), roll = atan2(left z, up z)
    turn = quat4(quaternion, w, p)
    forward, left, above = axes(quat4(swarm.quaternion, w, i))
    pitched, rolled = abs(to_body(turn, forward)[2]), abs(to_body(turn, left)[2])
    top = to_body(turn, above)[2]
    is_level: bool = (
        top > 0.0 and pitched <= sin(MAX_LANDING_TILT) and rolled <= tan(MAX_LANDING_TILT) * top
    )
    return is_level


@kernel
def update_landings(
    touched: np.ndarray,
    swarm: Swarm,
    alive: np.ndarray,
    pads: tuple[np.ndarray, np.ndarray, np.ndarray],
    spin: np.ndarray,
    period: float,
    stable_time: np.ndarray,
    touched_pad: np.ndarray,
    claimed: np.ndarray,
    landing: np.ndarray,
    has_pad: np.ndarray,
) -> None:
    """Update the times of stable contact and the claims after a decision.

    Of drones that would claim a pad in the same decision, the one with the lowest index does.

    Args:
        touched: (W, N) index of the pad that each drone stands on, or -1.
        swarm: State of the drones.
        alive: (W, N) bool, drones that flew the decision.
        pads: Positions (W, K, 3), m, attitudes (W, K, 4) and velocities (W, K, 3), m/s, of
            obstacles, of which the first P are pads.
        spin: (W, P, 3) angular velocities of the pads, rad/s.
        period: Length of the decision, s.
        stable_time: (W, N) time of stable contact, s; updated.
        touched_pad: (W, N) 1 + index of the pad of this contact, or 0; updated.
        claimed: (W, P) 1 + index of the drone that claimed the pad, or 0; updated.
        landing: (W, N) written: 1 for drones that claim a pad in this decision.
        has_pad: (W, N) 1 for drones that claimed a pad; updated.
    """
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            landing[w, i] = 0.0
            if not alive[w, i]:
                continue
            p = touched[w, i]
            if p < 0 or claimed[w, p] > 0.0 or not _is_stable(swarm, pads, spin, w, i, p):
                stable_time[w, i] = touched_pad[w, i] = 0.0
                continue
            if touched_pad[w, i] != p + 1:
                stable_time[w, i] = 0.0
            touched_pad[w, i] = p + 1
            stable_time[w, i] += period
            if stable_time[w, i] >= STABLE_TIME - ROUNDING:
                claimed[w, p] = i + 1
                landing[w, i] = has_pad[w, i] = 1.0
