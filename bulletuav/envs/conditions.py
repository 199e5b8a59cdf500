"""Conditions of drones in flight, and their schedule: rotors, added mass and inertia, gravity.

A rotor with effectiveness e turns at sqrt(e) times its commanded speed, so that thrust and reaction
torque, which grow with the square of the speed, are e times the commanded ones in the steady state.
It reaches that speed with the lag of the motor: a rotor that fails (e = 0) spins down. Controllers
are not informed: their model is the airframe's, whose rotors, mass and inertia are nominal, and the
gravity of the option.

References:
    M. W. Mueller, R. D'Andrea, Stability and control of a quadrocopter despite the complete loss of
    one, two, or three propellers, ICRA 2014.
    Y. Zhang, J. Jiang, Bibliographical review on reconfigurable fault-tolerant control systems,
    Annual Reviews in Control 2008 (loss of effectiveness as a factor of the actuator).
"""

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics.base import Dynamics
from bulletuav.envs.energy import Energy
from bulletuav.envs.events import CHANGES, MAX_EVENTS, MAX_GRAVITY, MAX_TIME, RANDOM, Event
from bulletuav.envs.parts import WITHOUT_WIND, Parts
from bulletuav.envs.snapshot import Bounds
from bulletuav.errors import finite, numbers_of, shown, unknown

MAX_ADDED = 1e6
"""Largest added mass, kg, and inertia, kg m^2, before the bounds of a drone are applied"""
ROTOR_DYNAMICS = "use dynamics 'rigid_body' or 'bullet'"
OTHER_DYNAMICS = {
    "added_mass": ", or 'point_mass'",
    "gravity": ", or 'point_mass' or 'double_integrator'",
}
"""Further dynamics that do not ignore a condition"""


class Condition(NamedTuple):
    """Conditions of drones; None for those that stay as they are.

    Attributes:
        rotor_effectiveness: (R,) of each rotor, from 0 (failed) to 1, or a row for each drone.
        added_mass: Mass in addition to the drone's own, at its centre of mass, kg.
        added_inertia: (3,) moments of inertia in addition to the drone's own, kg m^2.
        gravity: Gravitational acceleration of the whole world, m/s^2, downwards.
    """

    rotor_effectiveness: Any = None
    added_mass: Any = None
    added_inertia: Any = None
    gravity: Any = None


def check_condition(
    given: Condition, dynamics: Dynamics, num_rotors: np.ndarray, count: tuple[int, ...]
) -> Condition:
    """Check and convert conditions of drones.

    Args:
        given: Values of arguments.
        dynamics: Dynamics of the drones.
        num_rotors: (M,) number of rotors of each drone.
        count: (M,) for M drones, () for one.

    Returns:
        Conditions as arrays.

    Raises:
        ValueError: If no condition is given, a number is invalid, or the dynamics ignores one.
    """
    if all(one is None for one in given):
        raise ValueError(
            f"no condition is given: set at least one of {', '.join(Condition._fields)}"
        )
    feels = {
        "rotor_effectiveness": dynamics.feels_rotors and dynamics.consumes == SetpointLevel.ROTOR,
        "added_mass": dynamics.feels_mass,
        "added_inertia": dynamics.feels_inertia,
        "gravity": dynamics.feels_gravity,
    }
    for name, value in given._asdict().items():
        if value is not None and not feels[name]:
            points = OTHER_DYNAMICS.get(name, "")
            raise ValueError(
                f"{name} is {shown(value)}, and dynamics {dynamics.name!r} ignores it: "
                f"{ROTOR_DYNAMICS}{points}"
            )
    effectiveness, mass, inertia, gravity = tuple(given)
    if effectiveness is not None:
        effectiveness = _effectiveness(effectiveness, num_rotors, count)
    if mass is not None:
        mass = _shaped("added_mass", mass, count, "kg")
    if inertia is not None:
        inertia = _shaped("added_inertia", inertia, (*count, 3), "kg m^2")
    if gravity is not None:
        gravity = finite("gravity", gravity, 0.0, MAX_GRAVITY)
    return Condition(effectiveness, mass, inertia, gravity)


