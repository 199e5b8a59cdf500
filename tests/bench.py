"""A test bench: one kind of dynamics with a swarm of its own, without a task."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bulletuav.control.autopilot import autopilot_rows
from bulletuav.control.cascade import Cascade
from bulletuav.control.gains import gain_rows
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics import DYNAMICS, find_dynamics
from bulletuav.dynamics.base import FlightSetup
from bulletuav.engine.engine import Engine
from bulletuav.vehicle.airframe import STANDARD_GRAVITY
from bulletuav.vehicle.airframes import available_airframes, load_airframe
from bulletuav.vehicle.parameters import DEFAULT_EFFECTS, parameter_rows
from bulletuav.vehicle.swarm import ObstacleMotion, Swarm
from bulletuav.vehicle.wings import WingTable

MULTIROTORS = [name for name in available_airframes() if not load_airframe(name).wings]
"""Airframes of the package that hover without wings"""
FLIGHTS = [
    (name, contacts)
    for name in DYNAMICS
    for contacts in find_dynamics(name).contacts
    if contacts != "bullet"
]
"""Dynamics, each with all that contacts can do in it but for the engine's own"""


def ranges(shots):
    """Give parameters of ranges: airframes, flights, and numbers of shots.

    Each airframe flies in two of them, and each flight with two airframes or more. All of them
    together have 1,000 shots each, which takes long.
    """
    for k, airframe in enumerate(MULTIROTORS):
        for j, flight in enumerate(FLIGHTS):
            if (j - k) % len(FLIGHTS) in (0, 3):
                yield pytest.param(airframe, *flight, shots)
            yield pytest.param(airframe, *flight, 1000, marks=pytest.mark.slow)


def rims(airframe):
    """Give points (P, 3) all around both flat sides of a cylinder, and their middles, m."""
    radius, _, half = airframe.shape.half
    turn = np.radians(np.arange(0, 360, 10))
    ring = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.zeros(len(turn))])
    points = np.concatenate([ring, np.zeros((1, 3))])
    return np.concatenate([points + (0, 0, side * half) for side in (-1, 1)])


class Bench:
    """W worlds of N drones, 5 m apart at 10 m, level, at rest, rotors at hover speed."""

    def __init__(
        self,
        dynamics,
        airframe="hummingbird",
        *,
        worlds=1,
        drones=1,
        hz=240,
        substeps=24,
        effects=DEFAULT_EFFECTS,
        controller="lee",
        gravity=STANDARD_GRAVITY,
        wind=(0, 0, 0),
        max_speed=20.0,
        obstacles=(),
        layouts=(),
        first_world=0,
        rays="compiled",
        contacts=None,
        friction=0.5,
        restitution=0.0,
    ):
        # A tuple has one airframe for each drone
        given = airframe if isinstance(airframe, tuple) else (airframe,) * drones
        airframes, drones = [load_airframe(one) for one in given], len(given)
        self.airframe = airframes[0]
        self.dt = 1 / hz
        self.substeps = substeps
        self.gravity = gravity
        kind = find_dynamics(dynamics)
        contacts = contacts or kind.contacts[0]
        self.engine = Engine(
            airframes,
            worlds,
            self.dt,
            obstacles,
            layouts,
            first_world,
            rays=rays,
            contacts=contacts == "bullet",
        )
        self.motion = ObstacleMotion.none(worlds)
        tiled = (worlds, 1)
        pilots = autopilot_rows(airframes, max_speed)
        cascade = Cascade.of(
            controller,
            np.tile(parameter_rows(airframes), tiled),
            np.tile(gain_rows(airframes, max_speed), tiled),
            autopilot=None if pilots is None else np.tile(pilots, tiled),
        )
        parameters = np.tile(parameter_rows(airframes, effects), tiled)
        self.dynamics = kind(
            FlightSetup(
                engine=self.engine,
                parameters=parameters,
                cascade=cascade,
                dt=self.dt,
                substeps=substeps,
                gravity=gravity,
                contacts=contacts,
                friction=friction,
                restitution=restitution,
                wings=WingTable.of(airframes, worlds),
            )
        )
        surfaces = max(len(one.surfaces) for one in airframes)
        rotors = max(len(one.rotors) for one in airframes)
        self.swarm = Swarm.zeros(worlds, drones, rotors, surfaces)
        self.swarm.position[..., 0] = 5 * np.arange(drones)
        self.swarm.position[..., 2] = 10
        for i, one in enumerate(airframes):
            self.swarm.rotor_speed[:, i] = one.hover_speed()
        self.alive = np.ones((worlds, drones), dtype=bool)
        self.wind = np.broadcast_to(np.array(wind, float), (worlds, drones, 3)).copy()

    def place(self):
        self.dynamics.place(self.swarm, self.alive)
        return self

    def fly(self, level, setpoint, decisions=1):
        """Hold a setpoint (broadcast to all drones); return the contacts of the last decision."""
        setpoint = np.broadcast_to(
            np.asarray(setpoint, float), (*self.alive.shape, np.shape(setpoint)[-1])
        ).copy()
        for _ in range(decisions):
            contacts = self.dynamics.fly(
                self.swarm, self.alive, SetpointLevel(level), setpoint, self.wind, self.motion
            )
        return contacts

    def place_trimmed(self, trim, height=1000.0):
        """Start in a steady flight to the east, with the rotors and surfaces of a `Trim`."""
        self.swarm.position[..., 2] = height
        turned = Rotation.from_euler("ZYX", (0.0, -trim.pitch, trim.bank))
        self.swarm.quaternion[:] = turned.as_quat()
        alpha, beta = trim.alpha, trim.sideslip
        ahead = np.array(
            (np.cos(alpha) * np.cos(beta), -np.sin(beta), -np.sin(alpha) * np.cos(beta))
        )
        self.swarm.velocity[:] = turned.apply(trim.airspeed * ahead) + self.wind
        self.swarm.rates[:] = turned.inv().apply((0.0, 0.0, -trim.turn_rate))
        self.swarm.rotor_speed[:] = trim.speed
        self.swarm.deflection[:] = trim.deflection
        return self.place()

    def hold(self, speed, deflection, decisions=1):
        """Hold rotor speeds (rad/s) and deflections (rad)."""
        return self.fly(SetpointLevel.ROTOR, (*speed, *deflection), decisions)

    def spin(self, speed, decisions=1):
        """Hold rotor speeds (rad/s)."""
        return self.fly(
            SetpointLevel.ROTOR, np.broadcast_to(speed, len(self.airframe.rotors)), decisions
        )

    def trace(self, level, setpoint, decisions):
        """(T, 3) position and velocity of the first drone after every decision."""
        rows = []
        for _ in range(decisions):
            self.fly(level, setpoint)
            rows.append((self.swarm.position[0, 0].copy(), self.swarm.velocity[0, 0].copy()))
        return tuple(np.array(column) for column in zip(*rows, strict=True))
