"""gym-pybullet-drones (J. Panerati et al. 2021), from a checkout.

The path of the checkout is the first argument.
"""

from serve import SUBSTEPS, grid, serve  # first: it takes care of what others print

# isort: split

import sys
from functools import partial

import numpy as np

sys.path.append(sys.argv[1])

from gym_pybullet_drones.envs.CtrlAviary import CtrlAviary
from gym_pybullet_drones.utils.enums import Physics


def aviary(num_drones: int, physics: Physics, decision_hz: int = 240 // SUBSTEPS) -> CtrlAviary:
    """Make drones on the grid of all simulators, with substeps of 240 Hz."""
    start = np.array(grid(num_drones))
    return CtrlAviary(
        num_drones=num_drones,
        initial_xyzs=start,
        physics=physics,
        pyb_freq=240,
        ctrl_freq=decision_hz,
    )


def flight(num_drones: int, physics: Physics):
    """Fly with the rotor speeds of hover, 24 substeps of 240 Hz a decision."""
    env = aviary(num_drones, physics)
    env.reset(seed=0)
    return partial(env.step, np.full((num_drones, 4), env.HOVER_RPM)), num_drones * SUBSTEPS


def decide(num_drones: int, physics: Physics, decision_hz: int):
    """Fly with the rotor speeds of hover, in short decisions. The rate is in decisions."""
    env = aviary(num_drones, physics, decision_hz)
    env.reset(seed=0)
    return partial(env.step, np.full((num_drones, 4), env.HOVER_RPM)), 1


def pictures(num_drones: int):
    """Take the pictures of all drones' cameras, with 128 x 128 pixels."""
    env = aviary(num_drones, Physics.PYB)
    env.reset(seed=0)
    env.IMG_RES = np.array([128, 128])

    def take() -> None:
        for i in range(num_drones):
            env._getDroneImages(i)

    return take, num_drones


def reset(num_drones: int):
    """Reset all drones."""
    env = aviary(num_drones, Physics.PYB)
    return partial(env.reset, seed=0), 1


SHORT = {
    f"{name}, {num_drones}, {hz} Hz": partial(decide, num_drones, physics, hz)
    for name, physics in (("bare", Physics.PYB), ("all forces", Physics.PYB_GND_DRAG_DW))
    for num_drones in (1, 10, 100)
    for hz in (240, 48, 30, 10)
}

if __name__ == "__main__":
    serve(
        {
            **SHORT,
            "all forces, 10": partial(flight, 10, Physics.PYB_GND_DRAG_DW),
            "all forces, 100": partial(flight, 100, Physics.PYB_GND_DRAG_DW),
            "bare, 10": partial(flight, 10, Physics.PYB),
            "reset, 10": partial(reset, 10),
            "pictures, 8": partial(pictures, 8),
        }
    )
