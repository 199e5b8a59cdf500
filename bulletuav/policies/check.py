"""A check for authors of policies: fly one briefly and look for mistakes."""

from typing import Any

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.errors import shown
from bulletuav.policies.find import find_policy
from bulletuav.policies.mismatch import naming_task
from bulletuav.tasks import TaskSource

DECISIONS = 30
SAVED = 13
"""Decision before which the flight is saved"""
NUM_WORLDS = 3
SEED = 1


def check_policy(policy: Any, task: TaskSource = "crossing", **options: Any) -> None:
    """Look for mistakes of a policy's author: shapes, numbers, seeds, memory, others' state.

    Args:
        policy: A name, `module:Name`, or its class.
        task: That it flies.
        **options: Of the environment; its action is one that the policy can give unless told.

    Raises:
        ValueError: A mistake was found; the message tells what and how to mend it.
    """
    # An action that the policy gives, unless another is asked for
    spec = find_policy(policy, task)
    usual = {"action": spec.actions[0]} if spec.actions else {}
    given = {**usual, **options}
    # Twice the same flight
    one = _flown(policy, task, given)
    k = _first_difference(one, _flown(policy, task, given))
    if k is not None:
        raise ValueError(
            f"policy {spec.name!r} acts differently at decision {k} of two flights from the "
            f"same seed: draw from generators that are seeded at a reset"
        )
    if given.get("contacts") == "bullet":  # of which there are no snapshots
        return
    # The same flight again, where another pilot takes over half-way
    k = _first_difference(one, _flown(policy, task, given, anew=True))
    if k is not None:
        raise ValueError(
            f"policy {spec.name!r} acts differently at decision {k} where another one went on "
            f"with its memory at {SAVED}: name all that it remembers in `remembers`"
        )


def _first_difference(one: list[np.ndarray], other: list[np.ndarray]) -> int | None:
    """Find the first decision at which two flights differ."""
    pairs = enumerate(zip(one, other, strict=True))
    return next((k for k, (mine, theirs) in pairs if not np.array_equal(mine, theirs)), None)


def _flown(
    policy: Any, task: TaskSource, options: dict[str, Any], anew: bool = False
) -> list[np.ndarray]:
    """Fly from one seed; list the actions. With `anew` another policy goes on with the memory."""
    spec = find_policy(policy, task)
    aviary = Aviary(task, NUM_WORLDS, **{"seed": SEED, **options})
    try:
        observations = aviary.reset()
        # A reset of all worlds, as trainers and evaluations do it
        with naming_task(spec.name, aviary):
            pilot = spec(aviary)
            pilot.reset(np.ones(NUM_WORLDS, dtype=bool))
        shape = (*aviary.alive.shape, aviary.action.low.shape[-1])
        rows = []
        for k in range(DECISIONS):
            if k == SAVED and options.get("contacts") != "bullet":
                # All flights go on from the snapshot, so that they differ by the pilot alone
                snapshot, memory = aviary.save_state(), pilot.memory()
                if anew:
                    pilot = spec(aviary)
                    pilot.reset(np.ones(NUM_WORLDS, dtype=bool))
                    pilot.restore(memory)
                observations = aviary.load_state(snapshot)
            # Other policies of the swarm see the same arrays
            before = [array.copy() for array in aviary.swarm]
            with naming_task(spec.name, aviary):
                actions = pilot.act(observations, aviary.swarm)
            _check(spec.name, actions, shape)
            if not all(map(np.array_equal, before, aviary.swarm)):
                raise ValueError(
                    f"policy {spec.name!r} changes the swarm that it is shown: work on a copy"
                )
            rows.append(np.array(actions, dtype=float))
            observations = aviary.step(actions).observations
    finally:
        aviary.close()
    return rows


def _check(name: str, actions: Any, shape: tuple[int, ...]) -> None:
    """Refuse actions of another shape, or numbers that are none."""
    if not isinstance(actions, np.ndarray) or actions.shape != shape:
        form = f"an array {actions.shape}" if isinstance(actions, np.ndarray) else shown(actions)
        raise ValueError(f"act of policy {name!r} gave {form}: an array {shape} is needed")
    if not np.isfinite(actions).all():
        raise ValueError(f"act of policy {name!r} gave {shown(actions)}: finite numbers are needed")
