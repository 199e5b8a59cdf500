"""Registry of the airframe constants that can be fitted."""

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from bulletuav.errors import suggest_names
from bulletuav.vehicle.airframe import Airframe

Get = Callable[[Airframe], float]
Replace = Callable[[Airframe, float], Airframe]


@dataclass(frozen=True)
class Constant:
    """A constant of an airframe that can be fitted.

    Attributes:
        name: Name in --fit and in reports.
        group: Name of the group that the constant belongs to, also accepted by --fit.
        unit: Physical unit.
        get: Function that returns the constant's value of an airframe.
        replace: Function that returns a copy of an airframe with another value of the constant.
        start: Initial value of the fit if the airframe's value is 0.
        scale: Unit of the fitted parameter of a signed constant; 0 for a positive constant, whose
            logarithm is fitted.
        resolution: Standard deviation that is added to that of the fitted parameter. It accounts
            for noise of the state at the start of a window, few informative windows, and smoothing.
            It is the maximum-likelihood value given the errors of fits to 80 simulated logs and
            their estimated deviations.
    """

    name: str
    group: str
    unit: str
    get: Get
    replace: Replace
    start: float
    scale: float
    resolution: float

    def encode(self, airframe: Airframe) -> float:
        """Return the fitted parameter that corresponds to the airframe's value."""
        value = self.get(airframe)
        return value / self.scale if self.scale else math.log(value or self.start)

    def decode(self, number: float) -> float:
        """Return the constant's value that corresponds to a fitted parameter."""
        return number * self.scale if self.scale else math.exp(number)


def _field(name: str) -> tuple[Get, Replace]:
    """Return a getter and a replacer of a field of the airframe."""

    def get(airframe: Airframe) -> float:
        value: float = getattr(airframe, name)
        return value

    def replace(airframe: Airframe, value: float) -> Airframe:
        changed: dict[str, Any] = {name: value}
        return dataclasses.replace(airframe, **changed)

    return get, replace


def _entry(name: str, axis: int) -> tuple[Get, Replace]:
    """Return a getter and a replacer of one component of a vector field of the airframe."""

    def get(airframe: Airframe) -> float:
        value: float = getattr(airframe, name)[axis]
        return value

    def replace(airframe: Airframe, value: float) -> Airframe:
        values = list(getattr(airframe, name))
        values[axis] = value
        changed: dict[str, Any] = {name: tuple(values)}
        return dataclasses.replace(airframe, **changed)

    return get, replace


def _lag() -> tuple[Get, Replace]:
    """Return a getter and a replacer of the spin-up lag, which scale the spin-down lag equally."""

    def get(airframe: Airframe) -> float:
        return airframe.lag_up

    def replace(airframe: Airframe, value: float) -> Airframe:
        ratio = airframe.lag_down / airframe.lag_up if airframe.lag_up > 0 else 1.0
        return dataclasses.replace(airframe, lag_up=value, lag_down=ratio * value)

    return get, replace


def _nominal() -> tuple[Get, Replace]:
    """Return a getter and a replacer of the voltage at which motors reach their commanded speed."""

    def get(airframe: Airframe) -> float:
        return airframe.pack.voltage if airframe.pack else 0.0

    def replace(airframe: Airframe, value: float) -> Airframe:
        if airframe.pack is None:
            raise ValueError(f"voltage cannot be fitted: {airframe.name} has no <battery>")
        return dataclasses.replace(airframe, pack=dataclasses.replace(airframe.pack, voltage=value))

    return get, replace


