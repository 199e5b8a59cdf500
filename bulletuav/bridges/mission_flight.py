"""Flight of a mission from a file, by a MAVLink vehicle without clients."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple, Self

from bulletuav.bridges.mavlink_fleet import MavlinkFleet
from bulletuav.bridges.mavlink_items import (
    LOITER_UNLIMITED,
    POSITION_COMMANDS,
    compute_item_position,
    read_item_radius,
)
from bulletuav.bridges.mavlink_missions import FENCE, MISSION
from bulletuav.bridges.mavlink_protocol import Mode, RefusedError
from bulletuav.bridges.mission_files import NO_CHANGE, Mission
from bulletuav.envs.airspace import Airspace
from bulletuav.errors import finite

MAX_DURATION = 3600.0
"""Default maximum duration of a flight, s"""
HOLD_DISTANCE = 0.5
"""Distance from the position of an unlimited loiter at which the flight is over, m"""
HOLD_RADII = 1.1
"""That distance on wings, in radii of the loiter"""


class ReachedItem(NamedTuple):
    """Item that was reached.

    Attributes:
        number: Index of the item.
        time: Time, s.
        distance: Distance of the vehicle from the position of the item, m; NaN without a position.
    """

    number: int
    time: float
    distance: float


class MissionFlight:
    """A vehicle that flies a mission in an airspace, step by step.

        with MissionFlight(read_mission("survey.plan"), wind=(3.0, 0.0, 0.0)) as flight:
            while flight.outcome is None:
                flight.step()
                print(flight.airspace.swarm.position[0])

    Modes, motions and the reaction to the geofence are those of `bulletuav serve mavlink`.

    Attributes:
        mission: The mission.
        fleet: The vehicle and its parameters, `fleet.services[0].vehicle`.
        reached: Reached items, in order.
        texts: Times (s) and texts of the vehicle, such as breaches of the geofence.
        outcome: How the flight ended; None while it goes on.
    """

    def __init__(
        self,
        mission: Mission,
        airframe: Any = "iris",
        *,
        speed: float | None = None,
        max_duration: float = MAX_DURATION,
        **options: Any,
    ) -> None:
        """Place the vehicle at home, arm it and start the mission.

        Args:
            mission: Result of `read_mission`.
            airframe: Name, path of a URDF, or `Airframe`.
            speed: Speed of the legs, m/s, until the mission changes it; by default that of the
                file, or 5 m/s. On wings an airspeed, by default the cruise speed.
            max_duration: Time after which the flight ends, s.
            **options: Further options of `Airspace`, such as wind or layout.

        Raises:
            ValueError: If an option is invalid, or an item is outside the geofence.
        """
        self.mission = mission
        self._max_duration = finite("max_duration", max_duration, 0.0)
        chosen = mission.speed if speed is None else finite("speed", speed, 0.1, 100.0)
        self.fleet = MavlinkFleet(1, airframe, home=mission.home, **options)
        self._vehicle = self.fleet.services[0].vehicle
        self._pilot = self._vehicle.pilot
        self.reached: list[ReachedItem] = []
        self.texts: list[tuple[float, str]] = []
        self.outcome: str | None = None
        # The file itself says where the first item is
        self._vehicle.parameters.values["MIS_DIST_1WP"] = 0.0
        if chosen is not None:
            self._vehicle.parameters.values["MPC_XY_CRUISE"] = chosen
        if speed is not None and self._vehicle.wings is not None:
            self._vehicle.wings.chosen_speed = chosen
        try:
            self._vehicle.missions.replace(FENCE, mission.fence)
            self._vehicle.missions.replace(MISSION, mission.items)
            self._pilot.arm()
            self._pilot.enter_mode(Mode.MISSION)
        except RefusedError as error:
            self.close()
            raise ValueError(f"{mission.path}: {error}; change the mission or its fence") from None

    @property
    def airspace(self) -> Airspace:
        """The airspace, whose drone 0 is the vehicle."""
        return self.fleet.airspace

    @property
    def rotor_speeds(self) -> tuple[float, ...]:
        """Speeds (R,) of the rotors, rad/s."""
        return tuple(self.airspace.swarm.rotor_speed[0].tolist())

    def step(self) -> None:
        """Fly for one step of 10 ms, unless the flight is over.

        Raises:
            RuntimeError: If the flight diverged, or the airspace is closed.
        """
        if self.outcome is not None:
            return
        for message in self.fleet.step()[0]:
            if message.name == "statustext":
                self.texts.append((self.fleet.time, message.fields[1].decode()))
            elif message.name == "mission_item_reached":
                self._add_reached(message.fields[0])
        self.outcome = self._find_outcome()

    def fly(self, on_step: Callable[[], object] = lambda: None) -> str:
        """Fly to the end.

        Args:
            on_step: Function that is called after each step.

        Returns:
            The outcome.
        """
        while self.outcome is None:
            self.step()
            on_step()
        return self.outcome

    def _add_reached(self, number: int) -> None:
        item = self.mission.items[number]
        if item is NO_CHANGE:
            return
        distance = math.nan
        if item.command in POSITION_COMMANDS:
            place = self._pilot.state[0]
            goal = compute_item_position(item, self._vehicle.site, place)
            distance = math.dist(goal, place)
        self.reached.append(ReachedItem(number, self.fleet.time, distance))

    def _find_outcome(self) -> str | None:
        """Return how the flight ended, or None if it goes on."""
        pilot, route, last = self._pilot, self._pilot.route, self.texts[-1:]
        if not pilot.is_armed:
            return last[0][1] if last else "disarmed"
        if pilot.mode == Mode.HOLD:
            if route.is_over:
                return "mission complete: holds at its last item"
            return f"mission stopped: {last[0][1]}" if last else "mission stopped"
        if not route.is_over and route.items[route.current].command == LOITER_UNLIMITED:
            place = pilot.state[0]
            goal = compute_item_position(route.items[route.current], self._vehicle.site, place)
            # Wings circle the position
            wings, item = self._vehicle.wings, route.items[route.current]
            radius = 0.0 if wings is None else abs(read_item_radius(item)) or wings.radius
            if math.dist(goal, place) < HOLD_DISTANCE + HOLD_RADII * radius:
                return f"mission complete: loiters at item {route.current}"
        if self.fleet.time >= self._max_duration:
            return f"flight ended after {self._max_duration:g} s, at item {route.current}"
        return None

    def __enter__(self) -> Self:
        """Return the flight, whose airspace is closed at the end of the `with` statement."""
        return self

    def __exit__(self, *error: object) -> None:
        """Close the airspace."""
        self.close()

    def close(self) -> None:
        """Close the airspace."""
        self.fleet.close()
