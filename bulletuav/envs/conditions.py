"""Conditions of drones in flight, and their schedule: rotors, added mass and inertia.

A rotor with effectiveness e turns at sqrt(e) times its commanded speed, so that thrust and reaction
torque, which grow with the square of the speed, are e times the commanded ones in the steady state.
It reaches that speed with the lag of the motor: a rotor that fails (e = 0) spins down. Controllers
are not informed: their model is the airframe's, whose rotors, mass and inertia are nominal.

References:
    M. W. Mueller, R. D'Andrea, Stability and control of a quadrocopter despite the complete loss of
    one, two, or three propellers, ICRA 2014.
    Y. Zhang, J. Jiang, Bibliographical review on reconfigurable fault-tolerant control systems,
    Annual Reviews in Control 2008 (loss of effectiveness as a factor of the actuator).
"""

from typing import Any, NamedTuple

import numpy as np

from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics.base import Dynamics
from bulletuav.envs.energy import Energy
from bulletuav.envs.events import MAX_TIME, RANDOM, Event
from bulletuav.envs.parts import Parts
from bulletuav.envs.snapshot import Bounds
from bulletuav.errors import numbers_of, shown

MAX_ADDED = 1e6
"""Largest added mass, kg, and inertia, kg m^2, before the bounds of a drone are applied"""
WITHOUT_WIND = ("single_integrator", "double_integrator")
"""Dynamics that ignore wind"""
ROTOR_DYNAMICS = "use dynamics 'rigid_body' or 'bullet'"


class Condition(NamedTuple):
    """Conditions of drones; None for those that stay as they are.

    Attributes:
        rotor_effectiveness: (R,) of each rotor, from 0 (failed) to 1, or a row for each drone.
        added_mass: Mass in addition to the drone's own, at its centre of mass, kg.
        added_inertia: (3,) moments of inertia in addition to the drone's own, kg m^2.
    """

    rotor_effectiveness: Any = None
    added_mass: Any = None
    added_inertia: Any = None


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
    }
    for name, value in given._asdict().items():
        if value is not None and not feels[name]:
            points = ", or 'point_mass'" if name == "added_mass" else ""
            raise ValueError(
                f"{name} is {shown(value)}, and dynamics {dynamics.name!r} ignores it: "
                f"{ROTOR_DYNAMICS}{points}"
            )
    effectiveness, mass, inertia = tuple(given)
    if effectiveness is not None:
        effectiveness = _effectiveness(effectiveness, num_rotors, count)
    if mass is not None:
        mass = _shaped("added_mass", mass, count, "kg")
    if inertia is not None:
        inertia = _shaped("added_inertia", inertia, (*count, 3), "kg m^2")
    return Condition(effectiveness, mass, inertia)


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
    if array.shape not in (shape, shape[-1:] if name == "added_inertia" else ()):
        raise ValueError(f"{name} has shape {array.shape}: {shape} is needed")
    if not (np.abs(array) <= MAX_ADDED).all():
        raise ValueError(f"{name} is {shown(value)}: finite numbers in {unit} are needed")
    return array


def apply_condition(parts: Parts, world: int, rows: Any, condition: Condition) -> None:
    """Apply checked conditions to drones of a world; see `Uncertainty.load_drones`.

    Raises:
        ValueError: If a drone would be too light or too heavy; nothing is changed.
    """
    effectiveness, mass, inertia = condition
    if mass is not None or inertia is not None:
        parts.uncertainty.load_drones(world, rows, mass, inertia)
    if effectiveness is not None:
        ratio = np.sqrt(effectiveness)
        parts.dynamics.rotor_ratio[world, rows, : ratio.shape[-1]] = ratio


class Schedule:
    """Events of the episodes of W worlds of N drones.

    Attributes:
        events: The E events of each episode.
        time: (W, E) time of each event, s.
        drone: (W, E) index of its drone; -1 for all drones.
        done: (W, E) bool, events that are past.
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
        limited = parts.options.battery_capacity is not None
        if event.added_mass is not None and limited and parts.options.energy != "actuator":
            raise ValueError(
                f"added_mass of an event is {event.added_mass:g} kg, which energy "
                f"{parts.options.energy!r} ignores, so that batteries would last too long: use "
                f"energy='actuator', or leave out battery_capacity"
            )
        given = Condition(event.rotor_effectiveness, event.added_mass, event.added_inertia)
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
        if "wind" not in parts.uncertainty.drawn:
            parts.wind.steady[world] = parts.wind.given
        self.done[world] = False
        for k, event in enumerate(self.events):
            low, high = event.time_bounds
            self.time[world, k] = rng.uniform(low, high) if low < high else low
            if event.drone == RANDOM:
                present = np.flatnonzero(members)
                self.drone[world, k] = present[rng.integers(len(present))]
            elif event.drone is not None:
                self.drone[world, k] = event.drone

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
            event, drone = self.events[k], int(self.drone[w, k])
            rows = slice(None) if drone < 0 else drone
            apply_condition(self._parts, w, rows, self._conditions[k])
            if event.charge is not None:
                self._energy.readings()["charge"][w, rows] = event.charge
            if event.wind is not None:
                self._parts.wind.steady[w] = event.wind
            self.done[w, k] = True