CONSTANTS = (
    Constant(
        "thrust_coefficient", "thrust", "N s^2", *_field("thrust_coefficient"), 1e-8, 0, 0.001
    ),
    Constant("torque_ratio", "torque", "m", *_field("torque_ratio"), 0.01, 0, 0.0035),
    Constant("drag_xy", "drag", "N/(rad/s m/s)", *_field("drag_xy"), 1e-6, 0, 0.0035),
    Constant("drag_z", "drag", "N/(rad/s m/s)", *_field("drag_z"), 1e-6, 0, 0.0065),
    Constant("drag_height", "drag", "m", *_field("drag_height"), 0.0, 0.1, 0.002),
    Constant("motor_lag", "lag", "s", *_lag(), 0.03, 0, 0.002),
    Constant("inertia_x", "inertia", "kg m^2", *_entry("inertia", 0), 1.0, 0, 0.001),
    Constant("inertia_y", "inertia", "kg m^2", *_entry("inertia", 1), 1.0, 0, 0.001),
    Constant("inertia_z", "inertia", "kg m^2", *_entry("inertia", 2), 1.0, 0, 0.0035),
    Constant("damping_x", "damping", "1/s", *_entry("damping", 0), 1.0, 0, 0.005),
    Constant("damping_y", "damping", "1/s", *_entry("damping", 1), 1.0, 0, 0.005),
    Constant("damping_z", "damping", "1/s", *_entry("damping", 2), 1.0, 0, 0.012),
    Constant("ground_gain", "ground_effect", "1", *_field("ground_effect_gain"), 0.3, 0, 0.012),
    Constant("ground_reach", "ground_effect", "m", *_field("ground_effect_reach"), 0.1, 0, 0.015),
    Constant("wake_share", "wake", "1", *_field("wake_share"), 0.3, 0, 0.008),
    Constant("wake_spread", "wake", "1", *_field("wake_spread"), 0.1, 0, 0.007),
    Constant("battery_voltage", "voltage", "V", *_nominal(), 3.7, 0, 0.002),
)
"""All constants that can be fitted"""
BY_NAME = {constant.name: constant for constant in CONSTANTS}
GROUPS = tuple(dict.fromkeys(constant.group for constant in CONSTANTS))
GROUND = "ground_effect"
"""Group of the ground effect, which can only be fitted from flights near the ground"""
BATTERY = "battery"
"""Name in --fit of the battery's resistance and capacity, which are fitted separately"""
MOTOR_GAINS = "motor_gains"
"""Name in --fit of the relative thrust gains of all motors, see `motor_gains`; only on request"""
NOT_FITTED_BY_DEFAULT = ("inertia_z", "battery_voltage")
"""Constants that are fitted only on request. Yaw motion determines only the ratio of torque_ratio
to inertia_z, and the voltage constant scales the thrust.
"""


def choose_constants(
    names: Sequence[str], has_other: bool, has_pwm: bool, measured: bool = False
) -> list[Constant]:
    """Select the constants to fit.

    Args:
        names: Names of constants and groups; empty for all that logs of this kind can determine.
            `BATTERY` and `MOTOR_GAINS` are accepted, and add no constants.
        has_other: Whether the logs contain the position of a drone above.
        has_pwm: Whether the logs contain motor commands and voltages.
        measured: Whether rotor speeds were measured, so that the motors' lag has no effect.

    Returns:
        The constants, without duplicates.

    Raises:
        ValueError: If a name is unknown, the logs lack the columns that a constant needs, or the
            constant has no effect.
    """
    if not names:
        return [
            constant
            for constant in CONSTANTS
            if constant.name not in NOT_FITTED_BY_DEFAULT
            and (constant.group != "wake" or has_other)
            and (constant.group != "lag" or not measured)
        ]
    chosen = []
    for name in names:
        found = [constant for constant in CONSTANTS if name in (constant.name, constant.group)]
        if not found and name not in (BATTERY, MOTOR_GAINS):
            choices = (*BY_NAME, *GROUPS, BATTERY, MOTOR_GAINS)
            raise ValueError(
                f"--fit {name}: there is no such constant; {suggest_names(name, choices)}"
            )
        if found and found[0].group == "wake" and not has_other:
            raise ValueError(f"--fit {name} needs the columns other_x, other_y, other_z")
        if found and found[0].group == "lag" and measured:
            raise ValueError(
                f"--fit {name} has no effect with --measured: measured speeds contain the lag"
            )
        if found and found[0].group == "voltage" and not has_pwm:
            raise ValueError(f"--fit {name} needs the columns pwm1 ... and vbat")
        chosen += found
    return list(dict.fromkeys(chosen))
