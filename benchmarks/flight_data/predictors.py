"""Models that predict flights: this one, the one before it, and those of other simulators."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bulletuav.vehicle.airframe import STANDARD_GRAVITY
from bulletuav.vehicle.rotors import RPM
from flight_data import model
from flight_data.series import first_order_lag

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Predictor:
    """A model of a Crazyflie.

    Attributes:
        name: What tables call it.
        mass: kg.
        half_arm: Place of the rotors on each axis, m.
        inertia: About x, y, z, kg m^2.
        torque_ratio: Drag torque of a rotor over its thrust, m.
        speed: Commanded rotor speeds, rad/s, from commands (shares) and volts.
        thrust: Thrust of a rotor, N, from its speed.
        lag: Rotor speeds (T, 4) from those commanded and the time between rows.
        rotor_drag: Drag of a rotor's spin in body axes, N for each rad/s and m/s.
        body_drag: Drag whatever the rotors do, N for each m/s.
        drag_height: Height at which horizontal drag acts, m.
        rate_damping: Damping of body rates at hover, 1/s.
        propeller_inertia: Of one rotor about its axis, kg m^2.
    """

    name: str
    mass: float
    half_arm: float
    inertia: Triple
    torque_ratio: float
    speed: Callable[[np.ndarray, np.ndarray], np.ndarray]
    thrust: Callable[[np.ndarray], np.ndarray]
    lag: Callable[[np.ndarray, float], np.ndarray]
    rotor_drag: Triple = (0.0, 0.0, 0.0)
    body_drag: Triple = (0.0, 0.0, 0.0)
    drag_height: float = 0.0
    rate_damping: Triple = (0.0, 0.0, 0.0)
    propeller_inertia: float = 0.0

    def rotor_speeds(self, pwm: np.ndarray, volts: np.ndarray, dt: float) -> np.ndarray:
        """Return rotor speeds (T, 4), rad/s, of commands (T, 4) and voltages (T,)."""
        return self.lag(self.speed(pwm, volts[:, None]), dt)

    def hover_speed(self) -> float:
        """Return the sum of the rotor speeds at hover, rad/s."""
        speeds = np.linspace(0.0, 4000.0, 40001)
        return 4.0 * float(
            np.interp(self.mass * STANDARD_GRAVITY / 4.0, self.thrust(speeds), speeds)
        )


def _lag(constant: float) -> Callable[[np.ndarray, float], np.ndarray]:
    return lambda speeds, dt: first_order_lag(speeds, constant, dt)


def _drone_models_lag(coefficients: tuple[float, ...]) -> Callable[[np.ndarray, float], np.ndarray]:
    """Return the rotor dynamics of drone-models, linear and quadratic, up and down."""
    up, up2, down, down2 = coefficients

    def lag(commanded: np.ndarray, dt: float) -> np.ndarray:
        target = commanded / RPM
        now = target[0].copy()
        rows = np.empty_like(target)
        for row, goal in enumerate(target):
            rows[row] = now
            square = goal * goal - now * now
            rising = up * (goal - now) + up2 * square
            falling = down * (goal - now) + down2 * square
            now = now + dt * np.where(goal > now, rising, falling)
        return rows * RPM

    return lag


def _square(coefficient: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda speeds: coefficient * speeds * speeds


def _panerati(lag: float, name: str, torque_ratio: float) -> Predictor:
    """Make the constants of gym-pybullet-drones' cf2x, with or without lag and its torque ratio."""
    return Predictor(
        name,
        mass=0.027,
        half_arm=0.0397 / np.sqrt(2.0),
        inertia=(1.4e-5, 1.4e-5, 2.17e-5),
        torque_ratio=torque_ratio,
        speed=lambda pwm, volts: (0.2685 * 65535.0 * pwm + 4070.3) * RPM,
        thrust=_square(3.16e-10 / RPM**2),
        lag=_lag(lag),
        rotor_drag=(9.1785e-7, 9.1785e-7, 10.311e-7),
    )


