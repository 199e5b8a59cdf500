"""Simulated vehicles for autopilots in lockstep: sensor messages out, motor commands in."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from bulletuav.bridges.mavlink_fleet import HOME, SPACING
from bulletuav.bridges.mavlink_protocol import Message, OutgoingMessage
from bulletuav.bridges.mavlink_sensors import compute_field, measure
from bulletuav.bridges.setpoints import (
    NORTH,
    PX4_CORNERS,
    AirspaceCommand,
    apply_commands,
    compute_corner_speeds,
    find_corners,
    make_airspace,
)
from bulletuav.bridges.starts import make_start_positions
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.earth import (
    Origin,
    attitude_to_ned,
    enu_to_ned,
    flu_to_frd,
)
from bulletuav.errors import as_sequence, finite
from bulletuav.geometry.rotation import to_body
from bulletuav.vehicle.airframe import STANDARD_GRAVITY
from bulletuav.vehicle.airframes import load_airframe

STEP_HZ = 250
"""Rate of simulation steps and of inertial measurements, Hz"""
SLOW_STEPS, GPS_STEPS = 5, 25
"""Steps between measurements of the magnetometer and barometer, and of the GPS receiver"""
INERTIAL_FIELDS, SLOW_FIELDS = 0b111111, 0b1111111 << 6
"""Bits of `HIL_SENSOR.fields_updated`: accelerometer and gyroscope; magnetometer, pressures and
temperature"""
ARMED = 128
"""Bit of `HIL_ACTUATOR_CONTROLS.mode` that is set while the autopilot is armed"""


class Noise(NamedTuple):
    """Standard deviations of the sensor noise.

    Attributes:
        acceleration: Accelerometer, m/s^2.
        rate: Gyroscope, rad/s.
        field: Magnetometer, gauss.
        pressure: Barometer, hPa.
    """

    acceleration: float = 0.02
    rate: float = 0.002
    field: float = 0.001
    pressure: float = 0.005


class HilBodies:
    """N vehicles in one airspace, whose motors are commanded by autopilots.

    The vehicles face north at the start.

    Attributes:
        airspace: Airspace of the vehicles.
        origin: Geodetic position of the origin of the airspace.
        tick: Number of sensor measurements: the clock of the autopilots, in units of 4 ms.
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
        """Place the vehicles on the ground with stopped motors.

        Args:
            drones: Number of vehicles, on a grid with a spacing of 2 m; or their positions, (N, 2),
                m.
            airframe: Airframe of the vehicles, with four rotors.
            home: Latitude, longitude (degrees) and altitude (m) of the origin.
            noise: Scale of the sensor noise; 1 is the default noise, 0 is none.
            seed: Seed of the sensor noise and of the gusts.
            **options: Other options of `Airspace`, such as wind or obstacles.

        Raises:
            ValueError: If an option is invalid.
        """
        airframe_data = load_airframe(airframe)
        self._airframe = airframe_data
        # Autopilots number the motors by corners: fail here if the airframe is not a quadrotor
        find_corners(airframe_data)
        self._noise = np.repeat(Noise(), (3, 3, 3, 1)) * finite("noise", noise, 0.0, 100.0)
        self._starts = make_start_positions(drones, airframe_data.standing_height, SPACING)
        if "decision_hz" in options:
            raise ValueError(f"decision_hz is fixed at {STEP_HZ} for autopilots: leave it out")
        self.origin = Origin(*as_sequence("home", home, 3))
        # Magnetic field at home, in gauss as MAVLink defines it
        self._field = compute_field(tuple(as_sequence("home", home, 3)))
        airspace_options = {
            "physics_hz": 2 * STEP_HZ,
            "decision_hz": STEP_HZ,
            "seed": seed,
            **options,
        }
        self.airspace = make_airspace(
            self._starts, airframe_data, (SetpointLevel.ROTOR,), **airspace_options
        )
        self.tick = 0
        self._rng = np.random.default_rng(seed)
        self._commands: list[AirspaceCommand | None] = [None] * len(self._starts)
        self._reset_bodies()

    def __len__(self) -> int:
        """Return the number of vehicles."""
        return len(self._starts)

    def warm_up(self) -> None:
        """Compile the simulation, which takes a minute the first time; the vehicles do not move."""
        self.airspace.warm_up()
        self._reset_bodies()

    def _reset_bodies(self) -> None:
        """Place all vehicles at rest at their start positions."""
        self.airspace.place(None, self._starts, NORTH)
        self._velocity = self.airspace.swarm.velocity.copy()
        self._acceleration = np.zeros_like(self._velocity)

    @property
    def stamp(self) -> int:
        """Timestamp of the last measurement, microseconds."""
        return self.tick * (10**6 // STEP_HZ)

    def measure(self) -> list[list[OutgoingMessage]]:
        """Measure with all sensors, and advance the clock of the autopilots.

        Returns:
            MAVLink messages for each autopilot.
        """
        self.tick += 1
        swarm = self.airspace.swarm
        height = self.origin.altitude + swarm.position[:, 2]
        values = measure(swarm.quaternion, swarm.rates, self._acceleration, self._field, height)
        values[:, :10] += self._rng.standard_normal((len(self), 10)) * self._noise
        return [self._make_sensor_messages(i, row) for i, row in enumerate(values.tolist())]

    def _make_sensor_messages(self, i: int, values: list[float]) -> list[OutgoingMessage]:
        """Return the sensor messages of vehicle `i`: HIL_SENSOR, and HIL_GPS when it is due."""
        # Only updated fields are flagged; slow sensors measure in some of the steps
        updated = INERTIAL_FIELDS | (SLOW_FIELDS if self.tick % SLOW_STEPS == 0 else 0)
        messages = [OutgoingMessage("hil_sensor", (self.stamp, *values, updated))]
        if self.tick % GPS_STEPS == 0:
            messages.append(self._make_gps_message(i))
        return messages

    def _make_gps_message(self, i: int) -> OutgoingMessage:
        """Return the HIL_GPS message of vehicle `i`, without noise: cm, cm/s and 1e-7 degrees."""
        swarm = self.airspace.swarm
        latitude, longitude, altitude = self.origin.to_geodetic(swarm.position[i]).tolist()
        north, east, down = np.round(enu_to_ned(swarm.velocity[i]) * 100).astype(int).tolist()
        ground_speed = math.hypot(north, east)
        course = round(math.degrees(math.atan2(east, north)) * 100) % 36000
        position = (round(latitude * 1e7), round(longitude * 1e7), round(altitude * 1000), 30, 40)
        return OutgoingMessage(
            "hil_gps",
            (self.stamp, 3, *position, round(ground_speed), north, east, down, course, 12),
        )

    def truth(self, i: int) -> OutgoingMessage:
        """Return the true state of vehicle `i` as HIL_STATE_QUATERNION."""
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
        return OutgoingMessage("hil_state_quaternion", (self.stamp, attitude, *rates, *remaining))

    def command(self, i: int, message: Message) -> None:
        """Set the motor commands of a vehicle from a HIL_ACTUATOR_CONTROLS message.

        Args:
            i: Index of the vehicle.
            message: Fractions of the maximum rotor speed in PX4's motor order: front right, rear
                left, front left, rear right. Motors stop if the autopilot is disarmed.
        """
        if not message.mode & ARMED:
            self._commands[i] = None
            return
        fractions = [
            min(max(control, 0.0), 1.0) if math.isfinite(control) else 0.0
            for control in message.controls[:4]
        ]
        corners = dict(zip(PX4_CORNERS, fractions, strict=True))
        self._commands[i] = AirspaceCommand(
            SetpointLevel.ROTOR, compute_corner_speeds(self._airframe, corners)
        )

    def stop(self, i: int) -> None:
        """Stop the motors of vehicle `i`."""
        self._commands[i] = None

    def step(self) -> None:
        """Step the simulation by 4 ms.

        Raises:
            RuntimeError: If the simulation diverged, or the airspace is closed.
        """
        apply_commands(self.airspace, self._commands)
        self.airspace.step()
        swarm = self.airspace.swarm
        self._acceleration = (swarm.velocity - self._velocity) / self.airspace.period
        self._velocity = swarm.velocity.copy()

    def close(self) -> None:
        """Close the airspace."""
        self.airspace.close()
