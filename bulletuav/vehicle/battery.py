"""Batteries: their energy, which is available at any power, and the voltage of their cells."""

import math

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.errors import numbers_of

WATT_HOUR = 3600.0
"""Joules in a watt-hour."""
VOLTS = np.array([3.27, *(3.69, 3.73, 3.77, 3.80, 3.84, 3.87, 3.95, 4.02, 4.11), 4.20])
"""Open-circuit voltage, V, of a lithium-polymer cell at charges of 0, 10 % ... 100 % (common)."""
VOLTAGE_POWER = 0.89
"""Relative change of the rotor speed at a constant command, divided by the relative change of the
voltage; fitted to Crazyflies, see docs/explanation/truth.md.
"""


@func
def resting_voltage(charge: float) -> float:
    """Return the open-circuit voltage of a lithium-polymer cell, V.

    Args:
        charge: State of charge, from 0 to 1.
    """
    place = (VOLTS.size - 1) * min(max(charge, 0.0), 1.0)
    low = min(int(place), VOLTS.size - 2)
    volts: float = VOLTS[low] + (place - low) * (VOLTS[low + 1] - VOLTS[low])
    return volts


@func
def loaded_voltage(rest: float, power: float, resistance: float) -> float:
    """Return the voltage of a battery under load: V = E - R P / V.

    Args:
        rest: Open-circuit voltage E, V.
        power: Power P drawn, W.
        resistance: Internal resistance R, ohm.

    Returns:
        The voltage, V; half of E if the battery cannot deliver the power.
    """
    return 0.5 * (rest + math.sqrt(max(rest * rest - 4.0 * power * resistance, 0.0)))


@func
def battery_speed_ratio(voltage: float, nominal: float) -> float:
    """Return the ratio of the reached to the commanded rotor speed at a battery voltage.

    Args:
        voltage: Voltage of the battery, V.
        nominal: Voltage at which the commanded speed is reached, V.
    """
    return max(1.0 + VOLTAGE_POWER * (voltage / nominal - 1.0), 0.0)


class Battery:
    """The batteries of W worlds of N drones.

    Attributes:
        charge: (W, N) state of charge, from 0 to 1; 1 until `start` sets another value.
        energy: (W, N) energy of a full battery, J.
    """

    def __init__(self, shape: tuple[int, int], capacity: float | np.ndarray) -> None:
        """Make full batteries.

        Args:
            shape: (W, N).
            capacity: Energy of each battery, W h: one number for all, (N,) or (W, N). Batteries of
                infinite capacity never become empty.

        Raises:
            ValueError: If a capacity is not greater than 0.
        """
        given = numbers_of(f"capacity is {capacity!r}:", capacity)
        if not (given > 0).all():
            raise ValueError(f"capacity is {capacity!r}: watt-hours above 0 are needed")
        self.energy = np.array(WATT_HOUR * np.broadcast_to(given, shape))
        self.charge = np.ones(shape)

    @property
    def depleted(self) -> np.ndarray:
        """Mask of the empty batteries, (W, N) bool."""
        empty: np.ndarray = self.charge <= 0
        return empty

    def start(self, k: int | np.ndarray, charge: float | np.ndarray = 1.0) -> None:
        """Set the state of charge of worlds at the start of an episode.

        Args:
            k: Index of the world, or of several.
            charge: State of charge: one number for all, or (N,).

        Raises:
            ValueError: If a charge is not greater than 0 and at most 1.
        """
        given = numbers_of(f"charge is {charge!r}:", charge)
        if not ((given > 0) & (given <= 1)).all():
            raise ValueError(f"charge is {charge!r}: a number above 0 and at most 1 is needed")
        self.charge[k] = given

    def drain(self, power: np.ndarray, seconds: float, flying: np.ndarray) -> None:
        """Draw energy from the batteries, down to empty, or charge them, up to full.

        Args:
            power: (W, N) power drawn from each battery, W; negative to charge it.
            seconds: Duration, s.
            flying: (W, N) bool, the drones whose batteries are drained.
        """
        drain_batteries(power, seconds, flying, self.energy, self.charge)


@kernel
def drain_batteries(
    power: np.ndarray, seconds: float, flying: np.ndarray, energy: np.ndarray, charge: np.ndarray
) -> None:
    """Compute `Battery.drain` on arrays: energy (W, N), J, and charge, updated in place."""
    for w in range(charge.shape[0]):
        for i in range(charge.shape[1]):
            # The power of drones that do not fly may be NaN
            if flying[w, i]:
                left = charge[w, i] - power[w, i] * seconds / energy[w, i]
                charge[w, i] = min(max(left, 0.0), 1.0)
