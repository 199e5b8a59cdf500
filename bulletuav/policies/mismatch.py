"""The error for a policy that looks for what its task does not have."""

import contextlib
from collections.abc import Iterator

from bulletuav.envs.aviary import Aviary
from bulletuav.errors import shown


@contextlib.contextmanager
def naming_task(policy: object, aviary: Aviary) -> Iterator[None]:
    """Raise ValueError, which names the task, where a policy looks for what the task lacks.

    Args:
        policy: The policy, which is made or called meanwhile, or its name.
        aviary: What it flies.

    Raises:
        ValueError: The policy looked for a name or an attribute of the task that is not there.
    """
    # Trained policies go by the name of their file, which only the message of its maker has
    name = policy if isinstance(policy, str) else getattr(policy, "name", type(policy).__name__)
    try:
        yield
    except KeyError as error:
        lacks = f"{shown(error.args[0])}, which is not there" if error.args else "a missing name"
        raise _of_another_task(name, lacks, aviary) from error
    except AttributeError as error:
        # Others are mistakes of the policy's own
        if error.obj is not aviary.task and error.obj is not aviary.task.config:
            raise
        lacks = f"attribute {error.name!r} of the task, which it does not have"
        raise _of_another_task(name, lacks, aviary) from error


def _of_another_task(name: str, lacks: str, aviary: Aviary) -> ValueError:
    """Make the error for a policy that needs what a task does not have."""
    observed = [*aviary.observer.slices, *aviary.observer.images]
    keeps = f", and keeps {', '.join(aviary.scene.memory)} in memory" if aviary.scene.memory else ""
    return ValueError(
        f"policy {name!r} needs {lacks}: task {aviary.task.name!r} observes "
        f"{', '.join(observed)}{keeps}; fly the policy in the task that it is for, or with "
        f"options such as observation and sensors"
    )
