"""Starts in flight of aircraft that cannot hover: level in the air, at cruise speed, in trim.

The speed is that through the air: the wind is added to it. The nose turns into the wind by the crab
angle, so that the ground track keeps its direction.
"""

import math
from collections.abc import Sequence

import numpy as np

from bulletuav.compiled.functions import atan2, cos, sin
from bulletuav.geometry.rotation import from_euler, heading
from bulletuav.tasks.frame import Spawn
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.cruise import cruise_trim


class CruiseStarts:
    """State in cruise of those of N drones that cannot hover.

    Attributes:
        drones: (M,) indices of these drones.
        rotor_speed: (N, R) rotor speeds, rad/s; 0 for all other drones.
        deflection: (N, F) deflections of control surfaces, rad; 0 for all other drones.
    """

    def __init__(self, airframes: Sequence[Airframe], surfaces: int) -> None:
        """Trim the aircraft.

        Args:
            airframes: Airframe of each drone.
            surfaces: Number F of control surfaces in arrays.

        Raises:
            ValueError: If an aircraft has no trim.
        """
        forward = [one.needs_airspeed for one in airframes]
        self.drones = np.flatnonzero(forward)
        trims = [cruise_trim(airframes[i]) for i in self.drones.tolist()]
        self._airspeed = np.array([one.airspeed for one in trims])
        self._pitch = np.array([one.pitch for one in trims])
        self._sideslip = np.array([one.sideslip for one in trims])
        # At least one rotor, as for the hover speed
        rotors = max(1, *(len(one.rotors) for one in airframes))
        self.rotor_speed = np.zeros((len(airframes), rotors))
        self.deflection = np.zeros((len(airframes), surfaces))
        for i, trim in zip(self.drones.tolist(), trims, strict=True):
            self.rotor_speed[i, : len(trim.speed)] = trim.speed
            self.deflection[i, : len(trim.deflection)] = trim.deflection

    def apply_to(self, spawn: Spawn, has_goals: bool) -> Spawn:
        """Return a start with the aircraft in cruise, in calm air.

        They fly along their velocities, or to their goals if they have none, or along their yaws.
        The wind of an episode is drawn after its start: `write` then adds it.

        Args:
            spawn: A start as a task draws it.
            has_goals: Whether the drones have goals.
        """
        if not self.drones.size:
            return spawn
        shape = np.shape(spawn.position)
        velocity = np.array(np.broadcast_to(spawn.velocity, shape), dtype=float)
        quaternion = np.array(np.broadcast_to(spawn.quaternion, (*shape[:-1], 4)), dtype=float)
        rates = np.array(np.broadcast_to(spawn.rates, shape), dtype=float)
        to_goal = directions_to_goals(np.asarray(spawn.position), spawn.goal, has_goals)
        calm = np.zeros(shape)
        self.write((velocity, quaternion, rates), self.drones, to_goal, calm)
        return spawn._replace(velocity=velocity, quaternion=quaternion, rates=rates)

    def write(
        self,
        motion: tuple[np.ndarray, np.ndarray, np.ndarray],
        drones: np.ndarray,
        to_goal: np.ndarray,
        wind: np.ndarray,
    ) -> None:
        """Write the motion of some aircraft in cruise.

        In a crosswind above the cruise speed the nose points against the crosswind, and the
        aircraft drifts.

        Args:
            motion: Velocities (N, 3), m/s, whose directions are kept, attitudes (N, 4), and body
                rates (N, 3), rad/s; written.
            drones: (K,) indices of the aircraft, some of `drones`.
            to_goal: (N, 3) directions of aircraft without a horizontal velocity, of any length.
            wind: (N, 3) wind at the drones, world axes, m/s.
        """
        velocity, quaternion, rates = motion
        rows = np.searchsorted(self.drones, drones)
        for i, k in zip(drones.tolist(), rows.tolist(), strict=True):
            # The first horizontal direction that is not zero
            x, y = velocity[i, :2] if velocity[i, :2].any() else to_goal[i, :2]
            track = atan2(y, x) if x or y else heading(tuple(quaternion[i]))
            airspeed = self._airspeed[k]
            crosswind = wind[i, 1] * cos(track) - wind[i, 0] * sin(track)
            aside = max(-airspeed, min(-crosswind, airspeed))
            course = track + atan2(aside, math.sqrt(airspeed * airspeed - aside * aside))
            velocity[i] = airspeed * cos(course), airspeed * sin(course), 0.0
            velocity[i] += wind[i]
            # Air from the right turns the nose to the left; a nose up is a negative Euler angle
            quaternion[i] = from_euler(0.0, -self._pitch[k], course + self._sideslip[k])
            rates[i] = 0.0


def directions_to_goals(position: np.ndarray, goal: np.ndarray, has_goals: bool) -> np.ndarray:
    """Return the offsets from positions (..., 3) to goals, m; zeros in tasks without goals."""
    return goal - position if has_goals else np.zeros(position.shape)
