"""Base class of stages, and functions on lists of stages."""

import inspect
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from typing import Any, ClassVar

from bulletuav.compiled.program import Program
from bulletuav.errors import unknown

COMPONENTS = ("dynamics", "energy", "engine", "readings", "account", "results", "rng")
"""Names that stages declare for all arrays of a component of `Worlds`"""


class Stage(ABC):
    """One step of a decision, for all worlds: calls of compiled functions, or of Python.

    Attributes:
        name: Name of the stage, unique in a simulation.
        reads: Names of the arrays that the stage reads: names of `State.named`, or one of
            `COMPONENTS`.
        writes: Names of the arrays that the stage writes. Arrays that it reads and writes are in
            both.
    """

    name: ClassVar[str]
    reads: ClassVar[tuple[str, ...]]
    writes: ClassVar[tuple[str, ...]]

    @abstractmethod
    def add_to(self, program: Program, worlds: Any) -> None:
        """Add the calls of the stage to a program.

        Args:
            program: Compiled calls and Python callbacks, in their order.
            worlds: Data of the calls: `Worlds`, or the `AirspaceWorld` of an airspace. Arrays are
                written in place.
        """

    @property
    def summary(self) -> str:
        """First line of the class's docstring."""
        return inspect.cleandoc(type(self).__doc__ or "").partition("\n")[0]


def insert_stage(
    stages: Sequence[Stage],
    stage: Stage,
    arrays: Iterable[str],
    after: str | None,
    before: str | None,
) -> tuple[Stage, ...]:
    """Return the stages with one more.

    Args:
        stages: The stages.
        stage: The new stage.
        arrays: Names of all arrays, `State.named`.
        after: Name of the stage that it follows; or
        before: name of the stage that it precedes.

    Raises:
        ValueError: If none or both of these are given, there is no such stage, the name of the new
            stage is in use, or it declares an unknown array.
    """
    known = {*arrays, *COMPONENTS}.union(*((*one.reads, *one.writes) for one in stages))
    for array in (*stage.reads, *stage.writes):
        if array not in known:
            raise unknown(f"array of stage {stage.name!r}", array, known)
    names = [one.name for one in stages]
    if stage.name in names:
        raise ValueError(f"stage {stage.name!r} exists already: choose another name")
    if (after is None) == (before is None):
        raise ValueError(
            f"after is {after!r} and before is {before!r}: exactly one of them is needed, the name "
            f"of the stage that {stage.name!r} follows or precedes"
        )
    side, name = ("after", after) if before is None else ("before", before)
    if name not in names:
        raise ValueError(f"{side} is {name!r}: one of {', '.join(names)} is needed")
    place = names.index(name) + (side == "after")
    return (*stages[:place], stage, *stages[place:])


def format_stages(stages: Sequence[Stage]) -> str:
    """Return a table of stages: the arrays that each reads and writes, and its summary."""
    heads = ("stage", "reads", "writes")
    rows = [(one.name, ", ".join(one.reads), ", ".join(one.writes)) for one in stages]
    widths = [max(map(len, column)) for column in zip(heads, *rows, strict=True)]
    texts = ["what it does", *(one.summary for one in stages)]
    return "\n".join(
        "  ".join([*map(str.ljust, row, widths), text])
        for row, text in zip([heads, *rows], texts, strict=True)
    )


def stage_programs_of(stages: Sequence[Stage], worlds: Any) -> dict[str, Program]:
    """Make a program of each stage alone, by its name."""
    programs = {stage.name: Program() for stage in stages}
    for stage in stages:
        stage.add_to(programs[stage.name], worlds)
        programs[stage.name].compile()
    return programs
