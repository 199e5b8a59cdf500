"""Stages of a step of an airspace."""

import math

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.compiled.program import Program
from bulletuav.contact.moving_bodies import start_bodies
from bulletuav.control.setpoint import Setpoints
from bulletuav.envs.airspace_world import ALL, AirspaceWorld
from bulletuav.envs.parts import add_obstacles
from bulletuav.envs.stages.base import Stage
from bulletuav.geometry.rotation import heading, quat4

TURN = 2 * math.pi
"""Full turn, rad"""
MAX_YAW_LEAD = 1.0
"""Maximum angle of a turning yaw setpoint ahead of the drone, rad"""


@func
def wrap_angle(angle: float) -> float:
    """Wrap an angle to [-pi, pi), rad."""
    return angle - TURN * math.floor(angle / TURN + 0.5)


@kernel
def move_and_turn(
    quaternion: np.ndarray,
    setpoint: np.ndarray,
    yaw_rate: np.ndarray,
    period: float,
    obstacle: np.ndarray,
    obstacle_velocity: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
) -> None:
    """Move obstacles through a step, and advance turning yaw setpoints.

    Args:
        quaternion: (W, N, 4) attitudes.
        setpoint: (W, N, S) setpoints, with the yaw in the fourth column.
        yaw_rate: (W, N) rates of the yaw setpoints, rad/s.
        period: Duration of the step, s.
        obstacle: (W, K, 3) positions of obstacles before the step, m; moved to those after it.
        obstacle_velocity: (W, K, 3) m/s.
        before: (W, K, 3) positions before the step, written.
        after: (W, K, 3) positions after the step, written.
    """
    for w in range(yaw_rate.shape[0]):
        for k in range(obstacle.shape[1]):
            for m in range(3):
                before[w, k, m] = obstacle[w, k, m]
                obstacle[w, k, m] += period * obstacle_velocity[w, k, m]
                after[w, k, m] = obstacle[w, k, m]
        # Yaw setpoints stay near the yaws of drones, which may turn more slowly
        for i in range(yaw_rate.shape[1]):
            if yaw_rate[w, i] != 0.0:
                present = heading(quat4(quaternion, w, i))
                lead = wrap_angle(setpoint[w, i, 3] + period * yaw_rate[w, i] - present)
                lead = min(max(lead, -MAX_YAW_LEAD), MAX_YAW_LEAD)
                setpoint[w, i, 3] = wrap_angle(present + lead)


@kernel
def count_step(
    steps: np.ndarray, hz: float, time: np.ndarray, force: np.ndarray, torque: np.ndarray
) -> None:
    """Count a step of an airspace, and clear external forces.

    Args:
        steps: (W,) number of steps, incremented.
        hz: Steps per second.
        time: (W,) written, s.
        force: (W, N, 3) N, cleared.
        torque: (W, N, 3) N m, cleared.
    """
    for w in range(steps.shape[0]):
        # Divided each time, as a sum of periods would drift
        steps[w] += 1
        time[w] = steps[w] / hz
        for i in range(force.shape[1]):
            for k in range(3):
                force[w, i, k] = 0.0
                torque[w, i, k] = 0.0


class MoveAndTurn(Stage):
    """Move obstacles, and advance the yaw setpoints of drones with a commanded yaw rate."""

    name = "move and turn"
    reads = ("swarm.quaternion", "setpoint", "yaw_rate", "obstacle", "obstacle_velocity")
    writes = ("setpoint", "obstacle", "dynamics")

    def add_to(self, program: Program, worlds: AirspaceWorld) -> None:
        """Add the calls of the stage; see `Stage.add_to`."""
        state, contact = worlds.state, worlds.dynamics.contact
        turning = (state.swarm.quaternion, state.setpoint, state.yaw_rate)
        obstacles = (state.obstacle, state.obstacle_velocity, contact.before, contact.after)
        period = 1 / worlds.options.decision_hz
        program.call(move_and_turn, *turning, period, *obstacles)
        bodies = worlds.engine.scenery.bodies
        if len(bodies.reach):
            program.callback(worlds.follow_motions)
            program.call(start_bodies, bodies, ALL, period)


class FlyCommands(Stage):
    """Simulate all substeps (controllers, forces, contacts) with the held setpoints."""

    name = "fly"
    reads = ("setpoint", "levels", "wind", "alive", "obstacle", "swarm", "dynamics")
    writes = ("swarm", "dynamics", "engine")

    def add_to(self, program: Program, worlds: AirspaceWorld) -> None:
        """Add the calls of the stage; see `Stage.add_to`."""
        state = worlds.state
        setpoints = Setpoints(state.levels, state.setpoint)
        worlds.dynamics.add_to(program, state.swarm, state.alive, setpoints, state.wind)
        add_obstacles(program, worlds.engine, state.obstacle)


class CountStep(Stage):
    """Count the step, and clear the forces that were applied in it."""

    name = "count"
    reads = ("steps",)
    writes = ("steps", "time", "dynamics")

    def add_to(self, program: Program, worlds: AirspaceWorld) -> None:
        """Add the calls of the stage; see `Stage.add_to`."""
        state, pushes = worlds.state, (worlds.dynamics.force, worlds.dynamics.torque)
        hz = float(worlds.options.decision_hz)
        program.call(count_step, state.steps, hz, state.time, *pushes)


class MeasureAll(Stage):
    """Measure with all sensors that drones carry."""

    name = "sense"
    reads = ("before", "swarm", "alive", "steps", "rng")
    writes = ("readings", "before")

    def add_to(self, program: Program, worlds: AirspaceWorld) -> None:
        """Add the calls of the stage; see `Stage.add_to`."""
        if worlds.sensors.sensors:
            program.callback(worlds.measure)


class ShowLive(Stage):
    """Update the live window, with `render_mode` "human"."""

    name = "show"
    reads = ("swarm", "alive", "engine")
    writes = ("engine",)

    def add_to(self, program: Program, worlds: AirspaceWorld) -> None:
        """Add the calls of the stage; see `Stage.add_to`."""
        if worlds.options.render_mode == "human":
            program.callback(worlds.show_live)
