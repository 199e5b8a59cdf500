"""Events of an episode: drones, wind or gravity that change at a scheduled or random time."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from bulletuav.errors import as_instance, as_int, as_sequence, finite, numbers_of, shown, unknown
from bulletuav.vehicle.wind import MAX_WIND

RANDOM = "random"
"""Drone of an event that is drawn in each episode"""
MAX_EVENTS = 1000
"""Maximum number of events of an episode"""
MAX_GRAVITY = 1e4
"""Maximum gravity, m/s^2"""
MAX_TIME = 1e6
"""Latest time of an event, s"""


@dataclass(frozen=True)
class Event:
    """A change during an episode, in force from the first decision at or after its time.

    For example, a drone of four loses half of a rotor after 2 to 5 s:

        Event(time=(2.0, 5.0), drone="random", rotor_effectiveness=(0.5, 1.0, 1.0, 1.0))

    The next episode starts without the change. Times and drones are drawn by the generator of each
    world after all other random numbers of a start.

    Attributes:
        time: Time since the start of the episode, s, or (low, high) of a uniform draw.
        drone: Index of a drone, None for all, or "random" for one that is drawn.
        rotor_effectiveness: (R,) fraction of the commanded thrust and torque that each rotor
            provides, from 0 (failed) to 1; see `bulletuav.envs.conditions`.
        added_mass: Mass in addition to the drone's own, at its centre of mass, kg.
        added_inertia: (3,) moments of inertia in addition to the drone's own, kg m^2.
        charge: Charge of the battery, from 0 to 1, such as 1 for another battery.
        wind: (3,) steady wind of the world (east, north, up), m/s, instead of the one before.
        gravity: Gravitational acceleration of the world, m/s^2, downwards. Controllers are not
            informed.
    """

    time: float | tuple[float, float]
    drone: int | str | None = None
    rotor_effectiveness: tuple[float, ...] | None = None
    added_mass: float | None = None
    added_inertia: tuple[float, ...] | None = None
    charge: float | None = None
    wind: tuple[float, ...] | None = None
    gravity: float | None = None

    def __post_init__(self) -> None:
        """Convert and check all values that do not depend on the drones."""
        low, high = self.time_bounds
        if not 0 <= low <= high <= MAX_TIME:
            raise ValueError(
                f"time of an event is {shown(self.time)}: seconds since the start, or (low, high), "
                f"from 0 to {MAX_TIME:g} are needed"
            )
        self._keep("time", low if low == high else (low, high))
        if self.drone is not None and self.drone != RANDOM:
            if isinstance(self.drone, str):
                raise unknown("drone of an event", self.drone, (RANDOM,))
            self._keep("drone", as_int("drone of an event", self.drone, 0))
        for name in ("rotor_effectiveness", "added_inertia", "wind"):
            value = getattr(self, name)
            if value is not None:
                array = numbers_of(f"{name} of an event is", value)
                if array.ndim != 1:
                    raise ValueError(f"{name} of an event is {shown(value)}: a list is needed")
                self._keep(name, tuple(array.tolist()))
        if self.added_mass is not None:
            self._keep("added_mass", finite("added_mass of an event", self.added_mass))
        if self.charge is not None:
            self._keep("charge", finite("charge of an event", self.charge, 0.0, 1.0))
        if self.gravity is not None:
            self._keep("gravity", finite("gravity of an event", self.gravity, 0.0, MAX_GRAVITY))
        if self.wind is not None and not (
            len(self.wind) == 3 and all(abs(one) <= MAX_WIND for one in self.wind)
        ):
            raise ValueError(
                f"wind of an event is {shown(self.wind)}: three numbers from {-MAX_WIND:g} to "
                f"{MAX_WIND:g} m/s are needed"
            )
        if not self.values():
            raise ValueError(
                f"the event at {shown(self.time)} s changes nothing: give one of "
                f"{', '.join(CHANGES)}"
            )
        if self.drone is not None and set(self.values()) <= {"wind", "gravity"}:
            raise ValueError(
                f"the {' and '.join(self.values())} of an event is that of all drones: leave out "
                f"drone"
            )

    def _keep(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)

    @property
    def time_bounds(self) -> tuple[float, float]:
        """Earliest and latest time, s."""
        if isinstance(self.time, list | tuple):
            low, high = as_sequence("time of an event", self.time, 2)
            return finite("time of an event", low), finite("time of an event", high)
        only = finite("time of an event", self.time)
        return only, only

    @property
    def is_random(self) -> bool:
        """Whether time or drone are drawn."""
        low, high = self.time_bounds
        return low < high or self.drone == RANDOM

    def values(self) -> dict[str, Any]:
        """Return the changes by name."""
        changes = {name: getattr(self, name) for name in CHANGES}
        return {name: value for name, value in changes.items() if value is not None}

    def described(self) -> dict[str, Any]:
        """Return the given attributes by name, as values that JSON can store."""
        drone = {} if self.drone is None else {"drone": self.drone}
        return {"time": self.time, **drone, **self.values()}


CHANGES = tuple(one.name for one in dataclasses.fields(Event) if one.name not in ("time", "drone"))
"""Names of the changes of an event"""


def as_events(given: Any) -> tuple[Event, ...]:
    """Check and convert the option `events`.

    Args:
        given: Events, or dicts of their attributes; one of them, or a list.

    Returns:
        The events.

    Raises:
        ValueError: If a value is no event, or an attribute is unknown or invalid.
    """
    listed = (given,) if isinstance(given, Event | Mapping) else given
    entries = as_sequence("events", listed, most=MAX_EVENTS)
    return tuple(as_instance("one of events", Event, one) for one in entries)
