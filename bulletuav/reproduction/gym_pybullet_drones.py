"""Flights of gym-pybullet-drones in this package, with its constants.

What is written here again, from its formulas: the PID runs once per control step and takes rates
from differences of Euler angles; Bullet damps motion; the wake of `Physics.PYB_DW`. Everything
else is the `rigid_body` of this package and the PID of `bulletuav.control.pid`, with the airframe
that `convert_urdf` reads from the URDF of gym-pybullet-drones.

References:
    J. Panerati, H. Zheng, S. Zhou, J. Xu, A. Prorok, A. Schoellig, Learning to fly - a gym
    environment with PyBullet physics for reinforcement learning of multi-agent quadcopter control
    (2021).
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from bulletuav.control.gains import gain_rows
from bulletuav.control.pid import pid_rotors
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.envs.airspace import Airspace
from bulletuav.geometry.rotation import from_euler
from bulletuav.reproduction.gym_pybullet_drones_child import ACTIONS, LEARNING_HZ, fixed_actions
from bulletuav.vehicle.airframe import Airframe, Pwm
from bulletuav.vehicle.conversion import convert_urdf
from bulletuav.vehicle.parameters import parameter_rows
from bulletuav.vehicle.rotors import RPM

CHILD = Path(__file__).with_name("gym_pybullet_drones_child.py")
"""Program of the subprocess"""
MAX_PEER_SECONDS = 600.0
"""Time limit of the subprocess, s"""
PEER_GRAVITY = 9.8
"""Gravitational acceleration of gym-pybullet-drones, m/s^2"""
PEER_HZ, CONTROL_HZ = 240, 48
"""Physics steps and control steps of the scripts, 1/s"""
PEER_PWM = Pwm(0.2685, 4070.3, 20000, 65535)
"""Motor map of its PID"""
BULLET_DAMPING = 0.04
"""Bullet's default damping, linear and angular: 1/s, and once more per m/s or rad/s"""
RESTART = 0.5
"""Time between restarts from its states in flights with its rotor speeds, s"""
SPEED_LIMIT = 0.03 * 30.0 / 3.6
"""Speed of velocity commands, m/s: 3 % of the 30 km/h in its URDF"""
WAKE_GAIN, WAKE_SLOPE, WAKE_OFFSET = 2267.18, 0.16, -0.11
"""Constants of its downwash: N, width per distance, width at the rotors, m"""
WAKE_REACH = 10.0
"""Horizontal distance beyond which there is no downwash, m"""
PEER_PROPELLER = 2.31348e-2
"""Radius of its propellers, m"""

Command = Callable[["PeerFlight", int], np.ndarray]
"""Rotor speeds (N, 4) of a control step, rad/s, by flight and number of the step"""


def fly_peer_examples(folder: Path, seconds: int, shift: float = 0.0) -> dict[str, np.ndarray]:
    """Run the examples of gym-pybullet-drones in a subprocess.

    Args:
        folder: A clone of gym-pybullet-drones.
        seconds: Duration, s.
        shift: Shift of the starts along each axis, m, and about each axis, rad.

    Returns:
        States (T, N, 20) after each control step, by name of the flight.

    Raises:
        ValueError: If the examples end with an error, with the last line of its message.
    """
    with tempfile.TemporaryDirectory() as place:
        out = Path(place) / "flights.npz"
        arguments = [str(folder.resolve()), str(out), str(seconds), repr(shift)]
        try:
            done = subprocess.run(
                [sys.executable, "-P", str(CHILD), *arguments],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                timeout=MAX_PEER_SECONDS,
                cwd=place,
                env={**os.environ, "MPLBACKEND": "Agg"},
            )
        except subprocess.TimeoutExpired:
            raise ValueError(
                f"the examples in {folder} take more than {MAX_PEER_SECONDS:g} s: use a faster "
                f"machine, or a smaller --size"
            ) from None
        if done.returncode:
            lines = done.stderr.decode(errors="replace").split("\n")
            last = next((line for line in reversed(lines) if line.strip()), "no message")
            raise ValueError(
                f"the examples in {folder} end with {last.strip()!r}: install what they import, or "
                f"check out the commit of the table"
            )
        with np.load(out) as archive:
            return {name: archive[name] for name in archive.files}


def read_peer_airframe(folder: Path, place: Path) -> Airframe:
    """Convert the Crazyflie cf2x of gym-pybullet-drones, with the motor map of its PID.

    Args:
        folder: A clone of gym-pybullet-drones.
        place: Folder for the converted URDF, which flights need.
    """
    source = folder / "gym_pybullet_drones" / "assets" / "cf2x.urdf"
    airframe = convert_urdf(source, place / "cf2x.urdf").airframe
    return replace(airframe, pwm=PEER_PWM, damping=(0.0, 0.0, 0.0))


