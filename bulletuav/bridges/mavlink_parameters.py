"""Parameters of a MAVLink vehicle, by PX4's names."""

import math
import struct
from typing import Any, NamedTuple

import numpy as np

from bulletuav.bridges.mavlink_protocol import Message, OutgoingMessage, RefusedError
from bulletuav.bridges.mavlink_wings import forward_thrust
from bulletuav.geometry.obstacle import DEFAULT_FRICTION
from bulletuav.vehicle.airframe import STANDARD_GRAVITY, Airframe

INT32, REAL32 = 6, 9
"""Parameter types (MAV_PARAM_TYPE)"""


class MavlinkParameter(NamedTuple):
    """Parameter of PX4.

    Attributes:
        value: Default value; an int for INT32 parameters.
        minimum, maximum: Bounds.
    """

    value: float
    minimum: float
    maximum: float


PARAMETERS = {
    "COM_DISARM_LAND": MavlinkParameter(2.0, -1.0, 20.0),
    "COM_DISARM_PRFLT": MavlinkParameter(10.0, -1.0, 60.0),
    "COM_LOW_BAT_ACT": MavlinkParameter(0, 0, 3),
    "COM_OF_LOSS_T": MavlinkParameter(1.0, 0.1, 60.0),
    "COM_RC_LOSS_T": MavlinkParameter(0.5, 0.1, 35.0),
    "FLW_TGT_ALT_M": MavlinkParameter(0, 0, 2),
    "FLW_TGT_DST": MavlinkParameter(8.0, 1.0, 100.0),
    "FLW_TGT_FA": MavlinkParameter(180.0, -180.0, 180.0),
    "FLW_TGT_HT": MavlinkParameter(8.0, 8.0, 100.0),
    "FLW_TGT_MAX_VEL": MavlinkParameter(5.0, 0.1, 20.0),
    "FLW_TGT_RS": MavlinkParameter(0.1, 0.0, 1.0),
    "FW_AIRSPD_MAX": MavlinkParameter(20.0, 0.5, 100.0),
    "FW_AIRSPD_MIN": MavlinkParameter(10.0, 0.5, 100.0),
    "FW_AIRSPD_TRIM": MavlinkParameter(15.0, 0.5, 100.0),
    "FW_LND_ANG": MavlinkParameter(5.0, 1.0, 15.0),
    "GF_ACTION": MavlinkParameter(2, 0, 5),
    "GF_MAX_HOR_DIST": MavlinkParameter(0.0, 0.0, 10000.0),
    "GF_MAX_VER_DIST": MavlinkParameter(0.0, 0.0, 10000.0),
    "MAV_SYS_ID": MavlinkParameter(1, 1, 250),
    "MIS_DIST_1WP": MavlinkParameter(900.0, -1.0, 100000.0),
    "MIS_TAKEOFF_ALT": MavlinkParameter(2.5, 0.0, 80.0),
    "MPC_LAND_SPEED": MavlinkParameter(0.7, 0.2, 5.0),
    "MPC_MAN_TILT_MAX": MavlinkParameter(35.0, 1.0, 60.0),
    "MPC_MAN_Y_MAX": MavlinkParameter(150.0, 0.0, 400.0),
    "MPC_THR_HOVER": MavlinkParameter(0.5, 0.0, 1.0),
    "MPC_TKO_SPEED": MavlinkParameter(1.5, 0.2, 5.0),
    "MPC_VEL_MANUAL": MavlinkParameter(10.0, 0.1, 20.0),
    "MPC_XY_CRUISE": MavlinkParameter(5.0, 0.2, 20.0),
    "MPC_YAWRAUTO_MAX": MavlinkParameter(60.0, 5.0, 360.0),
    "MPC_Z_VEL_MAX_DN": MavlinkParameter(1.5, 0.2, 10.0),
    "MPC_Z_VEL_MAX_UP": MavlinkParameter(3.0, 0.2, 10.0),
    "NAV_ACC_RAD": MavlinkParameter(10.0, 0.05, 200.0),
    "NAV_FW_ALT_RAD": MavlinkParameter(10.0, 0.05, 200.0),
    "NAV_LOITER_RAD": MavlinkParameter(80.0, 25.0, 1000.0),
    "RTL_DESCEND_ALT": MavlinkParameter(30.0, 0.0, 100.0),
    "RTL_LAND_DELAY": MavlinkParameter(-1.0, -1.0, 3600.0),
    "RTL_RETURN_ALT": MavlinkParameter(60.0, 0.0, 150.0),
    "RWTO_TKOFF": MavlinkParameter(0, 0, 1),
    "SYS_FAILURE_EN": MavlinkParameter(0, 0, 1),
}
"""Supported parameters"""
READ_ONLY = ("MAV_SYS_ID", "MPC_THR_HOVER")
NAMES = sorted(PARAMETERS)


