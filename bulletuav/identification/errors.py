"""How far predicted flights are from those that were measured."""

from dataclasses import dataclass

import numpy as np

from bulletuav.geometry.rotation import exp_map
from bulletuav.identification.constants import Constant
from bulletuav.identification.flight import Flight
from bulletuav.identification.rollout import STATE, Legs, follow, roll_out
from bulletuav.vehicle.airframe import STANDARD_GRAVITY, Airframe
from bulletuav.vehicle.parameters import parameter_rows
from bulletuav.vehicle.wakes import Wakes

PICKS = 5
"""States of a leg that are compared with the log"""
TURNS = 2
"""Legs without guidance in a window: attitudes diverge sooner than positions"""
TWIST = 0.01
"""Unit of the torque bias, in weights times arm"""
TILT = 0.01
"""Unit of the tilt, rad"""
DELAY = 0.01
"""Unit of delays, s"""
GAIN = 0.01
"""Unit of the thrust's gain"""
OFFSETS = ("delay", "tilt_x", "tilt_y", "twist_x", "twist_y", "twist_z", "gain")
"""What is fitted for each log by itself: its clock, how the body whose attitude was measured is
tilted, torques of an uneven drone, and how strong its motors are on that day"""
SPREAD = 5.0
"""How large they usually are, in their units"""
NUM_OFFSETS = len(OFFSETS)


@dataclass(frozen=True)
class Errors:
    """Errors of predictions in windows of one log.

    Attributes:
        moved: (K, PICKS, 6) of position (m) and velocity (m/s), attitude as measured.
        turned: (K, TURNS * PICKS, 6) of attitude (rad, body axes) and rates (rad/s).
    """

    moved: np.ndarray
    turned: np.ndarray


def with_constants(
    airframe: Airframe,
    constants: list[Constant],
    numbers: np.ndarray,
) -> Airframe:
    """Return an airframe with other constants, given by the numbers that are fitted."""
    for constant, number in zip(constants, numbers, strict=True):
        airframe = constant.put(airframe, constant.decode(float(number)))
    return airframe


