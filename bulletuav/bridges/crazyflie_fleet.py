"""Fleet of virtual Crazyflies in one airspace, without sockets: CRTP packets in, packets out."""

import functools
from collections.abc import Sequence
from typing import Any

from bulletuav.bridges.crazyflie_services import TICK_MS
from bulletuav.bridges.crazyflie_toc import LOGS
from bulletuav.bridges.crazyflie_vehicle import CrazyflieVehicle
from bulletuav.bridges.crtp import Packet
from bulletuav.bridges.setpoints import (
    apply_commands,
    euler,
    get_states,
    make_airspace,
    require_hovering,
)
from bulletuav.bridges.starts import make_start_positions
from bulletuav.compiled.functions import cos, sin
from bulletuav.earth import pressure
from bulletuav.errors import former_names
from bulletuav.vehicle.airframes import load_airframe

DECISION_HZ = 1000 // TICK_MS
"""Flight commands per second; the period equals the firmware's log tick"""
PHYSICS_HZ = 500
"""Physics steps per second, and steps of the attitude and rate controllers"""
SPACING = 0.5
"""Distance between neighbours at the start, m"""


class CrazyflieFleet:
    """N virtual Crazyflies that fly, and collide, in one airspace.

        fleet = CrazyflieFleet(2)
        fleet.take(0, packet)
        packets = fleet.step()

    Attributes:
        airspace: Airspace in which they fly.
        vehicles: Firmware of each drone.
        tick: Number of steps, of 10 ms each.
    """

    def __init__(
        self, drones: int | Sequence[Sequence[float]] = 1, airframe: Any = "cf2x", **options: Any
    ) -> None:
        """Place the drones on the ground, and switch them on.

        Args:
            drones: Number of drones, in rows 0.5 m apart; or their positions, (N, 2), m.
            airframe: Airframe of all drones.
            **options: Further options of `Airspace`, such as wind or obstacles.

        Raises:
            ValueError: If an option is invalid.
        """
        frame = load_airframe(airframe)
        require_hovering(frame, "Crazyflies")
        places = make_start_positions(drones, frame.standing_height, SPACING)
        if "decision_hz" in options:
            raise ValueError(f"decision_hz is {DECISION_HZ}, as in the firmware: omit the option")
        settings = {"physics_hz": PHYSICS_HZ, "decision_hz": DECISION_HZ, **options}
        self.airspace = make_airspace(places, frame, **settings)
        self.vehicles = [
            CrazyflieVehicle(frame, functools.partial(self._set_upright, i))
            for i in range(len(places))
        ]
        self.tick, self._starts = 0, places
        self._velocity = self.airspace.swarm.velocity.copy()
        self._update_vehicles()

    def __len__(self) -> int:
        """Return the number of drones."""
        return len(self.vehicles)

    @property
    def time(self) -> float:
        """Time since the start, s."""
        return self.tick * TICK_MS / 1000

    def take(self, drone: int, packet: Packet) -> list[Packet]:
        """Pass a packet to a drone, and return the drone's answers."""
        return self.vehicles[drone].answer(packet, self.tick)

    def step(self) -> list[tuple[int, Packet]]:
        """Fly for one step of 10 ms.

        Returns:
            Log packets, each with the index of its drone.

        Raises:
            RuntimeError: If the flight diverged, or the airspace is closed.
        """
        apply_commands(
            self.airspace, [vehicle.order(self.airspace.period) for vehicle in self.vehicles]
        )
        self.airspace.step()
        self.tick += 1
        self._update_vehicles()
        return [
            (i, packet)
            for i, vehicle in enumerate(self.vehicles)
            for packet in self._due_log_packets(vehicle)
        ]

    def warm_up(self) -> None:
        """Compile the simulation, which takes a minute the first time; the drones do not move."""
        self.airspace.warm_up()
        for variable in LOGS.values():
            variable.read(self.vehicles[0].telemetry(_pressure))
        self.airspace.place(None, self._starts)

    def _update_vehicles(self) -> None:
        """Pass the state of each body to its vehicle."""
        swarm = self.airspace.swarm
        change = (swarm.velocity - self._velocity) / self.airspace.period
        self._velocity = swarm.velocity.copy()
        motion = zip(change.tolist(), swarm.rotor_speed.tolist(), strict=True)
        rows = zip(self.vehicles, get_states(swarm), motion, strict=True)
        for vehicle, state, (acceleration, speed) in rows:
            vehicle.update_state(state, acceleration, speed, self.time)

    def _due_log_packets(self, vehicle: CrazyflieVehicle) -> list[Packet]:
        due = vehicle.logs.due(self.tick)
        if not due:
            return []
        telemetry = vehicle.telemetry(_pressure)
        return [
            vehicle.logs.encode_block(number, block, self.tick, telemetry) for number, block in due
        ]

    def _set_upright(self, i: int) -> bool:
        """Place a drone upright where it lies; return False if there is no space."""
        swarm = self.airspace.swarm
        yaw = euler(swarm.quaternion[i].tolist())[2]
        position = swarm.position[i].copy()
        position[2] += self.airspace.airframes[i].standing_height
        try:
            self.airspace.place(
                i, position, (0.0, 0.0, sin(yaw / 2), cos(yaw / 2)), rotor_speed=0.0
            )
        except ValueError:
            return False
        return True

    def close(self) -> None:
        """Close the airspace."""
        self.airspace.close()


def _pressure(height: float) -> float:
    """Return the air pressure at a height above the ground, which is at sea level, Pa."""
    return float(pressure(height))


__getattr__ = former_names(__name__, {"Fleet": "CrazyflieFleet"})
