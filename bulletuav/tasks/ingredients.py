"""Reward terms, end conditions and observation blocks as functions with named arguments.

Ingredients are functions decorated with @reward, @end or @block. The names of a function's
arguments select its inputs. A per-drone function, whose inputs are those of one drone, is compiled
and called for every drone:

    @reward
    def progress(distance_before, distance):
        return distance_before - distance

A function with the argument `frame` processes all drones of all worlds at once, as NumPy arrays (W,
N, ...):

    def smoothness(frame):
        return -np.abs(frame.action).max(axis=-1)

Argument names are fields of a frame (`tasks.frame.FIELDS`), readings of sensors, the task's memory
and quantities, and numbers of its config and context. With the prefix `all_`, a name selects the
array of all drones of the world. `i` is the drone's index, and `out` is an output array.
"""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from types import FunctionType, MappingProxyType
from typing import Any, NamedTuple, TypeVar

import numpy as np

from bulletuav.errors import shown, suggest_names
from bulletuav.registry import find
from bulletuav.sensors.base import Label
from bulletuav.tasks.frame import FIELDS, Frame
from bulletuav.tasks.loops import TUPLES, Form, make_loop

Ingredient = TypeVar("Ingredient", bound=Callable[..., Any])
ALL = "all_"
WHOLE = "frame"
"""Argument of functions that process all drones at once"""
FORMER_NAMES = {
    "way": "remaining_distance",
    "way_before": "remaining_distance_before",
    "first_way": "initial_distance",
}
"""Present name of each renamed argument, for messages"""
PRESENT = "present"
"""Argument of blocks: whether each drone is active after the decision"""


def reward(function: Ingredient) -> Ingredient:
    """Mark a per-drone function as a reward term; the function itself is unchanged.

    The term is reported, weighted or unweighted, by the function's name. An undecorated function of
    `frame` that returns (W, N) is a reward term, too.
    """
    return _mark(function, "reward")


def end(function: Ingredient) -> Ingredient:
    """Mark a function as an end or success condition: it returns True where the condition holds."""
    return _mark(function, "end")


def block(
    labels: Callable[[Any], tuple[Label, ...]] | tuple[Label, ...] | list[Label],
) -> Callable[[Ingredient], Ingredient]:
    """Return a decorator that marks a function as an observation block.

    Args:
        labels: One `Label` per feature of the block, or a function of the task that returns them.

    Returns:
        The decorator. The function returns a number for one label, a tuple of one number per label,
        or writes them to its argument `out`. A function of `frame` returns an array (W, N, labels).
    """

    def decorated(function: Ingredient) -> Ingredient:
        if not isinstance(function, FunctionType):
            raise TypeError(
                f"@block is for functions, and {shown(function)} is none; its labels are "
                f"{shown(labels)}: write @block([Label(...)]) above the function"
            )
        function.labels = labels if callable(labels) else lambda task: tuple(labels)  # type: ignore[attr-defined]
        return _mark(function, "block")

    return decorated


def _mark(function: Ingredient, kind: str) -> Ingredient:
    if not isinstance(function, FunctionType):
        raise TypeError(f"@{kind} is for functions, and {shown(function)} is none")
    function.ingredient = kind  # type: ignore[attr-defined]
    return function


class ArgumentSource(NamedTuple):
    """Source of an ingredient's argument.

    Attributes:
        read: Function of a frame that returns an array or a number.
        whole_world: Whether the function receives the array of the whole world.
        is_persistent: Whether `read` returns the same array in every decision of an environment.
    """

    read: Callable[[Frame], Any]
    whole_world: bool = False
    is_persistent: bool = True


@dataclass(frozen=True)
class Binding:
    """Sources of the argument names of a task's ingredients, in addition to fields of a frame.

    Attributes:
        task: Name of the task, for messages.
        readings: Names of sensors' readings.
        memory: Names of the task's arrays.
        quantities: Functions of a frame, or numbers, by name; see `Task.quantities`.
        events: Names of the arrays that the task writes to `Frame.derived`.
        numbers: Numbers of the task's config and context, by name.
    """

    task: str
    readings: frozenset[str]
    memory: frozenset[str]
    quantities: Mapping[str, Any]
    events: frozenset[str]
    numbers: Mapping[str, Any]

    def __post_init__(self) -> None:
        """Check that names are unique.

        Raises:
            ValueError: If a name is both a memory array and a quantity.
        """
        for name in sorted(self.memory & set(self.quantities)):
            raise ValueError(
                f"{name!r} is an array in memory and a quantity of task {self.task!r}: rename one"
            )

    def source(self, name: str, title: str) -> ArgumentSource:
        """Return the source of an argument.

        Args:
            name: Name of the argument.
            title: Name of the ingredient in messages.

        Raises:
            ValueError: If the name is unknown; the message suggests similar names.
        """
        whole_world = name.startswith(ALL)
        key = name.removeprefix(ALL)
        if key in (PRESENT, *self.events):
            return ArgumentSource(lambda frame: frame.derived[key], whole_world, key == PRESENT)
        # The task's names take precedence over fields of the frame
        if key in self.quantities:
            quantity = self.quantities[key]
            if not callable(quantity):
                return ArgumentSource(lambda frame: quantity)
            return ArgumentSource(quantity, whole_world, is_persistent=False)
        if key in FIELDS:
            # A property that is computed in each decision
            return ArgumentSource(FIELDS[key][1], whole_world, is_persistent=key != "depleted")
        if key in self.readings:
            return ArgumentSource(lambda frame: frame.readings[key], whole_world)
        if key in self.memory:
            return ArgumentSource(lambda frame: frame.scene.memory[key], whole_world)
        if name in self.numbers:
            number = self.numbers[name]
            return ArgumentSource(lambda frame: number)
        known = {*FIELDS, *self.readings, *self.memory, *self.quantities, *self.events}
        choices = {*known, *(ALL + one for one in known), *self.numbers, "i", "out", PRESENT, WHOLE}
        present = (ALL if whole_world else "") + FORMER_NAMES.get(key, key)
        raise ValueError(
            f"{title} of task {self.task!r} asks for {name!r}, which is no field, reading, memory "
            f"or number of the task: {suggest_names(present, choices)}"
        )


