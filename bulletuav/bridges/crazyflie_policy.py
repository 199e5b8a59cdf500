"""Out-of-tree controller of a virtual Crazyflie: the policy `foundation` commands its rotors."""

import functools
from collections.abc import Sequence

import numpy as np

from bulletuav.bridges.setpoints import AirspaceCommand, State
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.geometry.rotation import to_body
from bulletuav.policies.neural_network import read_weights
from bulletuav.policies.recurrent import NUM_ROTORS, AxesOfDrones, RecurrentNetwork
from bulletuav.policies.rotor_axes import find_rotor_axes
from bulletuav.policies.run import FOUNDATION, POLICY, SHIPPED
from bulletuav.vehicle.airframe import Airframe

OUT_OF_TREE = 6
"""Value of the parameter `stabilizer.controller` for out-of-tree controllers, as in the firmware"""
STEPS_PER_DECISION = 3
"""Steps of 10 ms in which rotor commands are held: 33 decisions a second, 30 in the training"""
STILL = (0.0, 0.0, 0.0)

Target = tuple[Sequence[float] | np.ndarray, Sequence[float] | np.ndarray]
"""Position (3,), m, and velocity (3,), m/s, to which a drone is to fly, world axes"""


@functools.cache
def read_network() -> RecurrentNetwork:
    """Return the network of the policy `foundation`."""
    return RecurrentNetwork(read_weights(SHIPPED / FOUNDATION / POLICY))


class FoundationController:
    """Controller of one quadrotor, from commands of position and velocity to rotor speeds.

    The policy flies to points at rest. Here it observes the offset and the velocity relative to a
    target that may move. It neither observes nor commands the heading.
    """

    def __init__(self, airframe: Airframe) -> None:
        """Find the rotor axes of the airframe.

        Args:
            airframe: Airframe of the drone.

        Raises:
            ValueError: If the policy cannot fly the airframe.
        """
        self._axes = AxesOfDrones.of([find_rotor_axes(airframe)])
        self._network = read_network()
        self._max_rotor_speed = airframe.max_rotor_speed
        self.reset()

    def reset(self) -> None:
        """Clear the hidden state and the last action."""
        self._hidden = np.zeros((1, self._network.hidden_size))
        self._action = np.zeros((1, NUM_ROTORS))
        self._num_steps = 0

    def compute_command(
        self, command: AirspaceCommand | None, target: Target | None, state: State
    ) -> AirspaceCommand | None:
        """Replace a command of position, velocity or acceleration by rotor speeds.

        Other commands, of an attitude or of rates, are returned unchanged.

        Args:
            command: Command of the usual controller; None for motors off.
            target: Target of a command of acceleration, such as a point of a trajectory.
            state: State of the drone.

        Returns:
            The command of the next step of 10 ms.
        """
        position, _, velocity, _ = state
        if command is None or command.level >= SetpointLevel.ATTITUDE:
            self.reset()
            return command
        if command.level == SetpointLevel.POSITION:
            target = command.values[:3], STILL
        elif command.level == SetpointLevel.VELOCITY:
            target = position, command.values[:3]
        if self._num_steps % STEPS_PER_DECISION == 0:
            assert target is not None  # commands of acceleration have one
            offset, speed = np.subtract(target[0], position), np.subtract(velocity, target[1])
            self._decide(offset, speed, state)
        self._num_steps += 1
        speeds = self._max_rotor_speed * np.sqrt(0.5 * (self._action[0] + 1.0))
        return AirspaceCommand(SetpointLevel.ROTOR, tuple(speeds.tolist()))

    def _decide(self, offset: np.ndarray, velocity: np.ndarray, state: State) -> None:
        """Choose the next action, by the blocks `bulletuav.policies.recurrent.BLOCKS`."""
        _, quaternion, _, rates = state
        turn = np.array(quaternion)
        vectors = [to_body(turn, one) for one in (offset, velocity, np.array([0.0, 0.0, 1.0]))]
        seen = np.concatenate([*vectors, rates, self._action[0]])
        actions, self._hidden = self._network.step(self._axes.observe(seen[None]), self._hidden)
        self._action = self._axes.command(actions)
