"""Virtual Crazyflies in one airspace, without sockets: packets in, packets out, step by step."""

import functools
from collections.abc import Sequence
from typing import Any

from bulletuav.bridges.crazyflie_services import TICK
from bulletuav.bridges.crazyflie_tables import LOGS
from bulletuav.bridges.crazyflie_vehicle import Vehicle
from bulletuav.bridges.crtp import Packet
from bulletuav.bridges.setpoints import apply_commands, euler, get_states, make_airspace
from bulletuav.bridges.starts import make_start_positions
from bulletuav.compiled.functions import cos, sin
from bulletuav.earth import pressure
from bulletuav.vehicle.airframes import load_airframe

DECISION_HZ = 1000 // TICK
"""Steps a second: commands and logs have the firmware's unit of time"""
PHYSICS_HZ = 500
"""Steps of physics, and of the loops of attitude and rates, a second"""
SPACING = 0.5
"""Distance between neighbours at the start, m"""


class Fleet:
    """N virtual Crazyflies whose bodies fly, and collide, in one airspace.

        fleet = Fleet(2)
        fleet.take(0, packet)
        answers = fleet.step()

    Attributes:
        airspace: Where they fly.
        vehicles: One for each drone.
        tick: Steps flown, of 10 ms each.
    """

    def __init__(
        self,
        drones: int | Sequence[Sequence[float]] = 1,
        airframe: Any = "cf2x",
        **options: Any,
    ) -> None:
        """Put drones on the ground, and switch them on.

        Args:
            drones: How many there are, in rows 0.5 m apart; or where they stand, (N, 2), m.
            airframe: Their airframe.
            **options: More options of `Airspace`, such as wind or obstacles.

        Raises:
            ValueError: An option cannot be.
        """
        frame = load_airframe(airframe)
        places = make_start_positions(drones, frame.standing_height, SPACING)
        if "decision_hz" in options:
            raise ValueError(f"decision_hz is {DECISION_HZ} in the firmware: leave it out")
        known = {"physics_hz": PHYSICS_HZ, "decision_hz": DECISION_HZ, **options}
        self.airspace = make_airspace(places, frame, **known)
        self.vehicles = [
            Vehicle(frame, functools.partial(self._stand_up, i)) for i in range(len(places))
        ]
        self.tick, self._starts = 0, places
        self._velocity = self.airspace.swarm.velocity.copy()
        self._sense()

    def __len__(self) -> int:
        """Tell how many drones there are."""
        return len(self.vehicles)

    @property
    def time(self) -> float:
        """Time since the start, s."""
        return self.tick * TICK / 1000

    def take(self, drone: int, packet: Packet) -> list[Packet]:
        """Give a packet to a drone; its answers are returned."""
        return self.vehicles[drone].answer(packet, self.tick)

    def step(self) -> list[tuple[int, Packet]]:
        """Fly for 10 ms.

        Returns:
            Packets that drones send by themselves, each with the index of its drone.

        Raises:
            RuntimeError: The flight diverged, or the airspace is closed.
        """
        apply_commands(self.airspace, [one.order(self.airspace.period) for one in self.vehicles])
        self.airspace.step()
        self.tick += 1
        self._sense()
        return [
            (i, packet)
            for i, vehicle in enumerate(self.vehicles)
            for packet in self._logged(vehicle)
        ]

    def warm_up(self) -> None:
        """Compile what flies, which takes a minute the first time; drones stay where they are."""
        self.airspace.warm_up()
        for variable in LOGS.values():
            variable.read(self.vehicles[0].telemetry(_pressure))
        self.airspace.place(None, self._starts)

    def _sense(self) -> None:
        """Tell the drones how their bodies move."""
        swarm = self.airspace.swarm
        change = (swarm.velocity - self._velocity) / self.airspace.period
        self._velocity = swarm.velocity.copy()
        rest = zip(change.tolist(), swarm.rotor_speed.tolist(), strict=True)
        told = zip(self.vehicles, get_states(swarm), rest, strict=True)
        for vehicle, state, (acceleration, speed) in told:
            vehicle.sense(state, acceleration, speed, self.time)

    def _logged(self, vehicle: Vehicle) -> list[Packet]:
        """Write the log blocks that are due."""
        due = vehicle.logs.due(self.tick)
        if not due:
            return []
        told = vehicle.telemetry(_pressure)
        return [vehicle.logs.write(number, block, self.tick, told) for number, block in due]

    def _stand_up(self, i: int) -> bool:
        """Put a drone on its feet where it lies, if there is room."""
        swarm = self.airspace.swarm
        yaw = euler(swarm.quaternion[i].tolist())[2]
        place = swarm.position[i].copy()
        place[2] += self.airspace.airframes[i].standing_height
        try:
            self.airspace.place(i, place, (0.0, 0.0, sin(yaw / 2), cos(yaw / 2)), rotor_speed=0.0)
        except ValueError:
            return False
        return True

    def close(self) -> None:
        """Free the airspace."""
        self.airspace.close()


def _pressure(height: float) -> float:
    """Tell the pressure of the air at a height above the ground, which is at sea level, Pa."""
    return float(pressure(height))
