"""Energy of flight: the power that drones take, and the charge left in their batteries."""

import math

import numpy as np

from bulletuav.envs.options import EnvOptions
from bulletuav.vehicle.battery import Battery
from bulletuav.vehicle.power import ROTARY_WING, actuator_power, airframe_wing, propulsion
from bulletuav.vehicle.swarm import Swarm


class Energy:
    """Power of all drones, and the batteries that give it.

    With the option `energy` "zeng" power follows from the rotary-wing formula, at the velocity
    relative to the air. With "actuator", and always without gravity, it is that of the simulated
    rotors.

    Attributes:
        power: (W, N) mean power over the last decision, W.
    """

    def __init__(self, options: EnvOptions, parameters: np.ndarray) -> None:
        """Start with full batteries.

        Args:
            options: Options of the environment.
            parameters: (W, N) rows of `PARAMETERS` with which the dynamics flies.
        """
        self.power = np.zeros(parameters.shape)
        self._battery = Battery(parameters.shape, options.battery_capacity or math.inf)
        self._parameters = parameters
        self._period = 1 / options.decision_hz
        self._wings: np.ndarray | None = None
        # The rotary-wing formula knows power by the weight that is carried, so it needs gravity.
        if options.energy == "zeng" and options.gravity > 0:
            wings = [airframe_wing(airframe, options.gravity) for airframe in options.airframe]
            self._wings = np.array([wings] * len(parameters), dtype=ROTARY_WING)

    def start(self, worlds: np.ndarray) -> None:
        """Begin episodes of worlds (S,) with full batteries."""
        self._battery.start(worlds)
        self.power[worlds] = 0

    def spend(
        self,
        before: Swarm,
        after: Swarm,
        wind: np.ndarray,
        payload: np.ndarray | float,
        flown: np.ndarray,
    ) -> None:
        """Take from the batteries what a decision cost.

        Args:
            before: State before the decision.
            after: State after it.
            wind: (W, N, 3) wind during it, m/s.
            payload: Power that equipment takes beside flight, W: one number, or (W, N).
            flown: (W, N) bool, drones that flew it; only their batteries are drained.
        """
        if self._wings is None:
            power = actuator_power(before.rotor_speed, after.rotor_speed, self._parameters)
        else:
            mean_velocity = (before.velocity + after.velocity) / 2
            power = propulsion(mean_velocity - wind, self._wings)
        self.power = np.where(flown, power + payload, 0.0)
        self._battery.drain(self.power, self._period, flown)

    def readings(self) -> dict[str, np.ndarray]:
        """Return what drones know of their energy now.

        Returns:
            "charge", share of the energy that is left, and "power", W; copies, (W, N) each.
        """
        return {
            "charge": self._battery.charge.copy(),
            "power": self.power.copy(),
        }
