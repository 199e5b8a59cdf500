"""What every environment looks like to the simulation."""

from typing import Any, ClassVar

import numpy as np

from .forms import Form, pick
from .invariants import require

NUMBERS = (np.nan, np.inf, -np.inf)
OTHERS = (None, "text", [], {}, 1j, object(), [[1.0], [1.0, 2.0]])


class Face:
    """An environment in use.

    Attributes:
        form: What it was made from.
        env: The environment.
        core: Its `Aviary`; None where there is none, or where it is in other processes.
        started: Whether there was a reset.
        closed: Whether it was closed.
        snapshots: States that were saved, each with its hash.
    """

    batched: ClassVar[bool] = False

    def __init__(self, form: Form, rng: np.random.Generator) -> None:
        self.form, self.started, self.closed = form, False, False
        self.env: Any = self.make(form, rng)
        self.core: Any = getattr(self.plain, "aviary", None)
        self.snapshots: list[Any] = []

    def make(self, form: Form, rng: np.random.Generator) -> Any:
        """Make the environment."""
        raise NotImplementedError

    @property
    def plain(self) -> Any:
        """The environment without wrappers of others."""
        return self.env

    def twin(self, copy: Any) -> "Face":
        """Put a copy of the environment behind the same interface."""
        face = object.__new__(type(self))
        face.__dict__ |= {**self.__dict__, "env": copy, "started": False, "snapshots": []}
        face.core = getattr(face.plain, "aviary", None)
        return face

    def reset(self, **keywords: Any) -> Any:
        """Start new episodes."""
        value = self.env.reset(**keywords)
        self.started = True
        return value

    def act(self, rng: np.random.Generator) -> Any:
        """Draw an action that can be."""
        raise NotImplementedError

    def spoil(self, rng: np.random.Generator, action: Any) -> Any:
        """Turn an action into one that cannot be; None where all would be taken."""
        if rng.random() < 0.3:
            return pick(rng, OTHERS)
        array = np.array(action, dtype=float)
        if array.size and rng.random() < 0.6:
            array[...] = pick(rng, NUMBERS)
            return array
        return array[None] if rng.random() < 0.5 else np.append(array.ravel(), 0.0)

    def step(self, action: Any) -> Any:
        """Fly one decision."""
        return self.env.step(action)

    def is_over(self) -> bool:
        """Tell whether it needs a reset before it can fly on."""
        return False

    def check_reset(self, value: Any) -> None:
        """Raise Broken unless what `reset` gave is valid."""

    def check_step(self, value: Any, before: Any) -> None:
        """Raise Broken unless what `step` gave is valid; `before` is what `note` told."""

    def note(self) -> Any:
        """Tell what a step changes: who flies, and the counters."""
        if self.core is None:
            return None
        return self.core.alive.copy(), self.core.steps.copy()

    def check_counters(self, before: Any, fresh: np.ndarray | None = None) -> None:
        """Raise Broken unless time went on by one in worlds that flew."""
        alive, steps = before
        flew = alive.any(axis=1)
        now, still = self.core.steps, self.core.alive
        anew = np.zeros(len(flew), dtype=bool) if fresh is None else fresh
        expected = np.where(anew, 0, steps + flew)
        went = (now == expected).all()
        require(went, "steps went from {} to {} where {} flew", steps, now, flew)
        require(not (still & ~alive)[~anew].any(), "a drone came back")
        time = self.core.worlds.frame.time
        right = np.isclose(time, now / self.core.options.decision_hz)
        require(right[flew].all(), "time is {} after {} decisions", time, now)
