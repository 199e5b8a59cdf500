"""Check for authors of policies: fly a policy briefly and report common mistakes."""

from typing import Any

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.errors import shown
from bulletuav.policies.find import find_policy
from bulletuav.policies.mismatch import naming_task
from bulletuav.tasks import TaskSource

DECISIONS = 30
SAVED = 13
"""Decision before which a snapshot is saved"""
NUM_WORLDS = 3
SEED = 1


def check_policy(policy: Any, task: TaskSource = "crossing", **options: Any) -> None:
    """Check a policy for common mistakes.

    The check covers the shape and finiteness of actions, determinism under a fixed seed,
    completeness of `remembers`, and modification of the swarm state.

    Args:
        policy: A name, `module:Name`, or a policy class.
        task: The task to fly.
        **options: Options of the environment. The default action type is the first one that the
            policy supports.

    Raises:
        ValueError: If the policy makes a mistake; the message names the mistake and a remedy.
    """
    spec = find_policy(policy, task)
    usual = {"action": spec.actions[0]} if spec.actions else {}
    given = {**usual, **options}
    one = _fly(policy, task, given)
    k = _first_difference(one, _fly(policy, task, given))
    if k is not None:
        raise ValueError(
            f"policy {spec.name!r} acts differently at decision {k} of two flights from the "
            f"same seed: draw from generators that are seeded at a reset"
        )
    if given.get("contacts") == "bullet":  # this mode has no snapshots
        return
    # The same flight, with a new policy object that continues from the snapshot
    k = _first_difference(one, _fly(policy, task, given, replace=True))
    if k is not None:
        raise ValueError(
            f"policy {spec.name!r} acts differently at decision {k} after its state was restored "
            f"in a new object at decision {SAVED}: list all stateful attributes in `remembers`"
        )


def _first_difference(one: list[np.ndarray], other: list[np.ndarray]) -> int | None:
    """Return the index of the first decision at which two flights differ, or None."""
    pairs = enumerate(zip(one, other, strict=True))
    return next((k for k, (mine, theirs) in pairs if not np.array_equal(mine, theirs)), None)


def _fly(
    policy: Any, task: TaskSource, options: dict[str, Any], replace: bool = False
) -> list[np.ndarray]:
    """Fly with a fixed seed; return the actions. `replace`: continue in a new policy object."""
    spec = find_policy(policy, task)
    aviary = Aviary(task, NUM_WORLDS, **{"seed": SEED, **options})
    try:
        observations = aviary.reset()
        # All worlds are reset, as in training and evaluation
        with naming_task(spec.name, aviary):
            pilot = spec(aviary)
            pilot.reset(np.ones(NUM_WORLDS, dtype=bool))
        shape = (*aviary.alive.shape, aviary.action.low.shape[-1])
        rows = []
        for k in range(DECISIONS):
            if k == SAVED and options.get("contacts") != "bullet":
                # Every flight continues from the snapshot; flights differ in the policy object only
                snapshot, memory = aviary.save_state(), pilot.memory()
                if replace:
                    pilot = spec(aviary)
                    pilot.reset(np.ones(NUM_WORLDS, dtype=bool))
                    pilot.restore(memory)
                observations = aviary.load_state(snapshot)
            # Other policies share these arrays, so they must not be modified
            before = [array.copy() for array in aviary.swarm]
            with naming_task(spec.name, aviary):
                actions = pilot.act(observations, aviary.swarm)
            _check(spec.name, actions, shape)
            if not all(map(np.array_equal, before, aviary.swarm)):
                raise ValueError(
                    f"policy {spec.name!r} modifies the swarm state in place: work on a copy"
                )
            rows.append(np.array(actions, dtype=float))
            observations = aviary.step(actions).observations
    finally:
        aviary.close()
    return rows


def _check(name: str, actions: Any, shape: tuple[int, ...]) -> None:
    """Raise ValueError if the actions have the wrong shape or are not finite."""
    if not isinstance(actions, np.ndarray) or actions.shape != shape:
        form = f"an array {actions.shape}" if isinstance(actions, np.ndarray) else shown(actions)
        raise ValueError(f"act of policy {name!r} returned {form}: an array {shape} is needed")
    if not np.isfinite(actions).all():
        raise ValueError(
            f"act of policy {name!r} returned {shown(actions)}: finite numbers are needed"
        )
