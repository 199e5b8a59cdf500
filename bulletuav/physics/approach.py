"""How close two points come that both move straight."""

from bulletuav.kernel import kernel


@kernel
def offset(position, w, i, j):
    """From point i to point j of world w of `position` (W, N, 3), as a tuple."""
    return (
        position[w, j, 0] - position[w, i, 0],
        position[w, j, 1] - position[w, i, 1],
        position[w, j, 2] - position[w, i, 2],
    )


@kernel
def closest_squared(gap, change):
    """Squared distance at the start, and least, of two points whose offset moves straight from `gap` to `gap + change`."""
    along = square = start = 0.0
    for k in range(3):
        along += gap[k] * change[k]
        square += change[k] * change[k]
        start += gap[k] * gap[k]
    least = start
    if along < 0.0:
        time = min(1.0, -along / square)
        least = max(0.0, start + 2.0 * time * along + time * time * square)
    return start, least
