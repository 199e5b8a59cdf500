"""Recordings of an airspace: the flight of a loop of one's own, and the calls that repeat it."""

import copy
import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Self

import numpy as np

from bulletuav.analysis.recorded import INFO_ARRAYS, Recording
from bulletuav.analysis.recorder import Recorder
from bulletuav.analysis.recording import write_run
from bulletuav.analysis.seals import require_trusted
from bulletuav.conflict.separation import measure_conflict
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.envs.airspace import CHANGES, Airspace
from bulletuav.envs.airspace_world import AirspaceWorld
from bulletuav.envs.aviary import NOTHING_STANDS
from bulletuav.envs.descriptions import describe_options
from bulletuav.errors import as_int, find_choice, shown
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.solids import Solids
from bulletuav.parsing import read_json
from bulletuav.sensors.base import Label
from bulletuav.sensors.lidar import Beam, make_beams
from bulletuav.tasks.frame import Scene
from bulletuav.vehicle.load import Load
from bulletuav.vehicle.swarm import Contacts, Swarm

AIRSPACE = "airspace"
"""Name of recordings of airspaces, in place of a task's"""
OBSTACLE = "Obstacle"
"""Entry of a dict in `calls.json` that stands for an obstacle"""
LOAD = "Load"
"""Entry of a dict in `calls.json` that stands for a load"""
STEP = "step"
Call = list[Any]
"""Name of a method, and its arguments; or "step" and the number of steps"""


class AirspaceRecorder:
    """Records an airspace from now on, step by step, until it is closed.

    All calls of the airspace's methods are kept with their arguments, so that `bulletuav verify`
    can fly them again. For example::

        airspace = Airspace([(0.0, 0.0, 1.0)], decision_hz=48, rotor_speed="hover")
        with AirspaceRecorder(airspace) as recorder:
            airspace.command(0, "position", (1.0, 0.0, 1.0))
            for _ in range(48):
                airspace.step()
        recorder.save("flight")

    In recordings, actions are the setpoints that drones held, with their levels as the info
    `level`. There are no rewards, goals or conflicts, and no drone succeeds.
    """

    def __init__(self, airspace: Airspace) -> None:
        """Start with the present state.

        Args:
            airspace: The airspace. It can be flown again only if nothing was called before.

        Raises:
            RuntimeError: If the airspace is recorded already.
        """
        if any(isinstance(vars(airspace).get(name), _Logged) for name in CHANGES):
            raise RuntimeError("this airspace is recorded already: close the other recorder first")
        self._airspace, self._view = airspace, _View(airspace)
        # The state in which a flight of the calls has to begin, and the seed, if it was drawn, too
        self._seed: Any = airspace.rng.bit_generator.seed_seq.entropy  # type: ignore[attr-defined]
        self._begin = _beginning(airspace)
        self._recorder = Recorder(self._view)
        self._before = airspace.swarm.position[None].copy()
        self._calls: list[Call] = []
        # Instance attributes hide the methods; `debug` has hidden them before
        self._hidden = {name: vars(airspace).get(name) for name in CHANGES}
        for name in CHANGES:
            setattr(airspace, name, _Logged(getattr(airspace, name), name, self._keep))

    def _keep(self, name: str, args: Sequence[Any], kwargs: Mapping[str, Any]) -> None:
        """Keep a call that has returned."""
        if name != STEP:
            self._calls.append([name, list(args), dict(kwargs)])
            return
        if self._calls and self._calls[-1][0] == STEP:
            self._calls[-1][1] += 1
        else:
            self._calls.append([STEP, 1])
        self._record()

    def _record(self) -> None:
        """Record the step that was just flown."""
        view = self._view
        position = view.swarm.position
        none = np.zeros(view.alive.shape)
        conflict = measure_conflict(self._before, position, view.alive, 0.0, 0.0)
        self._before = position.copy()
        info = {
            "success": none.astype(bool),
            "separation": conflict.separation,
            "conflicts": none.astype(int),
            "collision": view.contacts.mask(view.alive.shape),
            "level": self._airspace.levels[None].copy(),
        }
        self._recorder.record(self._airspace.setpoint[None].copy(), none, info)

    def recording(self) -> Recording:
        """Return the recording so far.

        Raises:
            ValueError: If no step was recorded.
        """
        if not any(call[0] == STEP for call in self._calls):
            raise ValueError("nothing was recorded: call step() of the airspace first")
        return self._recorder.recording()

    def save(self, folder: str | Path) -> list[Path]:
        """Write the recording to a folder, for `bulletuav replay`, `export` and `verify`.

        Args:
            folder: The folder, which is created.

        Returns:
            The files; `calls.json` is among them if the flight can be flown again. It cannot if
            JSON cannot hold the arguments, such as a snapshot or a function, or if the airspace was
            used before the recording.

        Raises:
            ValueError: If no step was recorded.
            OSError: If a file cannot be written.
        """
        recording, place = self.recording(), Path(folder)
        place.mkdir(parents=True, exist_ok=True)
        options = describe_options(self._view.options, self._view.task.config)
        about = {"task": AIRSPACE, "policy": "own loop", "seed": options["seed"]}
        about |= {"options": options, "call": None}
        return write_run(recording, place, about, self._format_calls())

    def _format_calls(self) -> str | None:
        """Return the arguments and calls as JSON; None if they do not repeat the flight."""
        args, given = self._airspace.made_from
        # The default depends on whether PyBullet is installed
        kwargs = {"dynamics": self._view.options.dynamics, **given, "seed": self._seed}
        content = {"args": list(args), "kwargs": kwargs, "calls": self._calls}
        try:
            text = json.dumps(content, default=_plain, allow_nan=False)
        except (TypeError, ValueError):
            return None
        with Airspace(*args, **kwargs) as unused:
            is_whole = _beginning(unused) == self._begin
        return text if is_whole else None

    def close(self) -> None:
        """End the recording; the airspace flies on without it. Further calls do nothing."""
        for name, method in self._hidden.items():
            delattr(self._airspace, name)
            if method is not None:
                setattr(self._airspace, name, method)
        self._hidden = {}

    def __enter__(self) -> Self:
        """Return the recorder, which is closed at the end of the `with` statement."""
        return self

    def __exit__(self, *error: object) -> None:
        """Close the recorder."""
        self.close()


