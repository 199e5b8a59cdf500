"""Thrust gains of single motors, which a URDF cannot contain.

A motor of gain g turns at sqrt(g) times its commanded or measured speed, as rotors of effectiveness
g do in `bulletuav.envs.conditions`: its thrust and reaction torque are g times those of the
airframe. The gains are relative: their geometric mean is 1, and `thrust_coefficient` is that of the
mean motor.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bulletuav.identification.constants import MOTOR_GAINS, Constant, Get, Replace
from bulletuav.vehicle.airframe import Airframe

GAIN_RESOLUTION = 0.0005
"""Standard deviation that is added to that of a gain's logarithm, see `Constant.resolution`. In
fits to 14 simulated logs of 30 s, errors were 0.0007 and their estimated deviations 0.0008 without.
"""


@dataclass(frozen=True)
class UnevenAirframe(Airframe):
    """An airframe whose motors have thrust gains of their own.

    Attributes:
        motor_gains: (R,) gain of each motor; only their ratios have an effect.
    """

    motor_gains: tuple[float, ...] = ()


def make_uneven(airframe: Airframe) -> UnevenAirframe:
    """Return a copy of an airframe whose motor gains are 1."""
    return UnevenAirframe(**_fields_of(airframe), motor_gains=(1.0,) * len(airframe.rotors))


def make_even(airframe: Airframe) -> Airframe:
    """Return an airframe without its motor gains."""
    return Airframe(**_fields_of(airframe)) if isinstance(airframe, UnevenAirframe) else airframe


def _fields_of(airframe: Airframe) -> dict[str, Any]:
    return {one.name: getattr(airframe, one.name) for one in dataclasses.fields(Airframe)}


def motor_speed_ratios(airframe: Airframe) -> np.ndarray:
    """Return the speed of each motor relative to an average motor, (R,): the root of its gain."""
    if not isinstance(airframe, UnevenAirframe):
        return np.ones(len(airframe.rotors))
    logarithms = np.log(airframe.motor_gains)
    ratios: np.ndarray = np.exp(0.5 * (logarithms - logarithms.mean()))
    return ratios


def make_gain_constants(num_rotors: int) -> list[Constant]:
    """Make the constants motor_gain_1 ... motor_gain_R of an `UnevenAirframe`."""
    return [
        Constant(f"motor_gain_{k + 1}", MOTOR_GAINS, "1", *_gain(k), 1.0, 0, GAIN_RESOLUTION)
        for k in range(num_rotors)
    ]


def _gain(motor: int) -> tuple[Get, Replace]:
    """Return a getter and a replacer of the gain of a motor."""

    def get(airframe: Airframe) -> float:
        return airframe.motor_gains[motor] if isinstance(airframe, UnevenAirframe) else 1.0

    def replace(airframe: Airframe, value: float) -> Airframe:
        assert isinstance(airframe, UnevenAirframe)
        gains = list(airframe.motor_gains)
        gains[motor] = value
        return dataclasses.replace(airframe, motor_gains=tuple(gains))

    return get, replace


def center_gains(
    constants: Sequence[Constant], theta: np.ndarray, covariance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Subtract the mean of the gains' logarithms from each, which windows do not determine.

    Args:
        constants: The C constants, to which the first C parameters belong.
        theta: Parameter vector, (P,).
        covariance: Its covariance, (P, P).

    Returns:
        The parameter vector and the covariance of the relative gains; both unchanged without gains.
    """
    places = [k for k, constant in enumerate(constants) if constant.group == MOTOR_GAINS]
    if not places:
        return theta, covariance
    project = np.eye(len(theta))
    project[np.ix_(places, places)] -= 1.0 / len(places)
    return project @ theta, project @ covariance @ project.T


def describe_missing_gains(gains: Sequence[float]) -> str:
    """Return a note that the URDF lacks the motor gains, and how to simulate them."""
    highest = max(gains)
    parts = ", ".join(f"{gain / highest:.4f}" for gain in gains)
    return (
        f"The URDF does not contain the motor gains, as an airframe has one thrust coefficient for "
        f"all rotors: to simulate them, multiply thrust_coefficient by {highest:.4f} and set the "
        f"condition rotor_effectiveness to ({parts})."
    )
