"""What flying costs: the power that drones take, and what is left in their batteries."""

import math

import numpy as np

from bulletuav.envs.options import EnvOptions
from bulletuav.vehicle.battery import Battery
from bulletuav.vehicle.power import ROTARY_WING, actuator_power, airframe_wing, propulsion
from bulletuav.vehicle.swarm import Swarm


class Energy:
    """Power (W, N) W, mean over the last decision, and the batteries that give it.

    By `energy` "zeng", of the rotary-wing formula at the velocity relative to the air; by "actuator", and
    without gravity, of the simulated rotors.
    """

    def __init__(self, options: EnvOptions, parameters: np.ndarray):
        """`parameters` (W, N): the rows that the dynamics flies with."""
        self.power = np.zeros(parameters.shape)
        self._battery = Battery(parameters.shape, options.battery_capacity or math.inf)
        self._parameters, self._period = parameters, 1 / options.decision_hz
        rotary_wing = (
            options.energy == "zeng" and options.gravity > 0
        )  # which knows power by the weight that it carries
        wings = [
            airframe_wing(airframe, options.gravity) for airframe in options.airframe if rotary_wing
        ]
        self._wings = np.array([wings] * len(parameters), dtype=ROTARY_WING) if wings else None

    def start(self, k: int) -> None:
        """World k begins, its batteries full."""
        self._battery.start(k)
        self.power[k] = 0

    def spend(
        self,
        before: Swarm,
        after: Swarm,
        wind: np.ndarray,
        payload: np.ndarray | float,
        flown: np.ndarray,
    ) -> None:
        """Take from the drones of `flown` (W, N) what a decision from `before` to `after` in `wind` (W, N, 3) m/s cost.

        `payload`: what their equipment takes beside flight, W.
        """
        if self._wings is None:
            power = actuator_power(before.rotor_speed, after.rotor_speed, self._parameters)
        else:
            power = propulsion((before.velocity + after.velocity) / 2 - wind, self._wings)
        self.power = np.where(flown, power + payload, 0.0)
        self._battery.drain(self.power, self._period, flown)

    def readings(self) -> dict[str, np.ndarray]:
        """(W, N) "charge", the share that is left, and "power", as they are now."""
        return {"charge": self._battery.charge.copy(), "power": self.power.copy()}
