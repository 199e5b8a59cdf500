"""Subprocess that runs examples of gym-pybullet-drones, started by `fly_peer_examples`.

Arguments: folder of gym-pybullet-drones, file to write, duration in seconds, shift of the starts.
The file is an archive of NumPy with an array (T, N, 20) for each flight: the states of N drones
after each control step, of which the last four numbers are the rotor speeds in the step, rpm. The
starts are shifted along each axis, m, and about each axis, rad.

Two packages that gym-pybullet-drones imports, but these examples do not use otherwise than to find
its files, are replaced by stand-ins if they are not installed: transforms3d and pkg_resources.
"""

import importlib
import importlib.util
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

PACKAGE = "gym_pybullet_drones"
"""Name of the package in the folder"""
EXAMPLES = ("pid", "pid_velocity", "downwash")
"""Scripts of the package that fly without learning"""
ACTIONS = ("ONE_D_RPM", "ONE_D_PID", "RPM", "PID", "VEL")
"""Kinds of actions that its script learn.py offers"""
LEARNING_HZ = 30
"""Control steps of learning environments, 1/s"""


def fixed_actions(kind: str, count: int) -> np.ndarray:
    """Return actions (T, S) of a learning environment that keep the drone in the air.

    Args:
        kind: One of `ACTIONS`.
        count: Number of control steps T.
    """
    time = np.arange(count) / LEARNING_HZ
    fast, slow = 2.0 * np.pi * time, 2.0 * np.pi * time / 5.0
    if kind in ("ONE_D_RPM", "ONE_D_PID"):
        return 0.5 * np.cos(fast)[:, None]
    if kind == "RPM":
        # Opposite rotors differ in the first second, and then no longer
        tilt = np.where(time < 1.0, 0.0005 * np.sin(fast), 0.0)
        climb = 0.2 * np.cos(fast)
        return np.stack([climb + tilt, climb, climb - tilt, climb], axis=1)
    if kind == "PID":
        circle = 0.1 * np.sin(slow), 0.1 - 0.1 * np.cos(slow)
        return np.stack([*circle, 0.3 + 0.1 * np.sin(slow)], axis=1)
    rest = np.ones(count)
    return np.stack([np.sin(slow), np.cos(slow), 0.2 * rest, rest], axis=1)


class FlightLogger:
    """Replacement of the logger of gym-pybullet-drones: keeps the states."""

    last: "FlightLogger | None" = None

    def __init__(self, **_: Any) -> None:
        """Start a log, which `last` refers to."""
        self.states: list[np.ndarray] = []
        FlightLogger.last = self

    def log(self, *, state: np.ndarray, **_: Any) -> None:
        """Keep the state (20,) of the next drone."""
        self.states.append(np.array(state))

    def save(self, *_: Any) -> None:
        """Do nothing; flights are written elsewhere."""

    save_as_csv = save


def add_stand_ins() -> None:
    """Make packages importable that are not installed and not needed here."""
    names = ("transforms3d", "transforms3d.quaternions")
    missing = () if importlib.util.find_spec(names[0]) else names
    for name in missing:
        module: Any = types.ModuleType(name)
        module.__getattr__ = lambda _: None
        sys.modules[name] = module
    if importlib.util.find_spec("pkg_resources") is None:
        module = types.ModuleType("pkg_resources")
        module.resource_filename = find_resource
        sys.modules["pkg_resources"] = module


def find_resource(package: str, name: str) -> str:
    """Return the path of a file in a package, as pkg_resources does."""
    origin = importlib.import_module(package).__file__
    return str(Path(str(origin)).parent / name)


def fly_examples(seconds: int) -> dict[str, np.ndarray]:
    """Run the scripts without windows; return the states (T, N, 20) of each."""
    flights = {}
    for name in EXAMPLES:
        script: Any = importlib.import_module(f"{PACKAGE}.examples.{name}")
        script.Logger = FlightLogger
        fly: Callable[..., None] = script.run
        fly(gui=False, plot=False, duration_sec=seconds)
        assert FlightLogger.last is not None
        states = np.array(FlightLogger.last.states)
        flights[name] = states.reshape(48 * seconds, -1, states.shape[-1])
    return flights


def fly_actions(seconds: int) -> dict[str, np.ndarray]:
    """Fly the fixed actions in HoverAviary; return the states (T, 1, 20) for each kind."""
    enums = importlib.import_module(f"{PACKAGE}.utils.enums")
    aviary = importlib.import_module(f"{PACKAGE}.envs.HoverAviary").HoverAviary
    flights = {}
    for kind in ACTIONS:
        env = aviary(act=enums.ActionType[kind])
        env.reset(seed=0)
        states = []
        for action in fixed_actions(kind, LEARNING_HZ * seconds):
            env.step(action[None])
            states.append([env._getDroneStateVector(0)])
        env.close()
        flights[kind] = np.array(states)
    return flights


def shift_starts(shift: float) -> None:
    """Shift the starts of all drones along each axis, m, and about each axis, rad."""
    aviary = importlib.import_module(f"{PACKAGE}.envs.BaseAviary").BaseAviary
    place = aviary._housekeeping

    def place_shifted(self: Any) -> None:
        starts, angles = self.INIT_XYZS, self.INIT_RPYS
        self.INIT_XYZS, self.INIT_RPYS = np.array(starts) + shift, np.array(angles) + shift
        place(self)
        self.INIT_XYZS, self.INIT_RPYS = starts, angles

    aviary._housekeeping = place_shifted


def main(folder: str, out: str, seconds: str, shift: str) -> None:
    """Fly all flights, and write them."""
    sys.path.insert(0, folder)
    add_stand_ins()
    shift_starts(float(shift))
    flights: dict[str, Any] = {**fly_examples(int(seconds)), **fly_actions(int(seconds))}
    np.savez(out, **flights)


if __name__ == "__main__":
    main(*sys.argv[1:])
