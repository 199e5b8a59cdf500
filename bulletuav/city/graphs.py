"""Parts of graphs that hang together."""

import numpy as np

from bulletuav.compiled.kernel import kernel


@kernel
def join(part: np.ndarray, edges: np.ndarray) -> None:
    """Join nodes that edges connect: each gets the least number of a node in its part.

    SciPy does it, too, but takes a quarter of a second to import.

    Args:
        part: (S,) number of each node, written.
        edges: (E, 2) int, the nodes that each edge joins.
    """
    # Each node points to one of a lower number, until one that points to itself
    for e in range(edges.shape[0]):
        one, two = edges[e, 0], edges[e, 1]
        while part[one] != one:
            part[one] = part[part[one]]  # halves the way for those who come later
            one = part[one]
        while part[two] != two:
            part[two] = part[part[two]]
            two = part[two]
        part[max(one, two)] = min(one, two)
    for k in range(part.shape[0]):
        part[k] = part[part[k]]  # lower ones point to the least already