class PeerFlight:
    """Drones with the constants of gym-pybullet-drones.

    Attributes:
        airspace: The drones.
        has_bullet_steps: Whether positions, attitudes and thrusts advance as in Bullet's
            semi-implicit Euler steps, in place of the Runge-Kutta steps of `rigid_body`.
        period: Duration of a control step, s.
    """

    def __init__(
        self,
        airframe: Airframe,
        starts: np.ndarray,
        yaws: np.ndarray,
        control_hz: int = CONTROL_HZ,
        has_wakes: bool = False,
    ) -> None:
        """Place drones (N, 3), m, with yaws (N,), rad, at rest with stopped rotors."""
        self.airspace = Airspace(
            starts,
            airframe,
            physics_hz=PEER_HZ,
            decision_hz=PEER_HZ,
            dynamics="rigid_body",
            effects=(),
            gravity=PEER_GRAVITY,
            quaternion=[from_euler(0.0, 0.0, float(yaw)) for yaw in yaws],
        )
        self._airframe, self._has_wakes = airframe, has_wakes
        self._row = parameter_rows([airframe])[0]
        self._gain = gain_rows([airframe], 10.0)[0]
        self.has_bullet_steps = True
        self._last = Rotation.from_quat(self.airspace.swarm.quaternion)
        self._steps, self.period = PEER_HZ // control_hz, 1.0 / control_hz
        count = len(starts)
        self._integrals = [((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))] * count
        self._angles = np.zeros((count, 3))

    @property
    def angles(self) -> np.ndarray:
        """Roll, pitch and yaw of the drones, (N, 3) rad."""
        angles: np.ndarray = Rotation.from_quat(self.airspace.swarm.quaternion).as_euler("xyz")
        return angles

    def control(
        self, positions: np.ndarray, velocities: np.ndarray, yaws: np.ndarray
    ) -> np.ndarray:
        """Run the PID of all drones for one control step.

        Args:
            positions: (N, 3) targets, m.
            velocities: (N, 3) targets, m/s.
            yaws: (N,) targets, rad.

        Returns:
            (N, 4) rotor speeds, rad/s.
        """
        swarm, angles = self.airspace.swarm, self.angles
        # Rates are differences of Euler angles, without regard of their jumps by 2 pi
        rates = (angles - self._angles) / self.period
        self._angles = angles
        speeds = np.zeros((len(angles), 4))
        for i in range(len(angles)):
            self._integrals[i] = pid_rotors(
                tuple(positions[i] - swarm.position[i]),
                tuple(velocities[i] - swarm.velocity[i]),
                float(yaws[i]),
                tuple(swarm.quaternion[i]),
                tuple(rates[i]),
                self._integrals[i],
                self.period,
                PEER_GRAVITY,
                self._row,
                self._gain,
                speeds[i],
            )
        return speeds

    def step(self, speeds: np.ndarray) -> None:
        """Fly one control step with rotor speeds (N, 4), rad/s."""
        swarm = self.airspace.swarm
        self.airspace.command(None, SetpointLevel.ROTOR, speeds)
        thrust = self._airframe.thrust_coefficient * (speeds**2).sum(axis=1)
        for _ in range(self._steps):
            position, attitude = swarm.position.copy(), Rotation.from_quat(swarm.quaternion)
            force = -self._airframe.mass * damped(swarm.velocity)
            torque = -np.array(self._airframe.inertia) * damped(swarm.rates)
            if self._has_wakes:
                wake = compute_peer_wakes(swarm.position)
                # The wake pushes down along the body's own axis
                force -= wake[:, None] * _upward(attitude)
            if self.has_bullet_steps:
                # Bullet's thrust has the direction of the last step, not that in this one
                middle = attitude * Rotation.from_rotvec(0.5 * swarm.rates / PEER_HZ)
                force += thrust[:, None] * (_upward(self._last) - _upward(middle))
                rotors = self._torque(speeds)
                torque += (attitude.inv() * self._last).apply(rotors) - rotors
                self._last = attitude
            self.airspace.apply(None, force.tolist(), torque.tolist())
            self.airspace.step()
            if self.has_bullet_steps:
                self._integrate_like_bullet(position, attitude, speeds)

    def _torque(self, speeds: np.ndarray) -> np.ndarray:
        """Return the torques (N, 3) of rotors, N m."""
        x, y, turn = np.array(self._airframe.rotors).T
        thrust = self._airframe.thrust_coefficient * speeds**2
        levers = np.stack([y, -x, self._airframe.torque_ratio * turn], axis=1)
        torque: np.ndarray = thrust @ levers
        return torque

    def _integrate_like_bullet(
        self, position: np.ndarray, attitude: Rotation, speeds: np.ndarray
    ) -> None:
        """Replace positions and attitudes by those of semi-implicit Euler steps.

        Args:
            position: (N, 3) positions before the step, m.
            attitude: N attitudes before the step.
            speeds: (N, 4) rotor speeds, rad/s.
        """
        swarm, dt = self.airspace.swarm, 1.0 / PEER_HZ
        velocity, rates = swarm.velocity.copy(), swarm.rates.copy()
        # Bullet multiplies by the rotation vector of the new rates
        turned = attitude * Rotation.from_rotvec(rates * dt)
        self.airspace.place(
            None,
            position + velocity * dt,
            turned.as_quat(),
            velocity=velocity,
            rates=rates,
            rotor_speed=speeds,
        )

    def restart(self, states: np.ndarray) -> None:
        """Continue from states (N, 20) of gym-pybullet-drones."""
        attitude = Rotation.from_quat(states[:, 3:7])
        rates = attitude.inv().apply(states[:, 13:16])
        # Rates are in world axes there, and turned the drone in the last step
        self._last = attitude * Rotation.from_rotvec(-rates / PEER_HZ)
        self.airspace.place(None, states[:, :3], states[:, 3:7], states[:, 10:13], rates)

    def close(self) -> None:
        """Close the airspace."""
        self.airspace.close()


