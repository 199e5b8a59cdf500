"""Connected components of graphs."""

import numpy as np

from bulletuav.compiled.kernel import kernel


@kernel
def connect_components(part: np.ndarray, edges: np.ndarray) -> None:
    """Compute connected components by union-find.

    Each node gets the minimum index in its component. SciPy has the same algorithm, but takes a
    quarter of a second to import.

    Args:
        part: (S,) index of each node, overwritten by the component.
        edges: (E, 2) int, the nodes of each edge.
    """
    # Each node points to a lower index, roots point to themselves
    for e in range(edges.shape[0]):
        one, two = edges[e, 0], edges[e, 1]
        while part[one] != one:
            part[one] = part[part[one]]  # path halving
            one = part[one]
        while part[two] != two:
            part[two] = part[part[two]]
            two = part[two]
        part[max(one, two)] = min(one, two)
    for k in range(part.shape[0]):
        part[k] = part[part[k]]  # lower nodes already point to their root