def record_instant(airspace: Airspace) -> Recording:
    """Record the present state as one decision without a step, for data that are constant."""
    recorder, none = Recorder(_View(airspace)), np.zeros((1, len(airspace.airframes)))
    recorder.record(none[..., None], none, dict.fromkeys(INFO_ARRAYS, none))
    return recorder.recording()


def fly_calls(
    path: Path, most: int, trust: bool, progress: Callable[[], None] = lambda: None
) -> Recording:
    """Fly the calls of a recorded airspace again.

    Args:
        path: The file `calls.json`.
        most: Maximum number of steps: that of the recording.
        trust: Whether names in it may refer to code.
        progress: Callback after every step.

    Returns:
        The recording of the new flight.

    Raises:
        ValueError: If the file is damaged, or names code that is not trusted.
    """
    content = read_json(path)
    require_trusted(content, trust, path)
    try:
        args, kwargs, calls = (_restored(content[name]) for name in ("args", "kwargs", "calls"))
        airspace = Airspace(*args, **kwargs)
        with airspace, AirspaceRecorder(airspace) as recorder:
            for call in calls:
                name, *arguments = call if isinstance(call, list) and call else ("",)
                find_choice("call", name, dict.fromkeys(CHANGES))
                if name == STEP:
                    steps = as_int("steps", arguments[0], 1, most)
                    most -= steps
                    for _ in range(steps):
                        airspace.step()
                        progress()
                else:
                    getattr(airspace, name)(*arguments[0], **arguments[1])
            return recorder.recording()
    except (KeyError, IndexError, TypeError) as error:
        raise ValueError(f"{path} is damaged ({shown(str(error))}): fly it again") from None


def _beginning(airspace: Airspace) -> tuple[str, int]:
    """Return a hash of the state, and the number of pieces of bodies."""
    return airspace.state_hash(), len(airspace.world.engine.scenery.other)


