"""Recorder of a fleet that flies for any time, within bounded memory."""

import dataclasses
import json
from collections.abc import Sequence
from typing import Any, NamedTuple, Self

import numpy as np

from bulletuav.analysis.airspace_recorder import record_instant
from bulletuav.analysis.markers import MarkerLog
from bulletuav.analysis.recorded import Recording
from bulletuav.analysis.recorder import stack_contacts
from bulletuav.analysis.scene import PARTS, measure_airspeed
from bulletuav.conflict.separation import measure_conflict
from bulletuav.engine.parking import PARKING_HEIGHT
from bulletuav.parsing import parse_json
from bulletuav.vehicle.swarm import Contacts, Swarm

ROW_INTERVAL = 0.05
"""Time between two rows at the start, s"""
MAX_ROWS = 20_000
"""Maximum number of rows; when it is reached, every second row is discarded, and so on"""
MAX_NUMBERS = 8_000_000
"""Maximum number of numbers in all rows, so that large fleets have fewer rows"""


class _Row(NamedTuple):
    """State at one time.

    Attributes:
        step: Number of steps since the start.
        swarm: State of the N drones.
        place: (K, 3) centres of obstacles and of pieces of bodies, m.
        turn: (K, 4) attitudes of these.
        separation: (N,) distance to the nearest other drone, m.
        contacts: Contacts since the previous row.
        airspeed: (N,) speed through the air, m/s; (0,) in a fleet without wings.
    """

    step: int
    swarm: Swarm
    place: np.ndarray
    turn: np.ndarray
    separation: np.ndarray
    contacts: Contacts
    airspeed: np.ndarray


