"""A vehicle of AirSim's API: control, arming, motion, collision, cameras and range finders."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from bulletuav.bridges.airsim_beams import RangeFinder
from bulletuav.bridges.airsim_cameras import AirsimCamera
from bulletuav.bridges.motions import DoneCallback, HoldPosition, MotionPrimitive, MotorsOff
from bulletuav.bridges.setpoints import NORTH, AirspaceCommand, Setpoint, SetpointController, State


class Collision:
    """Last collision of a vehicle since a client read it.

    Attributes:
        has_collided: Whether the vehicle has collided.
        time: Time of the collision, s.
        object_name: Name of the other object.
        object_id: Number of the other object in `Contacts`; -1 for none.
        point, normal: (3,) contact point, m, and contact normal towards the vehicle, east, north,
            up.
        position: (3,) position of the vehicle at the collision, m.
        depth: Penetration depth, m.
    """

    def __init__(self) -> None:
        """Create a record without a collision."""
        self.has_collided, self.time, self.object_name, self.object_id = False, 0.0, "", -1
        self.point = self.normal = self.position = np.zeros(3)
        self.depth = 0.0


class RemoteControl(NamedTuple):
    """Sticks of a remote control, whose full deflection is 10,000, as in AirSim.

    Attributes:
        roll, pitch, throttle, yaw: Deflections: right, forward, up, clockwise.
        is_valid: Whether a remote control is connected.
    """

    roll: float = 0.0
    pitch: float = 0.0
    throttle: float = 0.0
    yaw: float = 0.0
    is_valid: bool = False


class AirsimVehicle:
    """State of one vehicle: control, arming, motion and collision.

    Attributes:
        name: Name that clients use.
        start: (3,) start position, m: the origin of the vehicle's coordinates.
        attitude: Attitude at the start: quaternion x, y, z, w.
        cameras: Cameras by name.
        range_finders: Lidars and distance sensors by name.
        is_api_controlled: Whether a client has API control.
        is_armed: Whether the motors are armed.
        collision: Last collision.
        remote: Sticks that a client sent last.
        is_standing: Whether the vehicle touches a surface that it can stand on.
    """

    def __init__(
        self,
        name: str,
        start: np.ndarray,
        controller: SetpointController,
        attitude: tuple[float, ...] = NORTH,
        starts_armed: bool = True,
        cameras: Mapping[str, AirsimCamera] | None = None,
        range_finders: Mapping[str, RangeFinder] | None = None,
    ) -> None:
        """Create a vehicle on the ground with stopped motors."""
        self.name, self.start, self._controller = name, start, controller
        self.attitude, self._starts_armed = attitude, starts_armed
        self.cameras, self.range_finders = cameras or {}, range_finders or {}
        self.collision = Collision()
        self._motion: MotionPrimitive = MotorsOff()
        self._done_callback: DoneCallback | None = None
        self.restart()

    def restart(self) -> None:
        """Reset the vehicle to its initial state; the present motion fails."""
        self.finish(False)
        self._controller.reset()
        self._motion = MotorsOff()
        self.is_api_controlled, self.is_armed = False, self._starts_armed
        self.collision, self.is_standing = Collision(), True
        self.remote = RemoteControl()

    @property
    def is_flying(self) -> bool:
        """Whether the motors turn."""
        return not isinstance(self._motion, MotorsOff)

    def start_motion(self, motion: MotionPrimitive, done_callback: DoneCallback) -> None:
        """Start a motion; the present motion fails.

        Args:
            motion: The motion.
            done_callback: Function that is called with the outcome when the motion ends.
        """
        self.finish(False)
        self._motion, self._done_callback = motion, done_callback

    def finish(self, success: bool) -> None:
        """Report the outcome of the present motion to its client."""
        done_callback, self._done_callback = self._done_callback, None
        if done_callback is not None:
            done_callback(success)

    def hold_position(self, state: State) -> None:
        """End the present motion, and hold the position if the motors turn."""
        self.finish(False)
        if self.is_flying:
            self._motion = HoldPosition(state)

    def reset_after_placement(self, state: State) -> None:
        """Clear the collision and the held yaw after a placement, and hold the position."""
        self.collision = Collision()
        self._controller.reset()
        self.hold_position(state)

    def stop_motors(self) -> None:
        """End the present motion and stop the motors."""
        self.finish(False)
        self._motion = MotorsOff()

    def compute_command(self, state: State, now: float, period: float) -> AirspaceCommand | None:
        """Return the command of the next step; None stops the motors.

        Args:
            state: State of the vehicle.
            now: Time, s.
            period: Duration of the step, s.
        """
        setpoint = self._motion.get_setpoint(state, now) if self.is_armed else None
        if isinstance(setpoint, Setpoint):
            return self._controller.compute_command(setpoint, state, period)
        return setpoint

    def check_motion(self, state: State, now: float) -> None:
        """End the present motion if it has succeeded or failed."""
        if self._done_callback is None:
            return
        outcome = self._motion.check_outcome(state, now, self.is_standing)
        if outcome is not None:
            self._motion = self._motion.get_next_motion(state)
            self.finish(outcome)