def _drone_models(
    name: str,
    mass: float,
    thrust: tuple[float, float],
    ratio: float,
    rotor: tuple[float, ...],
    drag: tuple[float, float],
    volts_to_rpm: tuple[float, float],
    propeller_inertia: float,
) -> Predictor:
    """Make a set of drone-models' params.toml, first-principles model."""
    return Predictor(
        name,
        mass=mass,
        half_arm=0.03253,
        inertia=(16.8e-6, 16.8e-6, 29.8e-6),
        torque_ratio=ratio,
        speed=lambda pwm, volts: (volts_to_rpm[0] + volts_to_rpm[1] * pwm * volts) * RPM,
        thrust=lambda speeds: thrust[0] * speeds / RPM + thrust[1] * (speeds / RPM) ** 2,
        lag=_drone_models_lag(rotor),
        body_drag=(drag[0], drag[0], drag[1]),
        propeller_inertia=propeller_inertia,
    )


BEFORE = _panerati(0.065, "before", torque_ratio=0.00596)
GYM_PYBULLET_DRONES = _panerati(0.0, "gym-pybullet-drones", torque_ratio=7.94e-12 / 3.16e-10)
DRONE_MODELS_L250 = _drone_models(
    "drone-models cf2x_L250",
    mass=0.0319,
    thrust=(-5.382196214637237e-7, 2.4582929831265485e-10),
    ratio=0.007350862856566459,
    rotor=(7.355623702172756, 0.0, 0.0, 0.00024443862952110715),
    drag=(0.01471782, 0.01277641),
    volts_to_rpm=(2968.1791506049194, 6647.948592402306),
    propeller_inertia=34.52e-9,
)
DRONE_MODELS_P250 = _drone_models(
    "drone-models cf2x_P250",
    mass=0.0318,
    thrust=(-3.6200226530383495e-7, 1.6060924304100328e-10),
    ratio=0.0069928948992470565,
    rotor=(5.172596691828673, 8.14774234381285e-5, 0.0, 0.0002095253491455741),
    drag=(0.01351483, 0.01677452),
    volts_to_rpm=(4657.542534331524, 7536.161830990926),
    propeller_inertia=26.97e-9,
)
NOW = Predictor(
    "now",
    mass=model.AIRFRAME.mass,
    half_arm=model.AIRFRAME.arm / np.sqrt(2.0),
    inertia=model.AIRFRAME.inertia,
    torque_ratio=model.AIRFRAME.torque_ratio,
    speed=model.rotor_speed,
    thrust=_square(model.AIRFRAME.thrust_coefficient),
    lag=_lag(model.AIRFRAME.lag_up),
    rotor_drag=model.ROTOR_DRAG,
    drag_height=model.AIRFRAME.drag_height,
    rate_damping=model.AIRFRAME.damping,
    propeller_inertia=model.AIRFRAME.rotor_inertia,
)
PREDICTORS = (GYM_PYBULLET_DRONES, DRONE_MODELS_L250, DRONE_MODELS_P250, BEFORE, NOW)
PROPELLER_RADIUS = 0.0231348
"""m, of gym-pybullet-drones and of bulletuav before"""


def downwash_of_gym_pybullet_drones(distance: np.ndarray, drop: np.ndarray) -> np.ndarray:
    """Return the downwash of gym-pybullet-drones, N: J. Panerati et al. (2021)."""
    z = np.where(drop > 0.0, drop, np.nan)
    strength = 2267.18 * (PROPELLER_RADIUS / (4.0 * z)) ** 2
    push = strength * np.exp(-0.5 * (distance / (0.16 * z - 0.11)) ** 2)
    return np.asarray(np.nan_to_num(push))


def downwash_before(distance: np.ndarray, drop: np.ndarray) -> np.ndarray:
    """Return the downwash of bulletuav before, N: that fit, bounded by weight and rotor disc."""
    z = np.where(drop > 0.0, drop, np.nan)
    strength = np.minimum(2267.18 * (PROPELLER_RADIUS / (4.0 * z)) ** 2, 0.027 * STANDARD_GRAVITY)
    width = np.maximum(0.16 * z - 0.11, 0.0397 + PROPELLER_RADIUS)
    return np.asarray(np.nan_to_num(strength * np.exp(-0.5 * (distance / width) ** 2)))


def ground_effect_of_gain(height: np.ndarray, gain: float) -> np.ndarray:
    """Return the share by which thrust grows: gain (R / 4h)^2, at most 4/15.

    Gain 1 is I. Cheeseman and W. Bennett, ARC R&M 3021 (1955); gym-pybullet-drones and bulletuav
    before took 11.37.
    """
    lowest = 0.25 * PROPELLER_RADIUS * np.sqrt(3.75 * gain)
    return np.asarray(gain * (PROPELLER_RADIUS / (4.0 * np.maximum(height, lowest))) ** 2)