class FleetRecorder:
    """Records the steps of a fleet for a replay, until it is closed.

    A row is recorded every 50 ms. A flight of any duration fits into memory, because its rows
    become sparser as it gets longer. For example::

        with FleetRecorder(fleet) as recorder:
            server.run()
        write_replay(recorder.recording(), "a flight", Path("replay.html"))

    Attributes:
        markers: Markers to show in the replay.
    """

    def __init__(self, fleet: Any) -> None:
        """Start with the present state.

        Args:
            fleet: Object with a method `step`, which steps its `airspace` once. The airspace may be
                replaced by one with more drones: a drone that is added stands at its first position
                in all rows before.
        """
        self._fleet, self._steps = fleet, 0
        self._every = max(round(ROW_INTERVAL / fleet.airspace.period), 1)
        self._contacts = Contacts.none()
        self._rows = [self._row()]
        self.markers = MarkerLog(lambda: self._steps * fleet.airspace.period)
        # The instance attribute hides the method
        self._fleet_step, fleet.step = fleet.step, self._step

    def _step(self) -> Any:
        """Step the fleet, and record a row if it is due."""
        result = self._fleet_step()
        self._steps += 1
        contacts = self._fleet.airspace.contacts
        if len(contacts.drone):
            self._contacts = self._contacts.joined(contacts)
        if self._steps % self._every == 0:
            self._append_row()
        return result

    def _append_row(self) -> None:
        """Record a row, and discard every second one if there are too many."""
        rows = self._rows
        rows.append(self._row())
        self._contacts = Contacts.none()
        last = rows[-1]
        size = sum(array.size for array in (*last.swarm, last.place, last.turn))
        if len(rows) <= max(min(MAX_ROWS, MAX_NUMBERS // size), 2):
            return
        self._every *= 2
        # A contact is shown at the next row
        for k in range(2, len(rows), 2):
            contacts = rows[k - 1].contacts.joined(rows[k].contacts)
            rows[k] = rows[k]._replace(contacts=contacts)
        if len(rows) % 2 == 0:
            self._contacts = rows[-1].contacts
        self._rows = rows[::2]

    def _row(self) -> _Row:
        """Copy the present state."""
        world = self._fleet.airspace.world
        state, scenery = world.state, world.engine.scenery
        swarm = state.swarm
        # Bodies that users add are the last pieces of the scenery, after the obstacles
        first = scenery.place.shape[1] - len(scenery.bodies.owner)
        airspeed, time = np.zeros(0), self._steps * self._fleet.airspace.period
        if swarm.deflection.shape[-1]:
            airspeed = measure_airspeed(world, swarm, time)
        conflict = measure_conflict(swarm.position, swarm.position, state.alive, 0.0, 0.0)
        return _Row(
            self._steps,
            swarm.world(0).copy(),
            np.concatenate([state.obstacle[0], scenery.place[0, first:]]),
            np.concatenate([state.obstacle_turn[0], scenery.quaternion[0, first:]]),
            conflict.separation[0].copy(),
            self._contacts,
            airspeed,
        )

    @property
    def has_rows(self) -> bool:
        """Whether the fleet has flown a step."""
        return self._steps > 0

    def recording(self) -> Recording:
        """Return the recording so far, with the markers in its scene; actions are empty.

        Raises:
            ValueError: If the fleet has not flown a step.
        """
        if not self.has_rows:
            raise ValueError("nothing was recorded: the fleet has not flown")
        rows = self._rows
        if rows[-1].step < self._steps:
            rows = [*rows, self._row()]
        airspace = self._fleet.airspace
        now = record_instant(airspace)
        shape = (len(rows) - 1, len(airspace.airframes))
        swarm = Swarm(*map(_stack, zip(*(row.swarm for row in rows), strict=True)))
        place, turn = _stack([row.place for row in rows]), _stack([row.turn for row in rows])
        # Obstacles that are not in the world are shown below the ground, below the drones
        is_absent = place[..., 2] <= -PARKING_HEIGHT
        below = np.full((len(now.obstacle_radius), 3), swarm.position[0].mean(axis=0))
        below[:, 2] = -2 * now.obstacle_radius
        contacts = [row.contacts for row in rows[1:]]
        scene = {
            **{name: now.scene[name] for name in PARTS},
            **self.markers.arrays(),
            "about": _omit_readings(now.scene["about"]),
            "rotor_speed": swarm.rotor_speed,
            "obstacle_quaternion": turn,
        }
        if swarm.deflection.shape[-1]:
            scene["deflection"] = swarm.deflection
            scene["airspeed"] = _stack([row.airspeed for row in rows])
        if "building_colour" in now.scene:
            scene["building_colour"] = now.scene["building_colour"]
        return dataclasses.replace(
            now,
            time=np.array([row.step for row in rows]) * airspace.period,
            position=swarm.position,
            quaternion=swarm.quaternion,
            velocity=swarm.velocity,
            rates=swarm.rates,
            alive=np.ones((len(rows), shape[1]), dtype=bool),
            action=np.zeros((*shape, 0)),
            reward=np.zeros(shape),
            separation=_stack([row.separation for row in rows])[1:],
            conflicts=np.zeros(shape, dtype=int),
            success=np.zeros(shape, dtype=bool),
            collision=np.array([one.mask((1, shape[1]))[0] for one in contacts]),
            **stack_contacts(contacts),
            goal=np.zeros((len(rows), 0, 3)),
            obstacle=np.where(is_absent[..., None], below, place),
            target=np.zeros((len(rows), 0, 3)),
            seen=np.zeros((len(rows), 0), dtype=bool),
            info={},
            reading={},
            scene=scene,
        )

    def close(self) -> None:
        """End the recording; the fleet flies on without it. A second call does nothing."""
        vars(self._fleet).pop("step", None)

    def __enter__(self) -> Self:
        """Return the recorder, which is closed at the end of the `with` statement."""
        return self

    def __exit__(self, *error: object) -> None:
        """Close the recorder."""
        self.close()


def _stack(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """Stack arrays whose first axis may grow: new entries have their first values in all rows."""
    stacked = np.empty((len(arrays), *arrays[-1].shape))
    for k in reversed(range(len(arrays))):
        count = len(arrays[k])
        stacked[k, :count] = arrays[k]
        stacked[k, count:] = stacked[min(k + 1, len(arrays) - 1), count:]
    return stacked


def _omit_readings(about: np.ndarray) -> np.ndarray:
    """Return the description of a scene without sensor readings, which are not recorded."""
    content = parse_json(str(about), "its description")
    return np.array(json.dumps({**content, "readings": {}}))
