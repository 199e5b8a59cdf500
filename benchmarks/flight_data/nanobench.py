"""NanoBench: where a Crazyflie is half a second later, its attitude taken from the log.

S. Ullah and J. Baca, arXiv 2603.09908: Crazyflie 2.1, Vicon, motor commands and voltage at 100 Hz.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bulletuav.reproduction import nanobench_flights
from bulletuav.reproduction.nanobench_flights import MIN_FLIGHT_COMMAND as IDLE
from bulletuav.reproduction.nanobench_flights import MIN_FLIGHT_HEIGHT as LOWEST
from bulletuav.reproduction.nanobench_flights import MOTOR_COLUMNS as MOTORS
from bulletuav.reproduction.nanobench_flights import NANOBENCH_COLUMNS as COLUMNS
from bulletuav.reproduction.nanobench_flights import NANOBENCH_DT as DT
from bulletuav.vehicle.airframe import STANDARD_GRAVITY
from flight_data.predictors import Predictor
from flight_data.series import binned, binned_error, moments, rms, rotations

REPOSITORY, LICENCE = "nanobench-iros2026", "BSD-3-Clause"
__all__ = ["COLUMNS", "DT", "IDLE", "LOWEST", "MOTORS"]
STEPS = 50
"""Rows of a window"""
SPEEDS = (-1.4, -1.0, -0.7, -0.5, -0.35, -0.2, -0.1, 0.1, 0.2, 0.35, 0.5, 0.7, 1.0, 1.4)
"""Edges of bins of the velocity along a body axis, m/s"""
FEWEST = 20
"""Least windows of a bin"""
MOST_ACCELERATION, MOST_MISMATCH = 8.0, 0.002
"""Beyond them Vicon jumped: change of velocity, m/s^2; position less integrated velocity, m"""


@dataclass(frozen=True)
class Flight:
    """One flight at 100 Hz: series whose first axis is time."""

    name: str
    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    attitude: np.ndarray
    pwm: np.ndarray
    volts: np.ndarray


@dataclass(frozen=True)
class Windows:
    """Windows of half a second (W, 51, ...), and the index of the flight of each."""

    position: np.ndarray
    velocity: np.ndarray
    attitude: np.ndarray
    speed: np.ndarray
    flight: np.ndarray


def load(path: Path) -> Flight:
    """Read one flight; see `nanobench_flights.read_nanobench_flight`."""
    return _with_matrices(nanobench_flights.read_nanobench_flight(path))


def _with_matrices(read: nanobench_flights.NanobenchFlight) -> Flight:
    attitude = rotations(read.quaternion)
    return Flight(
        read.name, read.time, read.position, read.velocity, attitude, read.pwm, read.volts
    )


def load_all(folder: Path) -> tuple[list[Flight], list[str]]:
    """Read the flights of a clone: those that can be used, and why others cannot."""
    paths = nanobench_flights.find_nanobench_flights(folder)
    flights, refused = nanobench_flights.read_nanobench_flights(paths)
    return [_with_matrices(flight) for flight in flights], refused


def window_starts(flight: Flight) -> np.ndarray:
    """Return the first rows of windows that follow each other, flown and seen all along."""
    flying = (flight.position[:, 2] > LOWEST) & (flight.pwm.min(axis=1) > IDLE)
    change = np.linalg.norm(np.diff(flight.velocity, axis=0), axis=1) / DT
    starts = []
    row = 0
    while row + STEPS < len(flying):
        end = row + STEPS
        if not flying[row : end + 1].all():
            row += 1
            continue
        # A window that Vicon or the log lost sight of is left out, and the next one follows it.
        seconds = flight.time[end] - flight.time[row]
        mean = 0.5 * (flight.velocity[row:end] + flight.velocity[row + 1 : end + 1])
        mismatch = flight.position[end] - flight.position[row] - mean.sum(axis=0) * DT
        if (
            abs(seconds - STEPS * DT) < 1.5 * DT
            and change[row:end].max() < MOST_ACCELERATION
            and np.linalg.norm(mismatch) < MOST_MISMATCH
        ):
            starts.append(row)
        row = end
    return np.array(starts, dtype=int)


def windows(flights: Sequence[Flight], predictor: Predictor) -> Windows:
    """Cut flights into windows, with the rotor speeds that a predictor derives."""
    parts: list[tuple[np.ndarray, ...]] = []
    for index, flight in enumerate(flights):
        rows = window_starts(flight)[:, None] + np.arange(STEPS + 1)
        speed = predictor.rotor_speeds(flight.pwm, flight.volts, DT)
        series = (flight.position, flight.velocity, flight.attitude, speed)
        parts.append((*(values[rows] for values in series), np.full(len(rows), index)))
    return Windows(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def predict(predictor: Predictor, cut: Windows) -> tuple[np.ndarray, np.ndarray]:
    """Predict position and velocity (W, 3) at the end of windows.

    What no log tells is calibrated flight by flight, for every predictor alike: how the markers'
    body is tilted (two angles), and the gain of the thrust (propellers, battery, mass). Rotor
    speeds are scaled with the root of the gain, so that drag is that of the true thrust.
    """
    count = cut.flight.max() + 1
    thrust = predictor.thrust(cut.speed).sum(axis=2) / predictor.mass
    total = cut.speed.sum(axis=2)
    gain = np.full(count, STANDARD_GRAVITY / np.median(thrust))
    tilt = np.zeros((count, 2))
    for _ in range(4):
        _, velocity = _fly(predictor, cut, thrust, total, gain, tilt)
        error = (cut.velocity[:, -1] - velocity) / (STEPS * DT)
        body = np.einsum("nji,nj->ni", cut.attitude[:, STEPS // 2], error)
        for flight in range(count):
            its = cut.flight == flight
            tilt[flight] += body[its, :2].mean(axis=0) / STANDARD_GRAVITY
            gain[flight] *= 1.0 + error[its, 2].mean() / STANDARD_GRAVITY
    return _fly(predictor, cut, thrust, total, gain, tilt)


def _fly(
    predictor: Predictor,
    cut: Windows,
    thrust: np.ndarray,
    total: np.ndarray,
    gain: np.ndarray,
    tilt: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Integrate gravity, thrust and drag over windows with the attitude of the log."""
    position, velocity = cut.position[:, 0].copy(), cut.velocity[:, 0].copy()
    gains, tilts = gain[cut.flight], tilt[cut.flight]
    for step in range(STEPS):
        attitude = 0.5 * (cut.attitude[:, step] + cut.attitude[:, step + 1])
        push = 0.5 * gains * (thrust[:, step] + thrust[:, step + 1])
        spin = 0.5 * np.sqrt(gains) * (total[:, step] + total[:, step + 1])
        body = np.einsum("nji,nj->ni", attitude, velocity)
        drag = spin[:, None] * np.array(predictor.rotor_drag) + np.array(predictor.body_drag)
        force = -drag / predictor.mass * body
        force[:, :2] += tilts * push[:, None]
        force[:, 2] += push
        acceleration = np.einsum("nij,nj->ni", attitude, force)
        acceleration[:, 2] -= STANDARD_GRAVITY
        position += velocity * DT + 0.5 * acceleration * DT * DT
        velocity = velocity + acceleration * DT
    return position, velocity


