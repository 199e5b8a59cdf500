"""Error for policies that read something that the task does not provide."""

import contextlib
from collections.abc import Iterator

from bulletuav.envs.aviary import Aviary
from bulletuav.errors import shown


@contextlib.contextmanager
def naming_task(policy: object, aviary: Aviary) -> Iterator[None]:
    """Convert lookup errors of a policy to a ValueError that names the task.

    Args:
        policy: The policy that is constructed or called in the context, or its name.
        aviary: The worlds that it controls.

    Raises:
        ValueError: If the policy reads a name or an attribute that the task does not have.
    """
    # The name of a trained policy is known to its PolicySpec only
    name = policy if isinstance(policy, str) else getattr(policy, "name", type(policy).__name__)
    try:
        yield
    except KeyError as error:
        lacks = f"{shown(error.args[0])}, which does not exist" if error.args else "a missing name"
        raise _of_another_task(name, lacks, aviary) from error
    except AttributeError as error:
        # Any other AttributeError is a bug of the policy
        if error.obj is not aviary.task and error.obj is not aviary.task.config:
            raise
        lacks = f"attribute {error.name!r} of the task, which it does not have"
        raise _of_another_task(name, lacks, aviary) from error


def _of_another_task(name: str, lacks: str, aviary: Aviary) -> ValueError:
    kinds = aviary.observer.kinds
    observed = dict.fromkeys(name for one in kinds for name in (*one.slices, *one.images))
    keeps = f", and keeps {', '.join(aviary.scene.memory)} in memory" if aviary.scene.memory else ""
    return ValueError(
        f"policy {name!r} needs {lacks}: task {aviary.task.name!r} observes "
        f"{', '.join(observed)}{keeps}; use the task for which the policy was made, or set "
        f"options such as observation and sensors"
    )
