"""Work on the machines of a Ray cluster; needs the extra `ray`."""

import contextlib
import socket
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from bulletuav.errors import missing, shown

try:
    import ray
    from ray.exceptions import RayTaskError
except ImportError:
    raise missing("flying on a Ray cluster", "ray") from None

Item = TypeVar("Item")
Result = TypeVar("Result")
PATIENCE = 5.0
"""Time for a cluster to answer, s"""
PARTS = 4
"""Parts of the work for each processor: a node that dies costs at most one of each of its own"""


def spread(
    address: str, work: Callable[[Sequence[Item]], list[Result]], items: Sequence[Item]
) -> Iterator[Result]:
    """Let the nodes of a cluster do some work; what a node that dies had begun, others do again.

    Every node needs bulletuav, in the same version.

    Args:
        address: Where the cluster is, such as "auto" or "10.0.0.1:6379"; "local" begins one here.
        work: Makes a list of results of a list of items.
        items: What is to be done.

    Yields:
        The results, as they come.

    Raises:
        ConnectionError: No cluster answers.
    """
    with _cluster(address):
        # Several parts a processor, so that none waits long for the last
        processors = int(ray.cluster_resources().get("CPU", 1))
        size = max(1, len(items) // (PARTS * max(1, processors)))
        parts = [items[first : first + size] for first in range(0, len(items), size)]

        def done_by_one(part: Sequence[Item]) -> list[Result]:
            return work(part)

        # Parts of a node that died are done again, however often
        task: Any = ray.remote(done_by_one).options(num_cpus=1, max_retries=-1)
        waiting = [task.remote(part) for part in parts]
        while waiting:
            # As they come; an error is told as if it had happened here
            done, waiting = ray.wait(waiting)
            try:
                yield from ray.get(done[0])
            except RayTaskError as error:
                raise error.cause from None


@contextlib.contextmanager
def _cluster(address: str) -> Iterator[None]:
    """Join a cluster, and leave it in the end; one that the caller has joined stays."""
    # Who has joined by hand also leaves by hand
    if ray.is_initialized():
        yield
        return
    # Ray would wait for minutes where nobody answers
    try:
        _require_answer(address)
        ray.init(address=address, log_to_driver=False, logging_level="error")
    except (OSError, ValueError, RuntimeError) as error:
        raise ConnectionError(
            f"no Ray cluster answers at {shown(address)} ({str(error).splitlines()[0]}): begin one "
            f"with `ray start --head`, or say --ray local"
        ) from None
    try:
        yield
    finally:
        ray.shutdown()


def _require_answer(address: str) -> None:
    """Knock at a place HOST:PORT, as Ray itself would ask for minutes. Raises OSError."""
    host, colon, port = address.rpartition(":")
    if colon and port.isdecimal() and "/" not in host:
        socket.create_connection((host, int(port)), PATIENCE).close()