Run = Callable[[Frame, np.ndarray], None]


def _join_readers(loop: Callable[..., None], readers: list[Callable[[Frame], Any]]) -> Run:
    """Join a loop with the readers of its arguments; one or two arguments avoid building a list."""
    if len(readers) == 1:
        (one,) = readers
        return lambda frame, out: loop(one(frame), out)
    if len(readers) == 2:
        one, two = readers
        return lambda frame, out: loop(one(frame), two(frame), out)
    return lambda frame, out: loop(*[read(frame) for read in readers], out)


class Bound:
    """An ingredient bound to a task: evaluates a frame for all drones.

    Attributes:
        whole: Whether the function processes all drones at once.
        sources: Sources of its arguments, by name.
        loop: Its compiled loop; None before the first frame, and if `whole`.
    """

    def __init__(
        self, function: Any, binding: Binding, title: str, dtype: Any, labels: int | None = None
    ) -> None:
        """Look up the sources of the function's arguments.

        Args:
            function: The ingredient.
            binding: Sources by argument name.
            title: Name of the ingredient in messages, such as "reward term 'progress'".
            dtype: NumPy dtype of the result.
            labels: Features per drone, for a block; None for one number (W, N).

        Raises:
            ValueError: If the ingredient is no function, or an argument name is unknown.
        """
        if not callable(function):
            raise ValueError(f"{title} is {shown(function)}: a function is needed")
        self._function, self._title = function, f"{title} of task {binding.task!r}"
        self._dtype, self._labels = dtype, labels
        self._names = list(inspect.signature(function).parameters)
        self.whole = WHOLE in self._names
        self.loop: Callable[..., None] | None = None
        self.sources = {
            name: binding.source(name, title)
            for name in self._names
            if name not in ("i", "out", WHOLE)
        }
        self._run: Run | None = None
        if self.whole and len(self._names) > 1:
            raise ValueError(
                f"{self._title} has arguments beside frame: {self._names}; a function of all "
                f"drones must take only frame"
            )
        if not self.whole and not isinstance(function, FunctionType):
            raise ValueError(f"{self._title} is {shown(function)}: a plain function is needed")

    def __call__(self, frame: Frame) -> np.ndarray:
        """Evaluate the ingredient for all drones.

        Args:
            frame: The decision.

        Returns:
            (W, N), or (W, N, labels) for a block.

        Raises:
            ValueError: If the function fails, or returns a wrong shape or type.
        """
        shape = frame.alive.shape
        out = np.zeros(shape if self._labels is None else (*shape, self._labels), self._dtype)
        self.fill(frame, out)
        return out

    def fill(self, frame: Frame, out: np.ndarray) -> None:
        """Evaluate the ingredient into an array of zeros; see `__call__`."""
        if self._run is None:
            self._run = self._run_first(frame, out)
            self._check_first(frame, out)
        else:
            self._run(frame, out)

    def _check_first(self, frame: Frame, out: np.ndarray) -> None:
        """Check that the features of a block are finite; rewards are checked in every decision."""
        if self._labels is not None and not np.isfinite(out[frame.alive]).all():
            raise ValueError(f"{self._title} gave {shown(out)}: finite numbers are needed")

    def _run_first(self, frame: Frame, out: np.ndarray) -> Run:
        """Evaluate the first frame, and return the function that evaluates the next ones.

        A function that adds to `out` must run exactly once.
        """
        if self.whole:

            def run(frame: Frame, out: np.ndarray) -> None:
                out[...] = self._check_result(self._function(frame), out.shape)

            run(frame, out)
            return run
        readers = [source.read for source in self.sources.values()]
        given = {name: source.read(frame) for name, source in self.sources.items()}
        self.loop = self._run_loop_first(given, out)
        return _join_readers(self.loop, readers)

    def _check_result(self, given: Any, shape: tuple[int, ...]) -> np.ndarray:
        kinds = "b" if self._dtype is bool else "fiub"
        if (
            not isinstance(given, np.ndarray)
            or given.shape != shape
            or given.dtype.kind not in kinds
        ):
            form = (
                f"an array {given.shape} of {given.dtype}"
                if isinstance(given, np.ndarray)
                else shown(given)
            )
            what = "bool" if self._dtype is bool else "numbers"
            raise ValueError(f"{self._title} gave {form}: an array {shape} of {what} is needed")
        return given

    def _run_loop_first(self, given: Mapping[str, Any], out: np.ndarray) -> Callable[..., None]:
        """Call the function once in plain Python, then compile and run its loop."""
        forms: list[tuple[str, Form]] = []
        for name in self._names:
            if name in ("i", "out"):
                forms.append((name, "index" if name == "i" else "out"))
            else:
                forms.append((name, self._form(name, given[name], out.shape)))
        self._call_once(forms, given, out)
        results = None if "out" in self._names else self._labels or 0
        loop = make_loop(self._function, forms, results)
        try:
            loop(*given.values(), out)
        except Exception as error:  # numba's errors, and those that it passes on
            raise ValueError(
                f"{self._title} cannot be compiled: {_pick_reason(error)}; write it with "
                f"plain numbers and `math`, or as a function of `frame` with NumPy"
            ) from None
        return loop

    def _form(self, name: str, value: Any, shape: tuple[int, ...]) -> Form:
        if not isinstance(value, np.ndarray):
            return "number"
        if self.sources[name].whole_world:
            return "array"
        if value.ndim == 1:
            return "world"
        if value.shape[:2] != shape[:2]:
            raise ValueError(
                f"{self._title} asks for {name!r}, an array {value.shape} without entries for "
                f"of the {shape[1]} drones: ask for {ALL + name!r}"
            )
        if value.ndim == 2:
            return "drone"
        return value.shape[2] if value.ndim == 3 and value.shape[2] in TUPLES else "drone"

    def _call_once(
        self, forms: list[tuple[str, Form]], given: Mapping[str, Any], out: np.ndarray
    ) -> None:
        """Call the function for one drone in Python, as compiled code would hide its errors."""
        buffer = np.zeros(out.shape[2:], dtype=np.float64)
        values = []
        for name, form in forms:
            if form in ("index", "out", "number"):
                values.append(0 if form == "index" else buffer if form == "out" else given[name])
            elif form in ("world", "array"):
                values.append(given[name][0])
            else:
                one = given[name][0, 0]
                values.append(tuple(one.tolist()) if isinstance(form, int) else one)
        try:
            with np.errstate(all="ignore"):
                result = self._function(*values)
        except ZeroDivisionError:
            return  # the compiled loop returns inf or NaN, as NumPy does
        except Exception as error:
            raise ValueError(f"{self._title} failed: {type(error).__name__}: {error}") from error
        if "out" in self._names:
            return
        numbers = result if isinstance(result, tuple) else (result,)
        wanted = self._labels or 1
        if self._dtype is bool and not isinstance(result, bool | np.bool_):
            raise ValueError(
                f"{self._title} gave {shown(result)}: a bool, True or False, is needed"
            )
        if len(numbers) != wanted or not all(map(_is_number, numbers)):
            raise ValueError(
                f"{self._title} gave {shown(result)}: {wanted} number{'s' * (wanted > 1)} of one "
                f"drone {'are' if wanted > 1 else 'is'} needed"
            )


