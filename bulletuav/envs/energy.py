"""Energy of flight: the power that drones take, and the charge left in their batteries."""

import math

import numpy as np

from bulletuav.envs.options import EnvOptions
from bulletuav.kernel import kernel
from bulletuav.program import Program
from bulletuav.vehicle.battery import Battery, drain
from bulletuav.vehicle.power import (
    ROTARY_WING,
    airframe_wing,
    fill_actuator_power,
    propulsion_power,
)
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

    def add_to(
        self,
        program: Program,
        before: Swarm,
        after: Swarm,
        wind: np.ndarray,
        payload: np.ndarray,
        flown: np.ndarray,
    ) -> None:
        """Add to a program that batteries give what a decision takes.

        Args:
            program: To be added to.
            before: State before the decision.
            after: State after it.
            wind: (W, N, 3) wind during it, m/s.
            payload: (W, N) power that equipment takes beside flight, W.
            flown: (W, N) bool, drones that flew it; only their batteries are drained.
        """
        if self._wings is None:
            speeds = (before.rotor_speed, after.rotor_speed)
            program.call(fill_actuator_power, *speeds, self._parameters, self.power)
        else:
            velocities = (before.velocity, after.velocity, wind)
            program.call(_fill_propulsion, *velocities, self._wings, self.power)
        program.call(_add_payload, payload, flown, self.power)
        battery = self._battery
        program.call(drain, self.power, self._period, flown, battery.energy, battery.charge)

    def readings(self) -> dict[str, np.ndarray]:
        """Return what drones know of their energy.

        Returns:
            "charge", share of the energy that is left, and "power", W: (W, N) each, which are
            written anew in each decision.
        """
        return {"charge": self._battery.charge, "power": self.power}


@kernel
def _fill_propulsion(
    before: np.ndarray, after: np.ndarray, wind: np.ndarray, wings: np.ndarray, power: np.ndarray
) -> None:
    """Write the power (W, N) at the mean of two velocities (W, N, 3) through the air, W."""
    for w in range(power.shape[0]):
        for i in range(power.shape[1]):
            velocity = (
                (before[w, i, 0] + after[w, i, 0]) / 2 - wind[w, i, 0],
                (before[w, i, 1] + after[w, i, 1]) / 2 - wind[w, i, 1],
                (before[w, i, 2] + after[w, i, 2]) / 2 - wind[w, i, 2],
            )
            power[w, i] = propulsion_power(velocity, wings[w, i])


@kernel
def _add_payload(payload: np.ndarray, flown: np.ndarray, power: np.ndarray) -> None:
    """Add the payload to the power (W, N) of who flew; that of others becomes 0."""
    for w in range(power.shape[0]):
        for i in range(power.shape[1]):
            power[w, i] = power[w, i] + payload[w, i] if flown[w, i] else 0.0
