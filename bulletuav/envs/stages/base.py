"""What a stage of a decision is."""

import inspect
from abc import ABC, abstractmethod
from typing import ClassVar

from bulletuav.compiled.program import Program
from bulletuav.envs.worlds import Worlds


class Stage(ABC):
    """One step of a decision, for all worlds: calls of compiled functions, or of Python.

    Attributes:
        name: Its name, unique in a simulation.
        reads: Names of the arrays that it reads: of `State.named`, or of a part of `Worlds` for all
            that it holds: "dynamics", "energy", "engine", "readings", "account", "results", "rng".
        writes: Names of the arrays that it writes. What it reads and writes is named in both.
    """

    name: ClassVar[str]
    reads: ClassVar[tuple[str, ...]]
    writes: ClassVar[tuple[str, ...]]

    @abstractmethod
    def add_to(self, program: Program, worlds: Worlds) -> None:
        """Add the calls of the stage to a program.

        Args:
            program: Compiled calls, and calls of Python, in their order.
            worlds: What they work on; arrays are written in place.
        """

    @property
    def summary(self) -> str:
        """First line of the class's docstring."""
        return inspect.cleandoc(type(self).__doc__ or "").partition("\n")[0]