def wing_parameters(airframe: Airframe, row: np.record) -> dict[str, float]:
    """Return the values of an aircraft with wings that differ from the defaults, by name.

    Take-off altitudes are PX4's for VTOLs and fixed wings (`rc.vtol_defaults`, `rc.fw_defaults`);
    speeds and the radius of loiters are those of the airframe. Aircraft take off from a runway if
    their thrust is more than twice their friction there.

    Args:
        airframe: The airframe.
        row: Its row of `AUTOPILOT`.
    """
    friction = math.sqrt(airframe.friction * DEFAULT_FRICTION) * airframe.mass * STANDARD_GRAVITY
    return {
        "FW_AIRSPD_MAX": float(row["max_speed"]),
        "FW_AIRSPD_MIN": float(row["min_speed"]),
        "FW_AIRSPD_TRIM": float(row["cruise_speed"]),
        "MIS_TAKEOFF_ALT": 20.0 if row["can_hover"] else 25.0,
        "RWTO_TKOFF": int(forward_thrust(airframe) > 2 * friction),
        "NAV_LOITER_RAD": max(float(math.ceil(row["loiter_radius"])), 25.0),
    }


class MavlinkParameterService:
    """Parameter values of one vehicle, and the messages of the parameter protocol.

    Attributes:
        values: Values by name.
    """

    def __init__(self, **overrides: float) -> None:
        """Initialise with the default values, and with the given values of this vehicle."""
        self.values = {name: parameter.value for name, parameter in PARAMETERS.items()} | overrides

    def make_value_message(self, name: str) -> OutgoingMessage:
        """Return the PARAM_VALUE message of a parameter."""
        value, parameter_type = self.values[name], _parameter_type(name)
        # PX4 encodes integers bytewise in the float field (MAV_PARAM_ENCODE_BYTEWISE)
        encoded = (
            struct.unpack("<f", struct.pack("<i", int(value)))[0]
            if parameter_type == INT32
            else value
        )
        fields = (name.encode(), encoded, parameter_type, len(NAMES), NAMES.index(name))
        return OutgoingMessage("param_value", fields)

    def answer(self, message: Message) -> list[OutgoingMessage]:
        """Handle a message of the parameter protocol.

        Raises:
            RefusedError: If there is no such parameter.
        """
        message_type = message.get_type()
        if message_type == "PARAM_REQUEST_LIST":
            return [self.make_value_message(name) for name in NAMES]
        if message_type == "PARAM_REQUEST_READ":
            index = message.param_index
            if index >= 0:
                if index >= len(NAMES):
                    raise RefusedError(f"no parameter {index}: there are {len(NAMES)}")
                return [self.make_value_message(NAMES[index])]
            return [self.make_value_message(_check_name(message.param_id))]
        return [self._set_value(message)]

    def _set_value(self, message: Message) -> OutgoingMessage:
        """Set a parameter. An invalid value is ignored: the answer contains the value in effect."""
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
    return INT32 if isinstance(PARAMETERS[name].value, int) else REAL32


def _check_name(name: Any) -> str:
    """Return the name of a parameter; raise RefusedError if there is none."""
    if name not in PARAMETERS:
        raise RefusedError(f"no parameter {str(name)[:16]}")
    return str(name)
