"""Wakes of drones on drones below them, measured in logs of Neural-Swarm and predicted."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter

from bulletuav.reproduction.flight_series import LogError, motor_moments
from bulletuav.reproduction.swarm_logs import SWARM_DT, SwarmLog, find_training_folder
from bulletuav.vehicle.airframe import STANDARD_GRAVITY
from bulletuav.vehicle.parameters import ParameterRow
from bulletuav.vehicle.wake import downwash

SMALL_PAIRS = ("swap_small_small", "random_walk_small_small", "swap_ss", "randomwalk_ss")
"""Experiments with two unmodified Crazyflies"""
MIXED_PAIRS = ("swap_large_small", "random_walk_large_small", "swap_sl", "randomwalk_sl")
"""Experiments with a Crazyflie and a larger drone"""
MAX_WAKE_DISTANCE = 0.25
"""Maximum horizontal distance of samples, m"""
DROP_RANGE = (0.15, 0.7)
"""Range of the distance below the upper drone, m"""
FREE_DISTANCE = 0.18
"""Horizontal distance from which no wake is felt, m"""
MIN_PAIR_HEIGHT = 0.3
"""Minimum height, m: above the ground effect"""
MIN_FREE_ROWS = 100
"""Minimum number of rows in free flight, from which the mass follows"""
PAIR_HALF_ARM, PAIR_INERTIA = 0.0325, 1.66e-5
"""Half arm, m, and inertia about x and y, kg m^2, of the lower Crazyflie"""


@dataclass(frozen=True)
class LowerDrone:
    """What one drone of a pair feels, and the position of the other: series of shape (T,).

    Attributes:
        distance: Horizontal distance to the other drone, m.
        drop: Distance below the other drone, m.
        upper: Thrust of the other drone, grams.
        mass: Mass in free flight, grams, as a single number.
        push: Downward force, grams.
        sideways: Horizontal force in world axes (T, 2), grams.
        moment: About the horizontal axis that lowers the side towards the other drone, mN m.
        usable: Whether both logs have rows, and the drone is above the ground effect.
        near: Whether the drone may be in the wake.
    """

    distance: np.ndarray
    drop: np.ndarray
    upper: np.ndarray
    mass: float
    push: np.ndarray
    sideways: np.ndarray
    moment: np.ndarray
    usable: np.ndarray
    near: np.ndarray


def find_log_pairs(folder: Path, experiments: Sequence[str]) -> list[tuple[Path, Path]]:
    """Return the pairs of logs of some experiments in a clone of Neural-Swarm, sorted.

    Raises:
        LogError: If there are none.
    """
    training = find_training_folder(folder)
    found = []
    for name in experiments:
        for place in sorted(training.glob(f"*/{name}")):
            numbers = {path.name.split("_")[-1] for path in place.glob("cf*_[0-9][0-9]")}
            for number in sorted(numbers):
                pair = sorted(place.glob(f"cf*_{number}"))
                if len(pair) == 2:
                    found.append((pair[0], pair[1]))
    if not found:
        raise LogError(f"{training}: no pairs of logs of {', '.join(experiments)}; fetch it again")
    return sorted(found)


def align_logs(first: SwarmLog, second: SwarmLog) -> tuple[slice, slice]:
    """Return the rows of two logs that have the same times: both start when the radio says so.

    Raises:
        LogError: If they have no common times.
    """
    start = round((second.time[0] - first.time[0]) / SWARM_DT)
    a, b = max(start, 0), max(-start, 0)
    count = min(len(first.time) - a, len(second.time) - b)
    if count < 1:
        ranges = " and ".join(
            f"{log.time[0]:.2f} to {log.time[-1]:.2f} s" for log in (first, second)
        )
        raise LogError(f"logs of a pair have no common times: {ranges}; fetch them again")
    return slice(a, a + count), slice(b, b + count)


def measure_wake(me: SwarmLog, other: SwarmLog, mine: slice, its: slice) -> LowerDrone | None:
    """Measure what a drone feels.

    The mass is that of free flight, and the medians of force and torque in free flight are the
    trim.

    Args:
        me: Log of the drone.
        other: Log of the other drone.
        mine: Rows of `me`.
        its: Rows of `other` with the same times.

    Returns:
        The measurement; None if the drone hardly flew freely.
    """
    apart = other.position[its] - me.position[mine]
    attitude = me.attitude[mine]
    forward = attitude[:, :2, 0] / np.linalg.norm(attitude[:, :2, 0], axis=1, keepdims=True)
    left = np.stack([-forward[:, 1], forward[:, 0]], axis=1)
    side = np.stack([np.sum(apart[:, :2] * axis, axis=1) for axis in (forward, left)], axis=1)
    distance, drop = np.linalg.norm(side, axis=1), apart[:, 2]
    usable = ~me.gap[mine] & ~other.gap[its] & (me.position[mine, 2] > MIN_PAIR_HEIGHT)
    free = usable & ((distance > FREE_DISTANCE) | (drop < 0.0))
    if free.sum() < MIN_FREE_ROWS:
        return None
    lift, weight = me.lift()[mine], me.load[mine]
    mass = np.median((lift / weight)[free])
    sideways = np.zeros((len(drop), 2))
    if len(me.sideways):
        pull = me.thrust[mine].sum(axis=1)[:, None] * attitude[:, :2, 2]
        sideways = mass * me.sideways[mine] - pull
        sideways -= np.median(sideways[free], axis=0)
    rates = uniform_filter1d(me.rates[mine, :2], 5, axis=0)
    torque = PAIR_INERTIA * np.gradient(rates, SWARM_DT, axis=0)
    torque -= motor_moments(me.thrust[mine] * STANDARD_GRAVITY / 1e3, PAIR_HALF_ARM)
    torque -= np.median(torque[free], axis=0)
    towards = side / np.maximum(distance, 1e-6)[:, None]
    near = usable & (distance < MAX_WAKE_DISTANCE)
    near &= (drop > DROP_RANGE[0]) & (drop < DROP_RANGE[1])
    return LowerDrone(
        distance,
        drop,
        upper=other.thrust[its].sum(axis=1),
        mass=float(mass),
        push=lift - mass * weight,
        sideways=sideways,
        moment=1e3 * (torque[:, 1] * towards[:, 0] - torque[:, 0] * towards[:, 1]),
        usable=usable,
        near=near,
    )


def predict_wake(
    distance: np.ndarray, drop: np.ndarray, thrust: np.ndarray, row: ParameterRow
) -> tuple[np.ndarray, np.ndarray]:
    """Predict the wakes of drones by the package's law, `bulletuav.vehicle.wake`.

    Args:
        distance: Horizontal distance of the two drones, m.
        drop: Distance of the lower drone below the upper one, m.
        thrust: Thrust of the upper drone, any unit.
        row: Constants of the upper drone.

    Returns:
        The downward force in the unit of the thrust, and force over squared width, each of the
        common shape of the arguments.
    """
    apart, below, lift = np.broadcast_arrays(distance, drop, thrust)
    pairs = zip(apart.ravel(), below.ravel(), lift.ravel(), strict=True)
    rows = [downwash(d * d, z, t, row) for d, z, t in pairs]
    push, tip = np.array(rows).reshape(-1, 2).T
    return push.reshape(apart.shape), tip.reshape(apart.shape)


def fit_wake_share(felt: Sequence[LowerDrone], row: ParameterRow) -> float:
    """Fit the strength of the wake, `wake_share`, to measured downward forces by least squares.

    Args:
        felt: Measurements of lower drones.
        row: Constants of the upper drone.

    Raises:
        LogError: If no drone was in the wake.
    """
    products, squares = 0.0, 0.0
    for one in felt:
        law, _ = predict_near_wake(one, row)
        products += float(np.sum(one.push * law))
        squares += float(np.sum(law * law))
    if not squares:
        raise LogError("no drone flew in the wake of another; fetch the data again")
    return float(row.wake_share) * products / squares


def predict_near_wake(one: LowerDrone, row: ParameterRow) -> tuple[np.ndarray, np.ndarray]:
    """Predict the wake where the drone is near the other one, 0 elsewhere.

    Args:
        one: Measurement of the lower drone.
        row: Constants of the upper drone, whose arm is that of the lower one.

    Returns:
        Downward force (T,), grams, and moment towards the axis (T,), mN m.
    """
    push, moment = np.zeros_like(one.push), np.zeros_like(one.push)
    if one.near.any():
        distance = one.distance[one.near]
        force, tip = predict_wake(distance, one.drop[one.near], one.upper[one.near], row)
        push[one.near] = force
        moment[one.near] = STANDARD_GRAVITY * row.arm**2 * tip * distance
    return push, moment


def simulate_height_error(
    disturbance: np.ndarray, stiffness: float, damping: float, dt: float
) -> np.ndarray:
    """Simulate the height error e of a controller: e'' = d - k e - c e', by semi-implicit Euler.

    Args:
        disturbance: Acceleration d (T,), m/s^2.
        stiffness: Gain k of the position, 1/s^2.
        damping: Gain c of the velocity, 1/s.
        dt: Time between rows, s.

    Returns:
        The error (T,), m.
    """
    damped = damping * dt
    feedback = [1.0, stiffness * dt * dt + damped - 2.0, 1.0 - damped]
    return np.asarray(lfilter([0.0, dt * dt], feedback, disturbance))
