"""MAVLink vehicles in one airspace, without sockets: messages in, messages out, step by step."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from bulletuav.bridges.mavlink_places import Site
from bulletuav.bridges.mavlink_services import Services
from bulletuav.bridges.mavlink_telemetry import STEP_HZ
from bulletuav.bridges.mavlink_vehicle import Vehicle
from bulletuav.bridges.mavlink_wire import Message, Sender, Told
from bulletuav.bridges.setpoints import NORTH, apply_commands, get_states, make_airspace
from bulletuav.bridges.starts import make_start_positions
from bulletuav.earth import Origin, attitude_to_ned
from bulletuav.errors import as_int, as_sequence
from bulletuav.vehicle.airframes import load_airframe

PHYSICS_HZ = 500
"""Steps of physics, and of the loops of attitude and rates, a second"""
HOME = (47.397742, 8.545594, 488.0)
"""Where PX4's simulated vehicles are: latitude, longitude (degrees), altitude (m)"""
SPACING = 2.0
"""Distance between neighbours at the start, m"""
MOST_VEHICLES = 250
"""Numbers above it are those of ground stations"""
UPWARD = 0.7
"""Upward part of the normal from which on a drone stands on what it touches"""


class MavlinkFleet:
    """N vehicles whose bodies fly, and collide, in one airspace; they look north at the start.

        fleet = MavlinkFleet(2)
        answers = fleet.take(0, message, sender)
        told = fleet.step()

    Attributes:
        airspace: Where they fly.
        services: One for each vehicle.
        origin: Place on the Earth of the airspace's origin.
        tick: Steps flown, of 10 ms each.
    """

    def __init__(
        self,
        drones: int | Sequence[Sequence[float]] = 1,
        airframe: Any = "iris",
        *,
        home: Sequence[float] = HOME,
        **options: Any,
    ) -> None:
        """Put vehicles on the ground, and switch them on.

        Args:
            drones: How many there are, in rows 2 m apart; or where they stand, (N, 2), m.
            airframe: Their airframe.
            home: Latitude, longitude (degrees) and altitude (m) of the origin.
            **options: More options of `Airspace`, such as wind or obstacles.

        Raises:
            ValueError: An option cannot be.
        """
        frame = load_airframe(airframe)
        places = make_start_positions(drones, frame.standing_height, SPACING)
        as_int("number of drones", len(places), 1, MOST_VEHICLES)
        if "decision_hz" in options:
            raise ValueError(f"decision_hz is {STEP_HZ} for clients of MAVLink: leave it out")
        self.origin = Origin(*as_sequence("home", home, 3))
        known = {"physics_hz": PHYSICS_HZ, "decision_hz": STEP_HZ, **options}
        self.airspace = make_airspace(places, frame, **known)
        self.services = [
            Services(Vehicle(k + 1, frame, Site.at(self.origin, place), partial(self._locate, k)))
            for k, place in enumerate(places)
        ]
        self.tick, self._starts = 0, places
        self.airspace.place(None, places, NORTH)
        self._sense()

    def __len__(self) -> int:
        """Tell how many vehicles there are."""
        return len(self.services)

    @property
    def time(self) -> float:
        """Time since the start, s."""
        return self.tick / STEP_HZ

    def take(
        self,
        drone: int,
        message: Message,
        sender: Sender,
    ) -> list[Told]:
        """Give a message to a vehicle; its answers are returned."""
        return self.services[drone].answer(message, sender)

    def step(self) -> list[list[Told]]:
        """Fly for 10 ms.

        Returns:
            What each vehicle tells all its clients.

        Raises:
            RuntimeError: The flight diverged, or the airspace is closed.
        """
        period = self.airspace.period
        apply_commands(self.airspace, [one.vehicle.pilot.order(period) for one in self.services])
        self.airspace.step()
        self.tick += 1
        self._sense()
        return [one.due(self.tick) for one in self.services]

    def warm_up(self) -> None:
        """Compile what flies, which takes a minute the first time; drones stay where they are."""
        self.airspace.warm_up()
        self.airspace.place(None, self._starts, NORTH)

    def _sense(self) -> None:
        """Tell the vehicles how their bodies move."""
        swarm, contacts = self.airspace.swarm, self.airspace.contacts
        touching = set(contacts.drone[contacts.normal[:, 2] > UPWARD].tolist())
        self._located: list[list[float]] | None = None
        for i, (one, state) in enumerate(zip(self.services, get_states(swarm), strict=True)):
            one.vehicle.pilot.sense(state, self.time, i in touching or self.tick == 0)

    def _locate(self, i: int) -> list[float]:
        """Tell where a vehicle is, see `Vehicle.locate`; all are worked out at once."""
        if self._located is None:
            swarm = self.airspace.swarm
            turns = attitude_to_ned(swarm.quaternion, scalar_first=True)
            places = self.origin.to_geodetic(swarm.position)
            self._located = np.concatenate([places, turns], axis=1).tolist()
        return self._located[i]

    def close(self) -> None:
        """Free the airspace."""
        self.airspace.close()
