"""Gimbal of a MAVLink vehicle: stabilised pitch and yaw, by the gimbal protocol, version 2.

Source: https://mavlink.io/en/services/gimbal_v2.html.
"""

import math
from typing import Any

from bulletuav.bridges.setpoints import State, euler
from bulletuav.compiled.functions import atan2, cos, sin

DEVICE_ID = 1
"""Number of the gimbal; 0 in a command means all gimbals"""
MIN_PITCH, MAX_PITCH = -math.pi / 2, math.pi / 4
"""Limits of the pitch, rad; positive is upward"""
MAX_YAW = math.pi
ROLL_LOCK, PITCH_LOCK, YAW_LOCK, YAW_IN_VEHICLE_FRAME = 4, 8, 16, 32
"""Bits of GIMBAL_DEVICE_FLAGS; YAW_LOCK is the same bit of GIMBAL_MANAGER_FLAGS"""
CAPABILITIES = 8 | 16 | 32 | 256 | 512 | 1024 | 2048 | 1 << 17
"""Bits of GIMBAL_MANAGER_CAP_FLAGS: axes of pitch and yaw, which follow or lock, and a position to
look at; the lower ones are those of GIMBAL_DEVICE_CAP_FLAGS"""
UNCHANGED, SENDER, REMOVE = -1, -2, -3
"""Special numbers of a controlling system or component"""


class Gimbal:
    """Gimbal that turns immediately to its angles, within its limits.

    Attributes:
        controls: System and component of the primary and of the secondary control; 0 for none.
        is_yaw_locked: Whether the yaw is from north, instead of from the vehicle's heading.
        pitch, yaw: Angles, rad: upward, and clockwise.
    """

    def __init__(self) -> None:
        """Initialise with a view forward."""
        self.controls = [0, 0, 0, 0]
        self.is_yaw_locked = False
        self.pitch = self.yaw = 0.0
        self._pitch_rate = self._yaw_rate = 0.0
        self._target: tuple[float, float, float] | None = None
        self._time = 0.0

    def configure(self, numbers: list[int], sender: tuple[int, int]) -> None:
        """Set the controlling systems.

        Args:
            numbers: System and component of the primary and of the secondary control, or
                `UNCHANGED`, `SENDER` or `REMOVE`.
            sender: System and component of the sender.
        """
        for k, number in enumerate(numbers):
            if number != UNCHANGED:
                special = {SENDER: sender[k % 2], REMOVE: 0}
                self.controls[k] = special.get(number, number)

    def point(
        self, pitch: float, yaw: float, pitch_rate: float, yaw_rate: float, flags: int
    ) -> None:
        """Point to angles, rad, or turn at rates, rad/s; NaN leaves one out."""
        self._target = None
        self.is_yaw_locked = bool(flags & YAW_LOCK)
        self.pitch = pitch if math.isfinite(pitch) else self.pitch
        self.yaw = yaw if math.isfinite(yaw) else self.yaw
        self._pitch_rate = pitch_rate if math.isfinite(pitch_rate) else 0.0
        self._yaw_rate = yaw_rate if math.isfinite(yaw_rate) else 0.0
        self._limit()

    def look_at(self, position: tuple[float, float, float] | None) -> None:
        """Look at a position (3,), m, from now on; None looks forward."""
        self.point(0.0, 0.0, 0.0, 0.0, 0)
        self._target = position

    def update(self, state: State, now: float) -> None:
        """Turn until a time, s, on a vehicle in a state."""
        period, self._time = now - self._time, now
        if self._target is not None:
            east, north, up = (goal - own for goal, own in zip(self._target, state[0], strict=True))
            self.pitch = atan2(up, math.hypot(east, north))
            self.yaw = atan2(east, north) - compute_heading(state)
        else:
            self.pitch += self._pitch_rate * period
            self.yaw += self._yaw_rate * period
        self._limit()

    def _limit(self) -> None:
        """Keep the angles within their limits."""
        self.pitch = min(max(self.pitch, MIN_PITCH), MAX_PITCH)
        self.yaw = math.remainder(self.yaw, math.tau)

    def relative_yaw(self, state: State) -> float:
        """Return the yaw from the vehicle's heading, rad clockwise."""
        locked = compute_heading(state) if self.is_yaw_locked else 0.0
        return math.remainder(self.yaw - locked, math.tau)

    def attitude(self, state: State) -> list[float]:
        """Return the quaternion w, x, y, z of pitch and yaw from the vehicle's heading."""
        half_pitch, half_yaw = self.pitch / 2, self.relative_yaw(state) / 2
        return [
            cos(half_yaw) * cos(half_pitch),
            -sin(half_yaw) * sin(half_pitch),
            cos(half_yaw) * sin(half_pitch),
            sin(half_yaw) * cos(half_pitch),
        ]

    @property
    def flags(self) -> int:
        """Flags of the device."""
        locked = YAW_LOCK if self.is_yaw_locked else 0
        return ROLL_LOCK | PITCH_LOCK | YAW_IN_VEHICLE_FRAME | locked

    def manager_information(self, time_boot_ms: int) -> tuple[Any, ...]:
        """Return the fields of GIMBAL_MANAGER_INFORMATION."""
        limits = (0.0, 0.0, MIN_PITCH, MAX_PITCH, -MAX_YAW, MAX_YAW)
        return (time_boot_ms, CAPABILITIES, DEVICE_ID, *limits)

    def device_information(self, time_boot_ms: int) -> tuple[Any, ...]:
        """Return the fields of GIMBAL_DEVICE_INFORMATION."""
        names, limits = (b"bulletuav", b"gimbal", b""), self.manager_information(0)[3:]
        return (time_boot_ms, *names, 0, 0, 0, CAPABILITIES & 0xFFFF, 0, *limits, DEVICE_ID)

    def manager_status(self, time_boot_ms: int) -> tuple[Any, ...]:
        """Return the fields of GIMBAL_MANAGER_STATUS."""
        return (time_boot_ms, self.flags, DEVICE_ID, *self.controls)

    def attitude_status(self, time_boot_ms: int, state: State) -> tuple[Any, ...]:
        """Return the fields of GIMBAL_DEVICE_ATTITUDE_STATUS."""
        rates = (0.0, self._pitch_rate, self._yaw_rate)
        turned = (self.attitude(state), *rates, 0, compute_heading(state), math.nan, DEVICE_ID)
        return (0, 0, time_boot_ms, self.flags, *turned)


def compute_heading(state: State) -> float:
    """Return the heading of a vehicle, rad clockwise from north."""
    return math.remainder(math.pi / 2 - euler(state[1])[2], math.tau)