def errors(cut: Windows, position: np.ndarray, velocity: np.ndarray) -> list[float]:
    """Return RMS errors: position and velocity, horizontal, then vertical, m and m/s."""
    apart = position - cut.position[:, -1]
    slip = velocity - cut.velocity[:, -1]
    horizontal = [float(np.sqrt(np.mean(np.sum(x[:, :2] ** 2, axis=1)))) for x in (apart, slip)]
    return [*horizontal, float(rms(apart[:, 2])), float(rms(slip[:, 2]))]


def constant_velocity(cut: Windows) -> tuple[np.ndarray, np.ndarray]:
    """Predict that drones fly on as they did."""
    start = cut.velocity[:, 0]
    return cut.position[:, 0] + start * STEPS * DT, start


def tilting_moments(flights: Sequence[Flight], predictor: Predictor) -> tuple[np.ndarray, ...]:
    """Return what tips drones that move: along x, then y of the body, means of windows.

    Over half a second a drone hardly turns, so the motors hold against what tips it. Their trim at
    rest is calibrated flight by flight.

    Returns:
        Velocity, m/s; the moment against it that the motors held, mN m; the one that the predictor
        tells: its horizontal drag times the height at which it acts.
    """
    drag = predictor.rotor_drag[0] * predictor.hover_speed() + predictor.body_drag[0]
    speed, flown = [], []
    for flight in flights:
        rows = window_starts(flight)[:, None] + np.arange(STEPS)
        thrust = predictor.thrust(predictor.rotor_speeds(flight.pwm, flight.volts, DT))
        thrust *= predictor.mass * STANDARD_GRAVITY / np.median(thrust[rows].sum(axis=2))
        torque = 1e3 * moments(thrust, predictor.half_arm)[rows].mean(axis=1)
        body = np.einsum("tji,tj->ti", flight.attitude, flight.velocity)[rows].mean(axis=1)
        for axis, held in ((0, torque[:, 1]), (1, -torque[:, 0])):
            line = np.column_stack([body[:, axis], np.ones(len(held))])
            trim = np.linalg.lstsq(line, held, rcond=None)[0][1]
            speed.append(body[:, axis])
            flown.append(held - trim)
    velocity = np.concatenate(speed)
    told = 1e3 * predictor.drag_height * drag * velocity
    return velocity, np.concatenate(flown), told


def moment_bins(velocity: np.ndarray, moment: np.ndarray) -> list[dict[str, float]]:
    """Return bins of velocity: mean velocity, m/s, mean moment, mN m, count."""
    return binned(velocity, SPEEDS, {"velocity": velocity, "moment": moment}, FEWEST)


def moment_errors(velocity: np.ndarray, flown: np.ndarray, told: np.ndarray) -> list[float]:
    """Return RMS errors of moments, mN m: of samples, of bins."""
    binned_apart = binned_error(moment_bins(velocity, flown), moment_bins(velocity, told), "moment")
    return [float(rms(flown - told)), binned_apart]