def legs_of(flight: Flight, windows: np.ndarray) -> tuple[Legs, Legs]:
    """Return the legs with guidance and those without of some windows.

    Args:
        flight: The flight.
        windows: (K,) indices of windows, of `flight.windows`.
    """
    start = flight.windows[windows]
    every = max(flight.steps // PICKS, 1)
    half = max(flight.steps // (TURNS * PICKS), 1)
    turns = start[:, None] + flight.steps // TURNS * np.arange(TURNS)
    return Legs(start, PICKS, every, True), Legs(turns.ravel(), PICKS, half, False)


@dataclass(frozen=True)
class _Drive:
    """What flies the legs of a log.

    Attributes:
        command: (n, R) rotor speeds that are commanded, rad/s.
        speed: (n, R) rotor speeds, rad/s.
        parameters: (1, N) rows of `PARAMETERS`.
        hover_speed: Rotor speed of another drone, rad/s.
        offsets: (7,) the log's own numbers.
        twist: Torque of an uneven drone, N m.
    """

    command: np.ndarray
    speed: np.ndarray
    parameters: np.ndarray
    hover_speed: float
    offsets: np.ndarray
    twist: tuple[float, float, float]


def _driven(
    flight: Flight,
    airframe: Airframe,
    offsets: np.ndarray,
) -> _Drive:
    """Let the rotors of an airframe follow the commands of a log."""
    command = flight.commands(airframe, DELAY * offsets[0])
    other = len(flight.track.other) > 0
    parameters = parameter_rows([airframe] * (1 + other))[None]
    gain = 1.0 + GAIN * offsets[6]
    parameters["thrust_coefficient"][0, 0] *= gain
    parameters["torque_coefficient"][0, 0] *= gain
    speed = np.empty_like(command)
    follow(command, parameters[0, 0], flight.dt, speed)
    unit = TWIST * airframe.mass * STANDARD_GRAVITY * airframe.arm
    twist = (unit * offsets[3], unit * offsets[4], unit * offsets[5])
    return _Drive(command, speed, parameters, airframe.hover_speed(), offsets, twist)


def _predict(
    flight: Flight,
    legs: Legs,
    drive: _Drive,
) -> np.ndarray:
    """Return the states (L, picks, 13) that legs lead to."""
    states = np.empty((len(legs.start), legs.picks, STATE))
    roll_out(
        legs,
        flight.track,
        drive.command,
        drive.speed,
        tilt_of(drive.offsets),
        drive.twist,
        drive.parameters,
        drive.hover_speed,
        STANDARD_GRAVITY,
        flight.dt,
        Wakes.of(*drive.parameters.shape),
        states,
    )
    return states


def tilt_of(offsets: np.ndarray) -> tuple[float, float, float, float]:
    """Return the quaternion from the drone's body to the one whose attitude was measured."""
    return exp_map((TILT * offsets[1], TILT * offsets[2], 0.0))


def compare(
    flight: Flight,
    legs: Legs,
    states: np.ndarray,
    offsets: np.ndarray,
) -> np.ndarray:
    """Return by how much predicted states differ from the measured ones.

    Returns:
        (L, picks, 12) differences of position, velocity, attitude (rotation vector in body axes),
        and rates.
    """
    at = legs.start[:, None] + legs.every * np.arange(1, legs.picks + 1)
    track = flight.track
    measured = times(track.quaternion[at], np.array(tilt_of(offsets)))
    off = times(conjugate(measured), states[..., 3:7])
    # Twice the vector part: the rotation vector of small turns, of the shorter way
    turn = 2 * off[..., :3] * np.where(off[..., 3:] < 0, -1.0, 1.0)
    return np.concatenate(
        [
            states[..., :3] - track.position[at],
            states[..., 7:10] - track.velocity[at],
            turn,
            states[..., 10:] - track.rates[at],
        ],
        axis=-1,
    )


def times(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return the products p q of quaternions (..., 4)."""
    vector = p[..., 3:] * q[..., :3] + q[..., 3:] * p[..., :3] + np.cross(p[..., :3], q[..., :3])
    scalar = p[..., 3:] * q[..., 3:] - np.sum(p[..., :3] * q[..., :3], axis=-1, keepdims=True)
    return np.concatenate([vector, scalar], axis=-1)


def conjugate(q: np.ndarray) -> np.ndarray:
    """Return the inverse of unit quaternions (..., 4)."""
    inverse: np.ndarray = q * np.array([-1.0, -1.0, -1.0, 1.0])
    return inverse


def errors_of(
    flight: Flight,
    windows: np.ndarray,
    airframe: Airframe,
    offsets: np.ndarray,
) -> Errors:
    """Predict windows of a flight, and compare with what was measured.

    Args:
        flight: The flight.
        windows: (K,) indices of its windows.
        airframe: The airframe.
        offsets: (7,) the log's own numbers.
    """
    guided, free = legs_of(flight, windows)
    drive = _driven(flight, airframe, offsets)
    moved = compare(flight, guided, _predict(flight, guided, drive), offsets)
    turned = compare(flight, free, _predict(flight, free, drive), offsets)
    return Errors(moved[..., :6], turned[..., 6:].reshape(len(windows), -1, 6))


def naive_errors(flight: Flight, windows: np.ndarray) -> Errors:
    """Return the errors of predicting that velocity and rates stay what they are."""
    guided, free = legs_of(flight, windows)
    found = []
    for legs in (guided, free):
        track = flight.track
        lapse = flight.dt * legs.every * np.arange(1, legs.picks + 1)
        velocity = track.velocity[legs.start][:, None]
        rates = track.rates[legs.start][:, None]
        angle = rates * lapse[:, None]
        size = np.linalg.norm(angle, axis=-1, keepdims=True)
        turn = np.concatenate([0.5 * np.sinc(size / (2 * np.pi)) * angle, np.cos(size / 2)], -1)
        same = np.ones((1, legs.picks, 1))
        states = np.concatenate(
            [
                track.position[legs.start][:, None] + velocity * lapse[:, None],
                times(track.quaternion[legs.start][:, None], turn),
                velocity * same,
                rates * same,
            ],
            axis=-1,
        )
        found.append(compare(flight, legs, states, np.zeros(NUM_OFFSETS)))
    return Errors(found[0][..., :6], found[1][..., 6:].reshape(len(windows), -1, 6))