class BoundTerms(NamedTuple):
    """A task's bound ingredients; reward terms by name."""

    ends: tuple[Bound, ...] = ()
    success: Bound | None = None
    terms: Mapping[str, Bound] = MappingProxyType({})
    extra: Mapping[str, Bound] = MappingProxyType({})


def _is_number(value: Any) -> bool:
    return isinstance(value, bool | int | float | np.generic)


def _pick_reason(error: Exception) -> str:
    """Return the most informative line of numba's error message."""
    lines = [line.strip() for line in str(error).splitlines()]
    candidates = [
        one for one in lines if one and not one.startswith(("During", "File", "Enable", "-", "["))
    ]
    words = ("name", "attribute", "Cannot", "No implementation", "Unknown", "determine", "type")
    useful = [one for one in candidates if any(word in one for word in words)]
    return (useful or candidates or ["numba gives no reason"])[0]


def find_term(kind: str, source: Any) -> Any:
    """Return a reward term or observation, given a function, a registered name or `module:Name`."""
    return find(kind, source, callable)


def numeric_fields(options: Any) -> dict[str, Any]:
    """Return the numeric fields of a dataclass instance, by name."""
    values = {one.name: getattr(options, one.name) for one in fields(options)}
    return {
        name: value
        for name, value in values.items()
        if isinstance(value, bool | int | float)
        or (isinstance(value, tuple) and all(isinstance(one, float) for one in value))
    }
