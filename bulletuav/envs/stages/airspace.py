"""What a step of an airspace has instead of the stages of a task's decision."""

import math

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.compiled.program import Program
from bulletuav.control.setpoint import Setpoints
from bulletuav.envs.airspace_world import AirspaceWorld
from bulletuav.envs.parts import add_obstacles
from bulletuav.envs.stages.base import Stage
from bulletuav.geometry.rotation import heading, quat4

TURN = 2 * math.pi
"""A whole turn, rad"""
MAX_LEAD = 1.0
"""How far a yaw that turns may be ahead of the drone, rad"""


@func
def half_turn(angle: float) -> float:
    """Return the same angle within half a turn to either side, rad."""
    return angle - TURN * math.floor(angle / TURN + 0.5)


@kernel
def prepare(
    quaternion: np.ndarray,
    setpoint: np.ndarray,
    yaw_rate: np.ndarray,
    period: float,
    obstacle: np.ndarray,
    obstacle_velocity: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
) -> None:
    """Move obstacles through a step, and turn the yaws that drones of an airspace are to hold.

    Args:
        quaternion: (W, N, 4) attitudes.
        setpoint: (W, N, S) setpoints; the yaw of those that have one is their fourth number.
        yaw_rate: (W, N) how fast to turn it, rad/s.
        period: Duration of the step, s.
        obstacle: (W, K, 3) positions of obstacles before the step, m; moved to after it.
        obstacle_velocity: (W, K, 3) m/s.
        before: (W, K, 3) positions before, written.
        after: (W, K, 3) positions after, written.
    """
    for w in range(yaw_rate.shape[0]):
        for k in range(obstacle.shape[1]):
            for m in range(3):
                before[w, k, m] = obstacle[w, k, m]
                obstacle[w, k, m] += period * obstacle_velocity[w, k, m]
                after[w, k, m] = obstacle[w, k, m]
        # Yaws stay near those that drones have, so that a drone that turns slowly is not overtaken
        for i in range(yaw_rate.shape[1]):
            if yaw_rate[w, i] != 0.0:
                present = heading(quat4(quaternion, w, i))
                lead = half_turn(setpoint[w, i, 3] + period * yaw_rate[w, i] - present)
                lead = min(max(lead, -MAX_LEAD), MAX_LEAD)
                setpoint[w, i, 3] = half_turn(present + lead)


@kernel
def finish(
    steps: np.ndarray, hz: float, time: np.ndarray, force: np.ndarray, torque: np.ndarray
) -> None:
    """Count a step of an airspace, and end the forces that were applied in it.

    Args:
        steps: (W,) steps before, counted.
        hz: Steps a second.
        time: (W,) written, s.
        force: (W, N, 3) N, cleared.
        torque: (W, N, 3) N m, cleared.
    """
    for w in range(steps.shape[0]):
        # A division each time, as sums of a period drift
        steps[w] += 1
        time[w] = steps[w] / hz
        for i in range(force.shape[1]):
            for k in range(3):
                force[w, i, k] = 0.0
                torque[w, i, k] = 0.0


class MoveAndTurn(Stage):
    """Move obstacles, and turn the yaw setpoints of drones that were commanded a yaw rate."""

    name = "move and turn"
    reads = ("swarm.quaternion", "setpoint", "yaw_rate", "obstacle", "obstacle_velocity")
    writes = ("setpoint", "obstacle", "dynamics")

    def add_to(self, program: Program, worlds: AirspaceWorld) -> None:
        """Add the calls; see `Stage`."""
        state, contact = worlds.state, worlds.dynamics.contact
        turning = (state.swarm.quaternion, state.setpoint, state.yaw_rate)
        obstacles = (state.obstacle, state.obstacle_velocity, contact.before, contact.after)
        program.call(prepare, *turning, 1 / worlds.options.decision_hz, *obstacles)


class FlyCommands(Stage):
    """Fly all substeps (controllers, forces, contacts) of the setpoints that drones hold."""

    name = "fly"
    reads = ("setpoint", "levels", "wind", "alive", "obstacle", "swarm", "dynamics")
    writes = ("swarm", "dynamics", "engine")

    def add_to(self, program: Program, worlds: AirspaceWorld) -> None:
        """Add the calls; see `Stage`."""
        state = worlds.state
        setpoints = Setpoints(state.levels, state.setpoint)
        worlds.dynamics.add_to(program, state.swarm, state.alive, setpoints, state.wind)
        add_obstacles(program, worlds.engine, state.obstacle)


class CountStep(Stage):
    """Count the step, and end the forces that were applied in it."""

    name = "count"
    reads = ("steps",)
    writes = ("steps", "time", "dynamics")

    def add_to(self, program: Program, worlds: AirspaceWorld) -> None:
        """Add the calls; see `Stage`."""
        state, pushes = worlds.state, (worlds.dynamics.force, worlds.dynamics.torque)
        hz = float(worlds.options.decision_hz)
        program.call(finish, state.steps, hz, state.time, *pushes)


class MeasureAll(Stage):
    """Measure with all sensors that drones carry."""

    name = "sense"
    reads = ("before", "swarm", "alive", "steps", "rng")
    writes = ("readings", "before")

    def add_to(self, program: Program, worlds: AirspaceWorld) -> None:
        """Add the calls; see `Stage`."""
        if worlds.sensors.sensors:
            program.callback(worlds.measure)


class ShowLive(Stage):
    """Update the live window, with `render_mode` "human"."""

    name = "show"
    reads = ("swarm", "alive", "engine")
    writes = ("engine",)

    def add_to(self, program: Program, worlds: AirspaceWorld) -> None:
        """Add the calls; see `Stage`."""
        if worlds.options.render_mode == "human":
            program.callback(worlds.show_live)
