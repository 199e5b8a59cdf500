"""Predictions of NanoBench's flights, by the dynamics of the package, and their errors."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bulletuav.geometry.quaternions import multiply_quaternions, rotate_vectors
from bulletuav.geometry.rotation import exp_map
from bulletuav.identification.errors import conjugate
from bulletuav.identification.rollout import Legs, make_track, predict_legs, simulate_rotors
from bulletuav.reproduction.flight_series import compute_state_errors, pick_evenly
from bulletuav.reproduction.nanobench_flights import (
    MIN_FLIGHT_COMMAND,
    MIN_FLIGHT_HEIGHT,
    NANOBENCH_DT,
    NanobenchFlight,
    compute_rotor_commands,
)
from bulletuav.vehicle.airframe import STANDARD_GRAVITY, Airframe
from bulletuav.vehicle.parameters import parameter_rows

HORIZON = 50
"""Number of predicted rows: half a second"""
WARM_UP_ROWS = 50
"""Rows of flight before a window, in which the rotor speeds settle"""
RATE_ROWS = 10
"""Rows after which body rates are compared in the calibration"""
CALIBRATION_ROUNDS = 6
"""Rounds of the calibration"""
CHANNELS = ("position", "velocity", "attitude", "rates")
"""Quantities of which errors are computed"""


@dataclass(frozen=True)
class DroneTrim:
    """Properties of one drone that its logs do not contain.

    Attributes:
        gain: Factor of the thrust (propellers, battery).
        tilt: Rotation vector from the drone's body to the tracked body: about x and y, rad.
        torque: Constant torque, body axes, N m.
    """

    gain: float = 1.0
    tilt: tuple[float, float] = (0.0, 0.0)
    torque: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class FlightWindows:
    """Windows of one flight.

    Attributes:
        flight: The flight.
        starts: (W,) index of the first row of each window.
    """

    flight: NanobenchFlight
    starts: np.ndarray


def find_flown_windows(flight: NanobenchFlight, count: int) -> FlightWindows:
    """Find windows in which the drone flies, and did before; gaps of the log are left out."""
    is_flown = (flight.position[:, 2] > MIN_FLIGHT_HEIGHT) & (
        flight.pwm.min(axis=1) > MIN_FLIGHT_COMMAND
    )
    # The n-th sum counts the rows before row n in which the drone does not fly
    missing = np.concatenate([[0], np.cumsum(~is_flown)])
    first = np.arange(WARM_UP_ROWS, len(is_flown) - HORIZON)
    seconds = flight.time[first + HORIZON] - flight.time[first]
    good = missing[first + HORIZON + 1] == missing[first - WARM_UP_ROWS]
    good &= np.abs(seconds - HORIZON * NANOBENCH_DT) < 1.5 * NANOBENCH_DT
    return FlightWindows(flight, pick_evenly(first[good], count))


def find_all_windows(flight: NanobenchFlight, count: int) -> FlightWindows:
    """Return windows of the whole log, on the ground as well."""
    return FlightWindows(flight, pick_evenly(np.arange(len(flight.time) - HORIZON), count))


def predict_constant_windows(windows: FlightWindows) -> np.ndarray:
    """Predict that the state stays as it is, (W, HORIZON, 13)."""
    return np.repeat(windows.flight.state[windows.starts][:, None], HORIZON, axis=1)


def hold_rates(airframe: Airframe) -> Airframe:
    """Return an airframe whose body rates do not change: with infinite inertia."""
    return replace(airframe, inertia=(1e6, 1e6, 1e6), damping=(0.0, 0.0, 0.0))


def predict_windows(
    windows: FlightWindows, airframe: Airframe, trim: DroneTrim, is_guided: bool
) -> np.ndarray:
    """Predict windows with the `rigid_body` dynamics, from measured states and logged commands.

    Args:
        windows: The windows.
        airframe: The airframe, with the mass in flight.
        trim: Properties of the drone.
        is_guided: Whether attitude and rates are those of the log; otherwise the whole state is
            predicted.

    Returns:
        Predicted positions, quaternions, velocities and rates, (W, HORIZON, 13).
    """
    flight = windows.flight
    command = compute_rotor_commands(flight.pwm, flight.volts[:, None])
    parameters = parameter_rows([airframe])[None]
    parameters["thrust_coefficient"][0, 0] *= trim.gain
    parameters["torque_coefficient"][0, 0] *= trim.gain
    speed = np.empty_like(command)
    simulate_rotors(command, parameters[0, 0], NANOBENCH_DT, speed)
    return predict_legs(
        Legs(windows.starts.astype(np.int64), HORIZON, 1, is_guided),
        make_track(flight.state),
        command,
        speed,
        parameters,
        NANOBENCH_DT,
        exp_map((*trim.tilt, 0.0)),
        trim.torque,
    )


def compute_channel_errors(
    windows: FlightWindows, states: np.ndarray, tilt: tuple[float, float] = (0.0, 0.0)
) -> np.ndarray:
    """Compute the sizes of errors of predicted states, as NanoBench's equation 5.

    Args:
        windows: The windows.
        states: Predicted states, (W, HORIZON, 13).
        tilt: Tilt of the tracked body, see `DroneTrim`.

    Returns:
        Norms of the errors of position (m), velocity (m/s), attitude (angle, rad) and body rates
        (rad/s), (W, HORIZON, 4).
    """
    measured = windows.flight.state[windows.starts[:, None] + np.arange(1, HORIZON + 1)]
    tilted = np.array(exp_map((*tilt, 0.0)))
    measured[..., 3:7] = multiply_quaternions(measured[..., 3:7], tilted)
    return compute_state_errors(states, measured, is_shortest=True)


def calibrate_trim(training: Sequence[FlightWindows], airframe: Airframe) -> DroneTrim:
    """Calibrate a drone on training flights.

    In each round the medians of the remaining errors correct the trim: of the velocity after half a
    second with the attitude of the log, and of the body rates after `RATE_ROWS` rows.

    Args:
        training: Windows of the training flights.
        airframe: The airframe, with the mass in flight.
    """
    trim = DroneTrim()
    inertia = np.array(airframe.inertia)
    for _ in range(CALIBRATION_ROUNDS):
        pushes, turns = [], []
        for windows in training:
            flight, starts = windows.flight, windows.starts
            end = starts + HORIZON
            guided = predict_windows(windows, airframe, trim, is_guided=True)
            push = (flight.velocity[end] - guided[:, -1, 7:10]) / (HORIZON * NANOBENCH_DT)
            middle = conjugate(flight.quaternion[starts + HORIZON // 2])
            pushes.append(rotate_vectors(middle, push))
            free = predict_windows(windows, airframe, trim, is_guided=False)
            error = flight.rates[starts + RATE_ROWS] - free[:, RATE_ROWS - 1, 10:]
            turns.append(error / (RATE_ROWS * NANOBENCH_DT))
        x, y, z = np.median(np.concatenate(pushes), axis=0) / STANDARD_GRAVITY
        torque = np.array(trim.torque) + inertia * np.median(np.concatenate(turns), axis=0)
        # A rotation by (a, b, 0) turns the thrust towards (b, -a)
        trim = DroneTrim(
            gain=float(trim.gain * (1.0 + z)),
            tilt=(float(trim.tilt[0] - y), float(trim.tilt[1] + x)),
            torque=(float(torque[0]), float(torque[1]), float(torque[2])),
        )
    return trim