def _restored(value: Any) -> Any:
    """Return a value of `_plain` with obstacles and loads in place of their descriptions."""
    if isinstance(value, list):
        return [_restored(one) for one in value]
    if not isinstance(value, dict):
        return value
    if set(value) == {OBSTACLE}:
        return Obstacle(**value[OBSTACLE])
    if set(value) == {LOAD}:
        return Load.of_numbers(value[LOAD])
    return {name: _restored(one) for name, one in value.items()}


class _Logged:
    """Method of an airspace whose calls are kept after they returned."""

    def __init__(
        self, method: Callable[..., Any], name: str, keep: Callable[[str, Any, Any], None]
    ) -> None:
        self._method, self._name, self._keep = method, name, keep

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        # The caller may modify its arrays later
        given = [_copied(one) for one in args], {k: _copied(one) for k, one in kwargs.items()}
        result = self._method(*args, **kwargs)
        self._keep(self._name, *given)
        return result


def _copied(value: Any) -> Any:
    """Return an argument that later changes by the caller do not affect."""
    if isinstance(value, SetpointLevel):
        return value.name.lower()
    if isinstance(value, np.ndarray):
        return value.tolist()
    return copy.deepcopy(value) if isinstance(value, list | tuple | dict) else value


def _plain(value: Any) -> Any:
    """Return a value that JSON can represent.

    Raises:
        TypeError: If there is none.
    """
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Obstacle):
        return {OBSTACLE: dataclasses.asdict(value)}
    if isinstance(value, Load):
        return {LOAD: value.numbers()}
    raise TypeError(f"{shown(value)} cannot be stored")


@dataclass(frozen=True)
class _Config:
    """Options of a task that an airspace lacks."""

    d_safe: float = 0.0


class _Ranging(NamedTuple):
    """Beams and range of the range finder; see `TaskContext`."""

    beams: tuple[Beam, ...]
    max_range: float


class _NoTask(NamedTuple):
    """What a recorder reads of a task, for an airspace."""

    bodies: tuple[Obstacle, ...]
    context: _Ranging
    name: str = AIRSPACE
    config: _Config = _Config()
    has_goals: bool = False
    shows: Mapping[str, str] = MappingProxyType({})
    loads: None = None

    def obstacles(self) -> tuple[Obstacle, ...]:
        """Return the obstacles."""
        return self.bodies

    def targets(self, _: Scene) -> np.ndarray:
        """Return no points, (1, 0, 3)."""
        return np.zeros((1, 0, 3))

    def active_targets(self, _: Scene) -> np.ndarray:
        """Return no targets, (1, 0)."""
        return np.zeros((1, 0), dtype=bool)


class _View:
    """An airspace as a recorder reads it: an aviary of one world; see `Recorded`."""

    num_worlds = 1

    def __init__(self, airspace: Airspace) -> None:
        self._airspace = airspace
        made = airspace.made_from[1]
        self._layout: Solids | None = made.get("layout")
        self.options = airspace.world.options
        sensing = make_beams(self.options.num_beams, self.options.lidar_elevations)
        ranging = _Ranging(sensing, self.options.max_range)
        self.task = _NoTask(tuple(made.get("obstacles", ())), ranging)
        self.sight = self.links = np.zeros((1, len(airspace.airframes), 0), dtype=bool)

    @property
    def worlds(self) -> AirspaceWorld:
        return self._airspace.world

    @property
    def steps(self) -> np.ndarray:
        return self._airspace.world.state.steps

    @property
    def swarm(self) -> Swarm:
        return self._airspace.world.state.swarm

    @property
    def alive(self) -> np.ndarray:
        return self._airspace.world.state.alive

    @property
    def scene(self) -> Scene:
        state = self._airspace.world.state
        drones = np.zeros_like(state.swarm.position)
        moving = (state.obstacle, state.obstacle_velocity, state.obstacle_turn)
        return Scene(drones, drones, drones, *moving, np.zeros(1, dtype=int), {})

    @property
    def contacts(self) -> Contacts:
        return self._airspace.contacts

    @property
    def readings(self) -> Mapping[str, np.ndarray]:
        return {name: values[None] for name, values in self._airspace.readings.items()}

    @property
    def reading_labels(self) -> dict[str, tuple[Label, ...]]:
        return self._airspace.world.sensors.numbers()

    def solids(self) -> Solids:
        return NOTHING_STANDS if self._layout is None else self._layout
