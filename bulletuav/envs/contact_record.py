"""Contacts of the last decision, collected on demand."""

import numpy as np

from bulletuav.dynamics.base import Dynamics
from bulletuav.vehicle.swarm import Contacts


class ContactRecord:
    """Contacts of the last decision, collected on demand as most decisions do not need them."""

    def __init__(self, dynamics: Dynamics, num_drones: int) -> None:
        """Create a record without contacts.

        Args:
            dynamics: Dynamics that reports the contacts.
            num_drones: Number of drones of a world, whose contacts are recorded.
        """
        self._dynamics, self._num_drones = dynamics, num_drones
        self._contacts: Contacts | None = Contacts.none()
        self._before: Contacts | None = None

    @property
    def is_collected(self) -> bool:
        """Whether the contacts have been collected in Python."""
        return self._contacts is not None

    def collect(self) -> Contacts:
        """Return the contacts of the last decision."""
        if self._contacts is None:
            found = self._dynamics.touched()
            own = found.drone < self._num_drones
            if not own.all():  # loads
                found = Contacts(*(column[own] for column in found))
            self._contacts = found
        return self._contacts

    def start_decision(self) -> None:
        """Clear the contacts before a decision."""
        self._before, self._contacts = self._contacts, None

    def undo_decision(self) -> None:
        """Restore the previous contacts after a decision with invalid actions."""
        self._contacts = self._before

    def add(self, contacts: Contacts) -> None:
        """Add contacts to those of the decision."""
        self._contacts = self.collect().joined(contacts)

    def keep(self, worlds: np.ndarray | None) -> None:
        """Keep the collected contacts of a mask (W,) of worlds; None clears all."""
        if worlds is None:
            self._contacts = None
        elif self._contacts is not None:
            self._contacts = self._contacts.of_worlds(worlds)