def _upward(attitude: Rotation) -> np.ndarray:
    """Return the z axes (N, 3) of attitudes."""
    axes: np.ndarray = attitude.apply((0.0, 0.0, 1.0))
    return axes


def damped(motion: np.ndarray) -> np.ndarray:
    """Return Bullet's damping (N, 3) of velocities, m/s^2, or of rates, rad/s^2."""
    size = np.sqrt((motion**2).sum(axis=1, keepdims=True))
    slowed: np.ndarray = BULLET_DAMPING * (1.0 + size) * motion
    return slowed


def compute_peer_wakes(position: np.ndarray) -> np.ndarray:
    """Return the downwash of gym-pybullet-drones on drones at positions (N, 3), (N,) N."""
    drop = position[None, :, 2] - position[:, None, 2]
    offset = position[None, :, :2] - position[:, None, :2]
    aside = np.sqrt((offset**2).sum(axis=2))
    below = (drop > 0.0) & (aside < WAKE_REACH)
    safe = np.where(below, drop, 1.0)
    strength = WAKE_GAIN * (PEER_PROPELLER / (4.0 * safe)) ** 2
    width = WAKE_SLOPE * safe + WAKE_OFFSET
    each = np.where(below, strength * np.exp(-0.5 * (aside / width) ** 2), 0.0)
    total: np.ndarray = each.sum(axis=1)
    return total


def _circles(airframe: Airframe) -> tuple[PeerFlight, Command]:
    """Return the flight of pid.py: three drones on circles, at three heights."""
    radius, count = 0.3, 10 * CONTROL_HZ
    drones = np.arange(3)
    angle = drones / 6 * 2 * np.pi + np.pi / 2
    height = 0.1 + 0.05 * drones
    starts = np.stack([radius * np.cos(angle), radius * np.sin(angle) - radius, height], axis=1)
    yaws = drones * (np.pi / 2) / 3
    first = drones * count // 6
    flight = PeerFlight(airframe, starts, yaws)

    def command(flight: PeerFlight, k: int) -> np.ndarray:
        if k == 0:  # rotors stand still in the first step
            return np.zeros((3, 4))
        turn = (first + k - 1) % count / count * 2 * np.pi + np.pi / 2
        x = radius * np.cos(turn) + starts[0, 0]
        y = radius * np.sin(turn) - radius + starts[0, 1]
        return flight.control(np.stack([x, y, height], axis=1), np.zeros((3, 3)), yaws)

    return flight, command