def _effectiveness(value: Any, num_rotors: np.ndarray, count: tuple[int, ...]) -> np.ndarray:
    """Return the effectiveness (R,), or (M, R), of the rotors of drones."""
    array = numbers_of("rotor_effectiveness is", value)
    numbers = sorted(set(num_rotors.tolist()))
    if len(numbers) > 1:
        raise ValueError(
            f"rotor_effectiveness is for drones with {numbers} rotors: set the drones with the "
            f"same number of rotors together"
        )
    rotors = numbers[0] if numbers else 0
    if array.shape not in ((rotors,), (*count, rotors)):
        raise ValueError(
            f"rotor_effectiveness has shape {array.shape}: {(rotors,)} is needed, a number from 0 "
            f"to 1 for each rotor"
        )
    if not ((array >= 0) & (array <= 1)).all():
        raise ValueError(
            f"rotor_effectiveness is {shown(value)}: numbers from 0 (failed) to 1 are needed"
        )
    return array


def _shaped(name: str, value: Any, shape: tuple[int, ...], unit: str) -> np.ndarray:
    """Return numbers of a shape, or of its last axis."""
    array = numbers_of(f"{name} is", value)
    for_all = shape[-1:] if name == "added_inertia" else ()
    if array.shape not in (shape, for_all):
        raise ValueError(f"{name} has shape {array.shape}: {for_all or shape} is needed")
    if not (np.abs(array) <= MAX_ADDED).all():
        raise ValueError(f"{name} is {shown(value)}: finite numbers in {unit} are needed")
    return array


def apply_condition(parts: Parts, world: int, rows: Any, condition: Condition) -> None:
    """Apply checked conditions to drones of a world; see `Uncertainty.load_drones`.

    Raises:
        ValueError: If a drone would be too light or too heavy; nothing is changed.
    """
    effectiveness, mass, inertia, gravity = condition
    if mass is not None or inertia is not None:
        parts.uncertainty.load_drones(world, rows, mass, inertia)
    if effectiveness is not None:
        ratio = np.sqrt(effectiveness)
        drones = parts.dynamics.rotor_ratio[world, : parts.options.num_drones]
        drones[rows, : ratio.shape[-1]] = ratio
    if gravity is not None:
        parts.dynamics.local_gravity[world] = gravity


