"""Example flight logs: simulated flights with the noise of real sensors."""

import csv
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from bulletuav.envs.airspace import Airspace
from bulletuav.files import whole_file
from bulletuav.geometry.rotation import axes
from bulletuav.identification.checks import require_no_wings
from bulletuav.vehicle.airframe import STANDARD_GRAVITY, Airframe

HZ = 100
"""Rate of log rows and of decisions, Hz"""
COLUMNS = ("t", "x", "y", "z", "qx", "qy", "qz", "qw", "p", "q", "r", "w1", "w2", "w3", "w4")
POSITION_NOISE, ATTITUDE_NOISE, GYRO_NOISE = 3e-4, np.deg2rad(0.2), 0.02
"""Standard deviations of a motion capture system, m and rad, and of a gyroscope, rad/s"""
Path3 = Callable[[float], np.ndarray]
"""Function from time (s) to a position (3,), m"""


def fly_example(
    airframe: Airframe,
    seconds: float,
    seed: int,
    *,
    delay: int = 2,
    path: Path3 | None = None,
    other: Path3 | None = None,
) -> np.ndarray:
    """Simulate a flight along a path, with sinusoidal excitation of all torques.

    Args:
        airframe: The airframe.
        seconds: Duration, s.
        seed: Seed of the sines.
        delay: Number of rows after which a logged command takes effect.
        path: The path; by default slow sines about 1 m above the ground.
        other: Path of a second drone.

    Returns:
        Rows of `COLUMNS`, followed by other_x, other_y, other_z if there is a second drone.

    Raises:
        ValueError: If the airframe has wings.
    """
    require_no_wings(airframe)
    rng = np.random.default_rng(seed)
    slow = rng.uniform(0.1, 0.9, (3, 5)), rng.uniform(0, 2 * np.pi, (3, 5))
    fast = rng.uniform(1.0, 5.0, (3, 6)), rng.uniform(0, 2 * np.pi, (3, 6))

    def sines(kind: tuple[np.ndarray, np.ndarray], time: float) -> np.ndarray:
        total: np.ndarray = np.sin(2 * np.pi * kind[0] * time + kind[1]).sum(axis=1)
        return total

    def default_path(time: float) -> np.ndarray:
        place: np.ndarray = np.array([0, 0, 1]) + np.array([0.33, 0.33, 0.2]) * sines(slow, time)
        return place

    path = path or default_path
    hover = airframe.hover_speed()
    places = [path(0.0)] + ([] if other is None else [other(0.0)])
    space = Airspace(
        np.array(places),
        airframe=airframe,
        rotor_speed=hover,
        seed=seed,
        dynamics="rigid_body",
        physics_hz=400,
        decision_hz=HZ,
    )
    mixer = np.linalg.pinv(airframe.allocation())
    queue = [np.full(mixer.shape[0], hover)] * delay
    rows = []
    for k in range(int(seconds * HZ)):
        time = k / HZ
        state = [array[0].copy() for array in space.swarm[:4]]
        excitation = np.array([6, 6, 3]) * sines(fast, time)
        command = compute_rotor_speeds(airframe, mixer, state, path(time), excitation)
        place = [] if other is None else space.swarm.position[1]
        rows.append([time, *state[0], *state[1], *state[3], *command, *place])
        queue.append(command)
        space.command(0, "rotor", queue.pop(0))
        if other is not None:
            space.command(1, "position", other(time))
        space.step()
    return np.array(rows)


def compute_rotor_speeds(
    airframe: Airframe,
    mixer: np.ndarray,
    state: Sequence[np.ndarray],
    goal: np.ndarray,
    excitation: np.ndarray,
) -> np.ndarray:
    """Compute rotor speeds that fly an airframe to a goal, by geometric control.

    Args:
        airframe: The airframe.
        mixer: Matrix from thrust and torques to squared rotor speeds times the thrust coefficient,
            (4, 4).
        state: Position, attitude, velocity and body rates.
        goal: Goal position, (3,), m.
        excitation: Additional angular acceleration, (3,), rad/s^2.

    Returns:
        Rotor speeds, (4,), rad/s.
    """
    position, quaternion, velocity, rates = state
    acceleration = np.clip(3.0 * (goal - position) - 2.5 * velocity, -4, 4)
    acceleration += np.array([0, 0, STANDARD_GRAVITY])
    body = np.array(axes(tuple(quaternion)))
    direction = body @ acceleration / np.linalg.norm(acceleration)
    yaw = np.arctan2(body[0, 1], body[0, 0])
    turn = np.array([-direction[1], direction[0], -0.3 * np.sin(yaw)])
    angular = np.array([40, 40, 16]) * turn - np.array([9, 9, 6]) * rates + excitation
    thrust = airframe.mass * max(acceleration @ body[2], 3.0)
    force = mixer @ np.array([thrust, *(np.array(airframe.inertia) * angular)])
    max_force = airframe.thrust_coefficient * airframe.max_rotor_speed**2
    speeds: np.ndarray = np.sqrt(np.clip(force, 0.0, max_force) / airframe.thrust_coefficient)
    return speeds


def add_sensor_noise(rows: np.ndarray, seed: int) -> np.ndarray:
    """Add sensor noise to the rows of a log."""
    rng = np.random.default_rng(seed)
    rows = rows.copy()
    rows[:, 1:4] += POSITION_NOISE * rng.standard_normal((len(rows), 3))
    x, y, z, w = rows[:, 4:8].T
    a, b, c = 0.5 * ATTITUDE_NOISE * rng.standard_normal((3, len(rows)))
    # Quaternion product with (a, b, c, 1), a small rotation
    turned = (w * a + x + y * c - z * b, w * b + y + z * a - x * c)
    rows[:, 4:8] = np.stack([*turned, w * c + z + x * b - y * a, w - x * a - y * b - z * c], axis=1)
    rows[:, 4:8] /= np.linalg.norm(rows[:, 4:8], axis=1)[:, None]
    rows[:, 8:11] += GYRO_NOISE * rng.standard_normal((len(rows), 3))
    return rows


def write_example_log(path: Path | str, rows: np.ndarray, names: Sequence[str] = COLUMNS) -> Path:
    """Write rows as a CSV log.

    Args:
        path: The file.
        rows: Numbers, one row per time.
        names: Names of the columns.

    Returns:
        The path of the file.
    """
    with whole_file(Path(path)) as part, open(part, "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        writer.writerows([[f"{value:.9g}" for value in row] for row in rows])
    return Path(path)
