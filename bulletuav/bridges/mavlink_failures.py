"""Injected failures of a MAVLink vehicle: motors, GPS receiver and battery.

Source: MAV_CMD_INJECT_FAILURE, https://mavlink.io/en/messages/common.html.
"""

from collections.abc import Callable, Mapping, Sequence

from bulletuav.bridges.mavlink_protocol import CommandResult, RefusedError
from bulletuav.bridges.setpoints import PX4_CORNERS, find_corners
from bulletuav.vehicle.airframe import Airframe

GPS, BATTERY, MOTOR = 4, 100, 101
"""Units that can fail (FAILURE_UNIT)"""
OK, OFF = 0, 1
"""Types of failures (FAILURE_TYPE)"""


class Failures:
    """Failures of one vehicle, by command 420.

    Attributes:
        has_gps: Whether the GPS receiver works.
        is_battery_empty: Whether the battery is depleted.
    """

    def __init__(
        self,
        airframe: Airframe,
        values: Mapping[str, float],
        set_rotors: Callable[[Sequence[float]], None],
    ) -> None:
        """Initialise without failures.

        Args:
            airframe: Airframe of the vehicle.
            values: Values of the parameters.
            set_rotors: Function that sets the effectiveness (R,) of the rotors, from 0 to 1.
        """
        self._airframe, self._values, self._set_rotors = airframe, values, set_rotors
        self.has_gps, self.is_battery_empty = True, False
        self._effectiveness = [1.0] * len(airframe.rotors)

    def inject(self, unit: int, kind: int, instance: int) -> None:
        """Inject or clear a failure.

        Args:
            unit: `GPS`, `BATTERY` or `MOTOR`.
            kind: `OFF`, or `OK` to repair.
            instance: Number of the motor, from 1 on, in PX4's order; 0 for all.

        Raises:
            RefusedError: If SYS_FAILURE_EN is 0, or the unit, the kind or the motor does not exist.
        """
        if not self._values["SYS_FAILURE_EN"]:
            raise RefusedError("failures are disabled: set SYS_FAILURE_EN to 1")
        if unit not in (GPS, BATTERY, MOTOR):
            reason = f"failure of unit {unit}: use 4, 100 or 101"
            raise RefusedError(reason, CommandResult.UNSUPPORTED)
        if kind not in (OK, OFF):
            raise RefusedError(f"failure {kind}: use 0 (ok) or 1 (off)", CommandResult.UNSUPPORTED)
        if unit == GPS:
            self.has_gps = kind == OK
        elif unit == BATTERY:
            self.is_battery_empty = kind == OFF
        else:
            self._fail_motor(instance, float(kind == OK))

    def _fail_motor(self, instance: int, effectiveness: float) -> None:
        """Set the effectiveness of a motor, or of all motors for 0."""
        count = len(self._effectiveness)
        if not 0 <= instance <= count:
            raise RefusedError(f"motor {instance}: there are {count}; 0 for all")
        rotors = list(range(count))
        if instance:
            try:
                rotors = [find_corners(self._airframe).index(PX4_CORNERS[instance - 1])]
            except ValueError:
                raise RefusedError("single motors fail on quadrotors only") from None
        for rotor in rotors:
            self._effectiveness[rotor] = effectiveness
        self._set_rotors(self._effectiveness)
