"""PyFlyt (J. J. Tai et al. 2023)."""

from serve import SUBSTEPS, grid, serve  # first: it takes care of what others print

# isort: split

from functools import partial

import numpy as np
from PyFlyt.core import Aviary
from PyFlyt.pz_envs.quadx_envs.ma_quadx_hover_env import MAQuadXHoverEnv


def quadx(num_drones: int):
    """Hover under position control, 240 Hz physics, 24 substeps a decision."""
    start = np.array(grid(num_drones))
    env = Aviary(start_pos=start, start_orn=np.zeros_like(start), drone_type="quadx", seed=1)
    env.set_mode(7)
    for i, place in enumerate(start):
        env.set_setpoint(i, np.array([place[0], place[1], 0.0, place[2]]))
    env.step()
    loops = 1 if env.updates_per_step < 1 else env.updates_per_step
    per_step = num_drones * loops

    def decision() -> None:
        for _ in range(SUBSTEPS // loops):
            env.step()

    return decision, per_step * (SUBSTEPS // loops)


def hover(num_drones: int):
    """Fly the PettingZoo environment with one action, and reset it when all agents are done.

    Agents that are done before the others still count.
    """
    start = np.array(grid(num_drones))
    env = MAQuadXHoverEnv(
        start_pos=start,
        start_orn=np.zeros_like(start),
        flight_dome_size=100.0,
        agent_hz=240 // SUBSTEPS,
    )
    env.reset(seed=1)
    actions = {agent: np.array([0.0, 0.0, 0.0, 0.3]) for agent in env.possible_agents}

    def step() -> None:
        if not env.agents:
            env.reset()
        env.step({agent: actions[agent] for agent in env.agents})

    return step, num_drones * SUBSTEPS


def pictures(num_drones: int):
    """Take the pictures of all drones' cameras, with 128 x 128 pixels."""
    start = np.array(grid(num_drones))
    env = Aviary(
        start_pos=start,
        start_orn=np.zeros_like(start),
        drone_type="quadx",
        drone_options={"use_camera": True, "camera_resolution": (128, 128)},
        seed=1,
    )

    def take() -> None:
        for drone in env.drones:
            drone.camera.capture_image()

    return take, num_drones


def reset(num_drones: int):
    """Reset all drones."""
    start = np.array(grid(num_drones))
    env = MAQuadXHoverEnv(start_pos=start, start_orn=np.zeros_like(start))
    return partial(env.reset, seed=1), 1


if __name__ == "__main__":
    serve(
        {
            "quadx, 10": partial(quadx, 10),
            "quadx, 100": partial(quadx, 100),
            "pettingzoo hover, 10": partial(hover, 10),
            "reset, 10": partial(reset, 10),
            "pictures, 8": partial(pictures, 8),
        }
    )
