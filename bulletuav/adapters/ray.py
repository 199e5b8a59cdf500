"""Distribution of work to a Ray cluster; needs the extra `ray`."""

import contextlib
import socket
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from bulletuav.errors import missing_extra, shown

try:
    import ray
    from ray.exceptions import RayTaskError
except ImportError:
    raise missing_extra("flying on a Ray cluster", "ray") from None

Item = TypeVar("Item")
Result = TypeVar("Result")
CONNECT_TIMEOUT = 5.0
"""Connection timeout, s"""
TASKS_PER_CPU = 4
"""Tasks for each CPU: a node that fails loses at most one task for each of its CPUs"""


def map_on_cluster(
    address: str, work: Callable[[Sequence[Item]], list[Result]], items: Sequence[Item]
) -> Iterator[Result]:
    """Map a function over items on a Ray cluster, and retry the tasks of nodes that fail.

    Every node needs the same version of bulletuav.

    Args:
        address: Address of the cluster, such as "auto" or "10.0.0.1:6379"; "local" starts one here.
        work: Function from a list of items to a list of results.
        items: The items.

    Yields:
        The results, in order of completion.

    Raises:
        ConnectionError: If no cluster answers.
    """
    with _cluster(address):
        # Several tasks for each CPU balance the load
        processors = int(ray.cluster_resources().get("CPU", 1))
        size = max(1, len(items) // (TASKS_PER_CPU * max(1, processors)))
        parts = [items[first : first + size] for first in range(0, len(items), size)]

        def done_by_one(part: Sequence[Item]) -> list[Result]:
            return work(part)

        # max_retries=-1: tasks of failed nodes are retried without limit
        task: Any = ray.remote(done_by_one).options(num_cpus=1, max_retries=-1)
        waiting = [task.remote(part) for part in parts]
        while waiting:
            # In order of completion; an error is raised as in a local call
            done, waiting = ray.wait(waiting)
            try:
                yield from ray.get(done[0])
            except RayTaskError as error:
                raise error.cause from None


@contextlib.contextmanager
def _cluster(address: str) -> Iterator[None]:
    """Connect to a cluster, and disconnect at the end unless the caller had connected."""
    if ray.is_initialized():
        yield
        return
    # Ray itself waits for minutes if nothing answers
    try:
        _require_connection(address)
        ray.init(address=address, log_to_driver=False, logging_level="error")
    except (OSError, ValueError, RuntimeError) as error:
        raise ConnectionError(
            f"no Ray cluster answers at {shown(address)} ({str(error).splitlines()[0]}): start one "
            f"with `ray start --head`, or use --ray local"
        ) from None
    try:
        yield
    finally:
        ray.shutdown()


def _require_connection(address: str) -> None:
    """Raise OSError if HOST:PORT accepts no connection; Ray itself waits for minutes."""
    host, colon, port = address.rpartition(":")
    if colon and port.isdecimal() and "/" not in host:
        socket.create_connection((host, int(port)), CONNECT_TIMEOUT).close()
