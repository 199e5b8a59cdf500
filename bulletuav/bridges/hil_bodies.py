"""Bodies for autopilots that fly in lockstep: what their sensors measure, what their motors do."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from bulletuav.bridges.mavlink_fleet import HOME, SPACING
from bulletuav.bridges.mavlink_wire import Message, Told
from bulletuav.bridges.setpoints import (
    NORTH,
    AirspaceCommand,
    apply_commands,
    compute_corner_speeds,
    make_airspace,
)
from bulletuav.bridges.starts import make_start_positions
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.earth import (
    Origin,
    attitude_to_ned,
    enu_to_ned,
    flu_to_frd,
    geopotential_height,
    magnetic_field,
    pressure,
    temperature,
)
from bulletuav.errors import as_sequence, finite
from bulletuav.geometry.rotation import to_body
from bulletuav.vehicle.airframe import STANDARD_GRAVITY
from bulletuav.vehicle.airframes import load_airframe

STEP_HZ = 250
"""Steps, and measurements of the inertial unit, a second"""
SLOW_STEPS, GPS_STEPS = 5, 25
"""Steps between measurements of compass and barometer, and of the satellite receiver"""
INERTIAL_FIELDS, SLOW_FIELDS = 0b111111, 0b1111111 << 6
"""Fields of HIL_SENSOR: accelerometer and gyroscope; compass, pressures, temperature"""
ARMED = 128
"""Bit of the mode of HIL_ACTUATOR_CONTROLS"""
GAUSS, KELVIN = 1e-4, 273.15
"""Teslas in a gauss; the zero of degrees Celsius"""


class Noise(NamedTuple):
    """Standard deviations of what sensors measure.

    Attributes:
        acceleration: m/s^2.
        rate: rad/s.
        field: gauss.
        pressure: hPa.
    """

    acceleration: float = 0.02
    rate: float = 0.002
    field: float = 0.001
    pressure: float = 0.005


class HilBodies:
    """N bodies in one airspace, whose motors autopilots command; they look north at the start.

    Attributes:
        airspace: Where they fly.
        origin: Place on the Earth of the airspace's origin.
        tick: Times that sensors have measured: the autopilots' clock, in units of 4 ms.
    """

    def __init__(
        self,
        drones: int | Sequence[Sequence[float]] = 1,
        airframe: Any = "iris",
        *,
        home: Sequence[float] = HOME,
        noise: float = 1.0,
        seed: int = 0,
        **options: Any,
    ) -> None:
        """Put bodies on the ground, motors off.

        Args:
            drones: How many there are, in rows 2 m apart; or where they stand, (N, 2), m.
            airframe: Their airframe, of four rotors.
            home: Latitude, longitude (degrees) and altitude (m) of the origin.
            noise: How many times the usual noise sensors have.
            seed: Of the noise, and of gusts.
            **options: More options of `Airspace`, such as wind or obstacles.

        Raises:
            ValueError: An option cannot be.
        """
        airframe_data = load_airframe(airframe)
        self._airframe = airframe_data
        # Autopilots number the motors by their corners
        compute_corner_speeds(
            airframe_data, dict.fromkeys(((1, 1), (1, -1), (-1, 1), (-1, -1)), 0.0)
        )
        self._noise = np.repeat(Noise(), (3, 3, 3, 1)) * finite("noise", noise, 0.0, 100.0)
        self._starts = make_start_positions(drones, airframe_data.standing_height, SPACING)
        if "decision_hz" in options:
            raise ValueError(f"decision_hz is {STEP_HZ} for autopilots: leave it out")
        self.origin = Origin(*as_sequence("home", home, 3))
        # The field of the Earth at home, in gauss as MAVLink wants it
        self._field = magnetic_field(*as_sequence("home", home, 3)) / GAUSS
        known = {"physics_hz": 2 * STEP_HZ, "decision_hz": STEP_HZ, "seed": seed, **options}
        self.airspace = make_airspace(self._starts, airframe_data, (SetpointLevel.ROTOR,), **known)
        self.tick = 0
        self._rng = np.random.default_rng(seed)
        self._commands: list[AirspaceCommand | None] = [None] * len(self._starts)
        self._reset_bodies()

    def __len__(self) -> int:
        """Tell how many bodies there are."""
        return len(self._starts)

    def warm_up(self) -> None:
        """Compile what flies, which takes a minute the first time; bodies stay where they are."""
        self.airspace.warm_up()
        self._reset_bodies()

    def _reset_bodies(self) -> None:
        """Put all bodies to where they start, at rest."""
        self.airspace.place(None, self._starts, NORTH)
        self._velocity = self.airspace.swarm.velocity.copy()
        self._acceleration = np.zeros_like(self._velocity)

    @property
    def stamp(self) -> int:
        """Time that autopilots are told, us."""
        return self.tick * (10**6 // STEP_HZ)

    def measure(self) -> list[list[Told]]:
        """Measure; the autopilots' clock goes on.

        Returns:
            Messages for each autopilot.
        """
        self.tick += 1
        noise = self._rng.standard_normal((len(self), 10)) * self._noise
        return [self._make_sensor_messages(i, noise[i]) for i in range(len(self))]

    def _make_sensor_messages(self, i: int, noise: np.ndarray) -> list[Told]:
        """Make the messages of one body."""
        swarm = self.airspace.swarm
        x, y, z = self._acceleration[i].tolist()
        attitude = swarm.quaternion[i]
        # In forward, right, down; an accelerometer at rest feels gravity as a push up
        force = flu_to_frd(to_body(attitude, (x, y, z + STANDARD_GRAVITY))) + noise[:3]
        rates = flu_to_frd(swarm.rates[i]) + noise[3:6]
        field = flu_to_frd(to_body(attitude, self._field)) + noise[6:9]
        # Pressure in hPa, its altitude, and the temperature there
        height = float(self.origin.altitude + swarm.position[i, 2])
        pressures = (float(pressure(height)) / 100 + float(noise[9]), 0.0)
        altitude_temperature = (
            float(geopotential_height(height)),
            float(temperature(height)) - KELVIN,
        )
        # Bits of what is new: slow sensors measure in some steps only
        updated = INERTIAL_FIELDS | (SLOW_FIELDS if self.tick % SLOW_STEPS == 0 else 0)
        values = (
            *force.tolist(),
            *rates.tolist(),
            *field.tolist(),
            *pressures,
            *altitude_temperature,
        )
        messages = [Told("hil_sensor", (self.stamp, *values, updated))]
        if self.tick % GPS_STEPS == 0:
            messages.append(self._make_gps_message(i))
        return messages

    def _make_gps_message(self, i: int) -> Told:
        """Tell what a satellite receiver measures, without noise: cm, cm/s and 1e-7 degrees."""
        swarm = self.airspace.swarm
        latitude, longitude, altitude = self.origin.to_geodetic(swarm.position[i]).tolist()
        north, east, down = np.round(enu_to_ned(swarm.velocity[i]) * 100).astype(int).tolist()
        ground_speed = math.hypot(north, east)
        course = round(math.degrees(math.atan2(east, north)) * 100) % 36000
        position = (round(latitude * 1e7), round(longitude * 1e7), round(altitude * 1000), 30, 40)
        return Told(
            "hil_gps",
            (self.stamp, 3, *position, round(ground_speed), north, east, down, course, 12),
        )

    def truth(self, i: int) -> Told:
        """Tell how a body truly moves: HIL_STATE_QUATERNION."""
        swarm = self.airspace.swarm
        latitude, longitude, altitude = self.origin.to_geodetic(swarm.position[i]).tolist()
        velocity = np.round(enu_to_ned(swarm.velocity[i]) * 100).astype(int).tolist()
        attitude = attitude_to_ned(swarm.quaternion[i], scalar_first=True).tolist()
        speed = round(float(np.sqrt((swarm.velocity[i] ** 2).sum())) * 100)
        x, y, z = self._acceleration[i].tolist()
        force = flu_to_frd(to_body(swarm.quaternion[i], (x, y, z + STANDARD_GRAVITY)))
        milli_g = np.clip(np.round(force / STANDARD_GRAVITY * 1000), -32768, 32767).astype(int)
        position = (round(latitude * 1e7), round(longitude * 1e7), round(altitude * 1000))
        rates = flu_to_frd(swarm.rates[i]).tolist()
        remaining = (*position, *velocity, speed, speed, *milli_g.tolist())
        return Told("hil_state_quaternion", (self.stamp, attitude, *rates, *remaining))

    def command(self, i: int, message: Message) -> None:
        """Take HIL_ACTUATOR_CONTROLS: shares of the greatest rotor speed.

        Args:
            i: Index of the body.
            message: Motors in PX4's order: front right, rear left, front left, rear right.
        """
        if not message.mode & ARMED:
            self._commands[i] = None
            return
        fractions = [
            min(max(control, 0.0), 1.0) if math.isfinite(control) else 0.0
            for control in message.controls[:4]
        ]
        corners = dict(zip(((1, -1), (-1, 1), (1, 1), (-1, -1)), fractions, strict=True))
        self._commands[i] = AirspaceCommand(
            SetpointLevel.ROTOR, compute_corner_speeds(self._airframe, corners)
        )

    def stop(self, i: int) -> None:
        """Switch the motors of a body off."""
        self._commands[i] = None

    def step(self) -> None:
        """Fly for 4 ms.

        Raises:
            RuntimeError: The flight diverged, or the airspace is closed.
        """
        apply_commands(self.airspace, self._commands)
        self.airspace.step()
        swarm = self.airspace.swarm
        self._acceleration = (swarm.velocity - self._velocity) / self.airspace.period
        self._velocity = swarm.velocity.copy()

    def close(self) -> None:
        """Free the airspace."""
        self.airspace.close()
