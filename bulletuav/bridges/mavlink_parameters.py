"""Parameters of a MAVLink vehicle, by PX4's names."""

import math
import struct
from typing import Any, NamedTuple

from bulletuav.bridges.mavlink_protocol import Message, OutgoingMessage, RefusedError

INT32, REAL32 = 6, 9
"""Types of parameters on the wire: 32 bits, whole or not"""
MAX_INT32 = 2**31 - 1


class MavlinkParameter(NamedTuple):
    """One parameter.

    Attributes:
        value: At the start; whole numbers are told as such.
        least, most: Bounds.
    """

    value: float
    minimum: float
    maximum: float


PARAMETERS = {
    "COM_DISARM_LAND": MavlinkParameter(2.0, -1.0, 20.0),
    "COM_DISARM_PRFLT": MavlinkParameter(10.0, -1.0, 60.0),
    "COM_OF_LOSS_T": MavlinkParameter(1.0, 0.1, 60.0),
    "GF_ACTION": MavlinkParameter(2, 0, 5),
    "GF_MAX_HOR_DIST": MavlinkParameter(0.0, 0.0, 10000.0),
    "GF_MAX_VER_DIST": MavlinkParameter(0.0, 0.0, 10000.0),
    "MAV_SYS_ID": MavlinkParameter(1, 1, 250),
    "MIS_DIST_1WP": MavlinkParameter(900.0, -1.0, 100000.0),
    "MIS_TAKEOFF_ALT": MavlinkParameter(2.5, 0.0, 80.0),
    "MPC_LAND_SPEED": MavlinkParameter(0.7, 0.2, 5.0),
    "MPC_THR_HOVER": MavlinkParameter(0.5, 0.0, 1.0),
    "MPC_TKO_SPEED": MavlinkParameter(1.5, 0.2, 5.0),
    "MPC_XY_CRUISE": MavlinkParameter(5.0, 0.2, 20.0),
    "MPC_YAWRAUTO_MAX": MavlinkParameter(60.0, 5.0, 360.0),
    "MPC_Z_VEL_MAX_DN": MavlinkParameter(1.5, 0.2, 10.0),
    "MPC_Z_VEL_MAX_UP": MavlinkParameter(3.0, 0.2, 10.0),
    "RTL_DESCEND_ALT": MavlinkParameter(30.0, 0.0, 100.0),
    "RTL_RETURN_ALT": MavlinkParameter(60.0, 0.0, 150.0),
}
"""What there is, in the order of their numbers"""
READ_ONLY = ("MAV_SYS_ID", "MPC_THR_HOVER")
NAMES = sorted(PARAMETERS)


class MavlinkParameterService:
    """Values of the parameters, and the messages about them.

    Attributes:
        values: By name.
    """

    def __init__(self, **overrides: float) -> None:
        """Begin with the defaults, but for those that are known of this vehicle."""
        self.values = {name: parameter.value for name, parameter in PARAMETERS.items()} | overrides

    def make_value_message(self, name: str) -> OutgoingMessage:
        """Tell the value of a parameter."""
        value, kind = self.values[name], _parameter_type(name)
        # PX4 puts whole numbers into the field of a float as they are, bit by bit.
        encoded = struct.unpack("<f", struct.pack("<i", int(value)))[0] if kind == INT32 else value
        fields = (name.encode(), encoded, kind, len(NAMES), NAMES.index(name))
        return OutgoingMessage("param_value", fields)

    def answer(self, message: Message) -> list[OutgoingMessage]:
        """Answer a message about parameters.

        Raises:
            RefusedError: There is no such parameter, or the value cannot be.
        """
        kind = message.get_type()
        if kind == "PARAM_REQUEST_LIST":
            return [self.make_value_message(name) for name in NAMES]
        if kind == "PARAM_REQUEST_READ":
            index = message.param_index
            if index >= 0:
                if index >= len(NAMES):
                    raise RefusedError(f"there is no parameter {index}: {len(NAMES)} are")
                return [self.make_value_message(NAMES[index])]
            return [self.make_value_message(_check_name(message.param_id))]
        return [self._set_value(message)]

    def _set_value(self, message: Message) -> OutgoingMessage:
        """Set a parameter; what cannot be is answered with the value that stays."""
        name = _check_name(message.param_id)
        value = message.param_value
        if message.param_type == INT32:
            value = struct.unpack("<i", struct.pack("<f", value))[0]
        parameter = PARAMETERS[name]
        allowed = math.isfinite(value) and parameter.minimum <= value <= parameter.maximum
        if allowed and name not in READ_ONLY and message.param_type == _parameter_type(name):
            self.values[name] = value
        return self.make_value_message(name)


def _parameter_type(name: str) -> int:
    """Tell the type of a parameter on the wire."""
    return INT32 if isinstance(PARAMETERS[name].value, int) else REAL32


def _check_name(name: Any) -> str:
    """Check that there is a parameter of a name."""
    if name not in PARAMETERS:
        raise RefusedError(f"no parameter {str(name)[:16]}")
    return str(name)
