"""Batteries that give all of their energy at any power, without losses."""

import numpy as np

from bulletuav.errors import numbers_of

WATT_HOUR = 3600.0  # J


class Battery:
    """What W worlds of N drones have left.

    charge  (W, N) share left, from 0 to 1; full until it is started otherwise
    """

    def __init__(self, shape: tuple[int, int], capacity: float | np.ndarray):
        """`capacity` W h, of all or (N,) or (W, N). Raises ValueError unless it is above 0; infinite ones never empty."""
        given = numbers_of(f"capacity is {capacity!r}:", capacity)
        if not (given > 0).all():
            raise ValueError(f"capacity is {capacity!r}: watt-hours above 0 are needed")
        self._energy = WATT_HOUR * np.broadcast_to(given, shape)
        self.charge = np.ones(shape)

    @property
    def depleted(self) -> np.ndarray:
        """(W, N) bool: which are empty."""
        return self.charge <= 0

    def start(self, k: int, charge: float | np.ndarray = 1.0) -> None:
        """World k begins with a share `charge`, of all or (N,). Raises ValueError unless it is above 0 and at most 1."""
        given = numbers_of(f"charge is {charge!r}:", charge)
        if not ((given > 0) & (given <= 1)).all():
            raise ValueError(f"charge is {charge!r}: a share above 0 and at most 1 is needed")
        self.charge[k] = given

    def drain(self, power: np.ndarray, seconds: float, flying: np.ndarray) -> None:
        """Take `power` (W, N) W, at least 0, for `seconds` from the drones of `flying` (W, N), down to 0."""
        used = np.where(flying, power * seconds / self._energy, 0.0)
        np.maximum(self.charge - used, 0.0, out=self.charge)