class Schedule:
    """Changes of drones and wind in the episodes of W worlds of N drones.

    Attributes:
        events: The E events of each episode.
        time: (W, E) time of each event, s.
        drone: (W, E) index of its drone; -1 for all drones.
        done: (W, E) bool, events that are past.
        changed: (W,) bool, worlds that callers may have changed since their reset.
        log: Changes by callers since the reset of each world, as events; None for more than
            `MAX_EVENTS`.
    """

    def __init__(self, parts: Parts, energy: Energy) -> None:
        """Check the events of the options.

        Raises:
            ValueError: If there is no such drone, a number is invalid, or a change has no effect.
        """
        options, (worlds, drones) = parts.options, parts.parameters.shape
        self.events, self._parts, self._energy = options.events, parts, energy
        shape = (worlds, len(self.events))
        self.time, self.drone = np.zeros(shape), np.full(shape, -1)
        self.done = np.zeros(shape, dtype=bool)
        self.changed = np.zeros(worlds, dtype=bool)
        self.log: list[list[Event] | None] = [[] for _ in range(worlds)]
        self._conditions = [self._checked(event, drones) for event in self.events]

    def _checked(self, event: Event, num_drones: int) -> Condition:
        """Return the checked conditions of an event."""
        parts = self._parts
        if isinstance(event.drone, int) and event.drone >= num_drones:
            raise ValueError(
                f"drone of an event is {event.drone}: from 0 to {num_drones - 1} is needed"
            )
        end = parts.options.horizon / parts.options.decision_hz
        if event.time_bounds[0] >= end:
            raise ValueError(
                f"time of an event is {shown(event.time)} s, and episodes end after {end:g} s: "
                f"lower it, or raise horizon"
            )
        rows = event.drone if isinstance(event.drone, int) else slice(None)
        if event.charge is not None and parts.options.battery_capacity is None:
            raise ValueError(
                f"charge of an event is {event.charge:g}, and batteries are unlimited: set "
                f"battery_capacity"
            )
        if event.wind is not None and parts.options.dynamics_name in WITHOUT_WIND:
            raise ValueError(
                f"wind of an event is {event.wind}, and dynamics {parts.options.dynamics_name!r} "
                f"ignores wind: use 'point_mass', 'rigid_body' or 'bullet'"
            )
        weights = (event.added_mass, event.added_inertia, event.gravity)
        given = Condition(event.rotor_effectiveness, *weights)
        if given == Condition():
            return given
        rotors = np.atleast_1d(parts.parameters["num_rotors"][0, rows])
        count = () if isinstance(event.drone, int) else (num_drones,)
        checked = check_condition(given, parts.dynamics, rotors, count)
        parts.uncertainty.require_load(rows, checked.added_mass, checked.added_inertia)
        return checked

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays (W, E) by name, for snapshots; none without events."""
        if not self.events:
            return {}
        return {"event time": self.time, "event drone": self.drone, "event done": self.done}

    def bounds(self) -> Bounds:
        """Return the bounds of `arrays`, by name."""
        drones = self._parts.parameters.shape[1]
        return {"event time": (0.0, MAX_TIME), "event drone": (-1, drones - 1)}

    def reset(self, world: int, rng: np.random.Generator, members: np.ndarray) -> None:
        """Draw the events of a new episode, and undo those of the episode before.

        `Uncertainty.reset` undoes added masses.

        Args:
            world: Index of the world.
            rng: Random generator of the world.
            members: (N,) bool, drones that take part, among which random ones are drawn.
        """
        parts = self._parts
        parts.dynamics.rotor_ratio[world] = 1.0
        parts.dynamics.local_gravity[world] = parts.options.gravity
        if "wind" not in parts.uncertainty.drawn:
            parts.wind.steady[world] = parts.wind.given
        self.changed[world], self.log[world] = False, []
        self.done[world] = False
        for k, event in enumerate(self.events):
            low, high = event.time_bounds
            self.time[world, k] = rng.uniform(low, high) if low < high else low
            if event.drone == RANDOM:
                present = np.flatnonzero(members)
                self.drone[world, k] = present[rng.integers(len(present))]
            elif event.drone is not None:
                self.drone[world, k] = event.drone

    def restore(self, worlds: np.ndarray) -> None:
        """Note that the state of worlds (S,) was written, and may have changes."""
        self.changed[worlds] = True
        for w in worlds.tolist():
            self.log[w] = []

    def apply_due(self, time: np.ndarray, flying: np.ndarray) -> None:
        """Apply the events that are due in the worlds that fly.

        Args:
            time: (W,) time of each world, s.
            flying: (W,) bool.
        """
        due = flying[:, None] & ~self.done & (self.time <= time[:, None])
        # In the order of their times; events of the same time in the order of the option
        worlds, numbers = np.nonzero(due)
        order = np.lexsort((numbers, self.time[worlds, numbers], worlds))
        for w, k in zip(worlds[order].tolist(), numbers[order].tolist(), strict=True):
            drone = int(self.drone[w, k])
            rows = slice(None) if drone < 0 else drone
            self._apply(w, rows, self.events[k], self._conditions[k])
            self.done[w, k] = True

    def _apply(self, world: int, rows: Any, event: Event, condition: Condition) -> None:
        """Apply a checked event to drones of a world."""
        apply_condition(self._parts, world, rows, condition)
        if event.charge is not None:
            self._energy.readings()["charge"][world, rows] = event.charge
        if event.wind is not None:
            self._parts.wind.steady[world] = event.wind

    def change(
        self,
        worlds: list[int],
        drones: list[int] | None,
        changes: Mapping[str, Any],
        time: np.ndarray,
    ) -> None:
        """Apply changes of a caller, after the events that are due.

        Args:
            worlds: Indices of the worlds.
            drones: Indices of the drones; None for all.
            changes: Values by the names of `events.CHANGES`.
            time: (W,) time of each world, s.

        Raises:
            ValueError: If a name or value is invalid; nothing is changed.
        """
        for name in changes:
            if name not in CHANGES:
                raise unknown("condition", name, CHANGES)
        chosen: list[int | None] = [None] if drones is None else [*drones]
        events = [Event(time=0.0, drone=drone, **changes) for drone in chosen]
        conditions = [self._checked(event, self._parts.parameters.shape[1]) for event in events]
        here = np.zeros(len(time), dtype=bool)
        here[worlds] = True
        self.apply_due(time, here)
        for w in worlds:
            for event, condition in zip(events, conditions, strict=True):
                rows = slice(None) if event.drone is None else event.drone
                self._apply(w, rows, event, condition)
            self.changed[w] = True
            # The same events, applied by an option, repeat the flight
            log, now = self.log[w], float(time[w])
            if log is not None and len(log) + len(events) <= MAX_EVENTS:
                log += [dataclasses.replace(event, time=now) for event in events]
            else:
                self.log[w] = None