def _crossing(airframe: Airframe) -> tuple[PeerFlight, Command]:
    """Return the flight of downwash.py: two drones cross above each other."""
    count, starts = 5 * CONTROL_HZ, np.array([[0.5, 0.0, 1.0], [-0.5, 0.0, 0.5]])
    flight = PeerFlight(airframe, starts, np.zeros(2), has_wakes=True)

    def command(flight: PeerFlight, k: int) -> np.ndarray:
        if k == 0:
            return np.zeros((2, 4))
        turn = (np.array([0, count // 2]) + k - 1) % count / count * 2 * np.pi
        target = np.stack([0.5 * np.cos(turn), np.zeros(2), starts[:, 2]], axis=1)
        return flight.control(target, np.zeros((2, 3)), np.zeros(2))

    return flight, command


def _velocities(airframe: Airframe, seconds: int) -> tuple[PeerFlight, Command]:
    """Return the flight of pid_velocity.py: four drones that turn back at different times."""
    starts = np.stack([0.3 * np.arange(4), np.zeros(4), np.full(4, 0.1)], axis=1)
    flight = PeerFlight(airframe, starts, np.array([0.0, np.pi / 3, np.pi / 4, np.pi / 2]))
    ways = np.array([[-0.5, 1.0, 0.0], [0.0, 1.0, 0.0], [0.2, 1.0, 0.2], [0.0, 1.0, 0.5]])
    ways /= np.sqrt((ways**2).sum(axis=1, keepdims=True))
    count = CONTROL_HZ * seconds
    turns = count / 8 + np.arange(4) * count / 6

    def command(flight: PeerFlight, k: int) -> np.ndarray:
        # A command acts in the step after it; the first one is to stand still
        sign = np.where(k - 1 < turns, 1.0, -1.0) * (k > 0)
        target = 0.99 * SPEED_LIMIT * sign[:, None] * ways
        return flight.control(flight.airspace.swarm.position.copy(), target, flight.angles[:, 2])

    return flight, command


def _actions(airframe: Airframe, kind: str, seconds: int) -> tuple[PeerFlight, Command]:
    """Return the flight of one drone with the fixed actions of a learning environment."""
    start = np.array([[0.0, 0.0, 0.025 / 2 + 0.1]])
    flight = PeerFlight(airframe, start, np.zeros(1), LEARNING_HZ)
    actions = fixed_actions(kind, LEARNING_HZ * seconds)
    hover = airframe.hover_speed(PEER_GRAVITY)
    nothing = np.zeros((1, 3))

    def command(flight: PeerFlight, k: int) -> np.ndarray:
        action, here = actions[k], flight.airspace.swarm.position.copy()
        if kind in ("RPM", "ONE_D_RPM"):
            return np.broadcast_to(hover * (1.0 + 0.05 * action), (1, 4)).copy()
        if kind == "PID":
            return flight.control(action[None], nothing, np.zeros(1))
        if kind == "ONE_D_PID":
            return flight.control(
                here + np.array((0.0, 0.0, 0.1 * action[0])), nothing, np.zeros(1)
            )
        way = action[:3] / np.sqrt((action[:3] ** 2).sum())
        target = SPEED_LIMIT * abs(action[3]) * way[None]
        return flight.control(here, target, flight.angles[:, 2])

    return flight, command


def _makers(
    airframe: Airframe, seconds: int
) -> dict[str, Callable[[], tuple[PeerFlight, Command]]]:
    """Return the functions that start each flight."""
    return {
        "pid": lambda: _circles(airframe),
        "pid_velocity": lambda: _velocities(airframe, seconds),
        "downwash": lambda: _crossing(airframe),
        **{kind: partial(_actions, airframe, kind, seconds) for kind in ACTIONS},
    }


def fly_like_peer(
    airframe: Airframe, peer: Mapping[str, np.ndarray], seconds: int, manner: str
) -> dict[str, np.ndarray]:
    """Fly the flights of gym-pybullet-drones in this package.

    Args:
        airframe: Airframe of `read_peer_airframe`.
        peer: Its states (T, N, 20), by name of the flight.
        seconds: Duration that the scripts are given, s.
        manner: "closed" for the PID with Bullet's steps, "plain" for the PID with the steps of
            `rigid_body`, "open" for its rotor speeds with Bullet's steps, from its state every
            `RESTART`.

    Returns:
        Positions (T, N, 3) after each control step, by name, m.
    """
    makers, tracks = _makers(airframe, seconds), {}
    for name, states in peer.items():
        flight, command = makers[name]()
        flight.has_bullet_steps = manner != "plain"
        track = []
        for k, state in enumerate(states):
            if manner != "open":
                flight.step(command(flight, k))
            else:
                if k and k % round(RESTART / flight.period) == 0:
                    flight.restart(states[k - 1])
                flight.step(state[:, 16:] * RPM)
            track.append(flight.airspace.swarm.position.copy())
        flight.close()
        tracks[name] = np.array(track)
    return tracks


def compare_controllers(
    airframe: Airframe, peer: Mapping[str, np.ndarray], seconds: int
) -> dict[str, float]:
    """Return the largest difference of rotor speeds for the same states, by flight, rpm.

    Args:
        airframe: Airframe of `read_peer_airframe`.
        peer: States (T, N, 20) of gym-pybullet-drones, by name of the flight.
        seconds: Duration that the scripts are given, s.
    """
    makers, worst = _makers(airframe, seconds), {}
    for name, states in peer.items():
        flight, command = makers[name]()
        most = 0.0
        for k, state in enumerate(states):
            difference = command(flight, k) / RPM - state[:, 16:]
            most = max(most, float(np.abs(difference).max()))
            flight.airspace.place(None, state[:, :3], state[:, 3:7], velocity=state[:, 10:13])
        flight.close()
        worst[name] = most
    return worst
