"""Parameters of a MAVLink vehicle, by PX4's names."""

import math
import struct
from typing import Any, NamedTuple

from bulletuav.bridges.mavlink_wire import Message, RefusedError, Told

INTEGER, REAL = 6, 9
"""Types of parameters on the wire: 32 bits, whole or not"""
MOST = 2**31 - 1


class Parameter(NamedTuple):
    """One parameter.

    Attributes:
        value: At the start; whole numbers are told as such.
        least, most: Bounds.
    """

    value: float
    least: float
    most: float


PARAMETERS = {
    "COM_DISARM_LAND": Parameter(2.0, -1.0, 20.0),
    "COM_DISARM_PRFLT": Parameter(10.0, -1.0, 60.0),
    "COM_OF_LOSS_T": Parameter(1.0, 0.1, 60.0),
    "GF_ACTION": Parameter(2, 0, 5),
    "GF_MAX_HOR_DIST": Parameter(0.0, 0.0, 10000.0),
    "GF_MAX_VER_DIST": Parameter(0.0, 0.0, 10000.0),
    "MAV_SYS_ID": Parameter(1, 1, 250),
    "MIS_DIST_1WP": Parameter(900.0, -1.0, 100000.0),
    "MIS_TAKEOFF_ALT": Parameter(2.5, 0.0, 80.0),
    "MPC_LAND_SPEED": Parameter(0.7, 0.2, 5.0),
    "MPC_THR_HOVER": Parameter(0.5, 0.0, 1.0),
    "MPC_TKO_SPEED": Parameter(1.5, 0.2, 5.0),
    "MPC_XY_CRUISE": Parameter(5.0, 0.2, 20.0),
    "MPC_YAWRAUTO_MAX": Parameter(60.0, 5.0, 360.0),
    "MPC_Z_VEL_MAX_DN": Parameter(1.5, 0.2, 10.0),
    "MPC_Z_VEL_MAX_UP": Parameter(3.0, 0.2, 10.0),
    "RTL_DESCEND_ALT": Parameter(30.0, 0.0, 100.0),
    "RTL_RETURN_ALT": Parameter(60.0, 0.0, 150.0),
}
"""What there is, in the order of their numbers"""
READ_ONLY = ("MAV_SYS_ID", "MPC_THR_HOVER")
NAMES = sorted(PARAMETERS)


class ParameterService:
    """Values of the parameters, and the messages about them.

    Attributes:
        values: By name.
    """

    def __init__(self, **known: float) -> None:
        """Begin with the defaults, but for those that are known of this vehicle."""
        self.values = {name: one.value for name, one in PARAMETERS.items()} | known

    def tell(self, name: str) -> Told:
        """Tell the value of a parameter."""
        value, kind = self.values[name], _kind(name)
        # PX4 puts whole numbers into the field of a float as they are, bit by bit.
        shown = struct.unpack("<f", struct.pack("<i", int(value)))[0] if kind == INTEGER else value
        fields = (name.encode(), shown, kind, len(NAMES), NAMES.index(name))
        return Told("param_value", fields)

    def answer(self, message: Message) -> list[Told]:
        """Answer a message about parameters.

        Raises:
            RefusedError: There is no such parameter, or the value cannot be.
        """
        kind = message.get_type()
        if kind == "PARAM_REQUEST_LIST":
            return [self.tell(name) for name in NAMES]
        if kind == "PARAM_REQUEST_READ":
            index = message.param_index
            if index >= 0:
                if index >= len(NAMES):
                    raise RefusedError(f"there is no parameter {index}: {len(NAMES)} are")
                return [self.tell(NAMES[index])]
            return [self.tell(_known(message.param_id))]
        return [self._set(message)]

    def _set(self, message: Message) -> Told:
        """Set a parameter; what cannot be is answered with the value that stays."""
        name = _known(message.param_id)
        value = message.param_value
        if message.param_type == INTEGER:
            value = struct.unpack("<i", struct.pack("<f", value))[0]
        one = PARAMETERS[name]
        allowed = math.isfinite(value) and one.least <= value <= one.most
        if allowed and name not in READ_ONLY and message.param_type == _kind(name):
            self.values[name] = value
        return self.tell(name)


def _kind(name: str) -> int:
    """Tell the type of a parameter on the wire."""
    return INTEGER if isinstance(PARAMETERS[name].value, int) else REAL


def _known(name: Any) -> str:
    """Check that there is a parameter of a name."""
    if name not in PARAMETERS:
        raise RefusedError(f"no parameter {str(name)[:16]}")
    return str(name)
