"""Conversion of setpoints by the controllers, from an action's level to that of a dynamics."""

import numpy as np

from bulletuav.compiled.kernel import allocating
from bulletuav.control.cascade import Cascade, command_kinematic, command_rotors
from bulletuav.control.setpoint import SetpointLevel, Setpoints
from bulletuav.geometry.rotation import quat4
from bulletuav.vehicle.swarm import DroneArrays, get_state

CONVERTED = (SetpointLevel.VELOCITY, SetpointLevel.ACCELERATION, SetpointLevel.ROTOR)
"""Levels that setpoints above them can be converted to"""


@allocating
def _convert(
    setpoints: Setpoints,
    consumes: int,
    drones: DroneArrays,
    cascade: Cascade,
    dt: float,
    gravity: float,
    converted: np.ndarray,
) -> None:
    """Fill `converted` for the active drones; see `convert`."""
    swarm, alive = drones.swarm, drones.alive
    command = np.zeros(converted.shape[2])
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            if not alive[w, i]:
                continue
            if consumes == SetpointLevel.ROTOR:
                # The whole cascade; columns that the drone lacks are zero
                command[:] = 0.0
                command_rotors(cascade, setpoints, swarm, w, i, dt, gravity, command)
                converted[w, i] = command
            else:
                # Only the outer loops; the yaw is passed on
                position, _, velocity, _ = get_state(swarm, w, i)
                wanted = quat4(setpoints.value, w, i)
                accelerates = consumes == SetpointLevel.ACCELERATION
                gain = cascade.gains[w, i]
                level = setpoints.level[w, i]
                target = command_kinematic(level, accelerates, wanted, position, velocity, gain)
                for k in range(3):
                    converted[w, i, k] = target[k]
                converted[w, i, 3] = wanted[3]


def convert(
    setpoints: Setpoints,
    consumes: SetpointLevel,
    drones: DroneArrays,
    cascade: Cascade,
    dt: float,
    gravity: float,
) -> np.ndarray:
    """Convert setpoints to the level that a dynamics consumes, once a substep.

    Args:
        setpoints: Setpoints at any levels.
        consumes: Level to convert to.
        drones: Present state; drones that are not alive get zeros.
        cascade: The controllers; their integrals and observers are updated.
        dt: Time since the last call, s.
        gravity: Gravitational acceleration, m/s^2.

    Returns:
        (W, N, 4) velocities or accelerations with yaw, (W, N, R + S) rotor speeds within their
        bounds and then deflections in the columns of `SetpointLevel`, or the setpoints unchanged if
        all levels equal `consumes`.

    Raises:
        ValueError: If no controller converts from one level to the other.
    """
    rotors = consumes == SetpointLevel.ROTOR
    if (setpoints.level == consumes).all() and not rotors:
        return setpoints.value
    lowest = SetpointLevel(setpoints.level.max())
    if consumes not in CONVERTED or lowest > consumes:
        raise ValueError(
            f"{lowest.name.lower()} setpoints cannot be converted to {consumes.name.lower()}: "
            f"the dynamics must consume velocity, acceleration or rotor setpoints"
        )
    swarm = drones.swarm
    width = swarm.rotor_speed.shape[2] + swarm.deflection.shape[2] if rotors else 4
    converted = np.zeros((*drones.alive.shape, width))
    _convert(setpoints, int(consumes), drones, cascade, dt, gravity, converted)
    return converted
