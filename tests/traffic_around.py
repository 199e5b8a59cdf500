"""Traffic of one world with given drones, balls and buildings, for tests of avoiding policies."""

import numpy as np

from bulletuav.policies.traffic import ObstacleClearance, tabulate_buildings, true_traffic

OPEN = (np.full(3, -np.inf), np.full(3, np.inf))
TOUCH = ObstacleClearance(body=0.0, margin=0.0, max_distance=100.0)


def traffic_of(
    state, balls=(), box=OPEN, solids=None, alive=None, clear=TOUCH, far=np.inf, searched=True
):
    """Traffic of rows of position and velocity, and of balls of position, velocity and radius."""
    position, velocity = np.array(state, float).reshape(-1, 2, 3).transpose(1, 0, 2)[:, None].copy()
    ball = np.array(balls, float).reshape(-1, 7)
    shown = np.ones(position.shape[:2], bool) if alive is None else np.array([alive])
    return true_traffic(
        (position, velocity, shown),
        (np.zeros_like(position), np.zeros_like(position)),
        (ball[None, :, :3].copy(), ball[None, :, 3:6].copy(), ball[:, 6].copy()),
        tuple(np.array(corner, float) for corner in box),
        np.array([-1 if solids is None else 0]),
        tabulate_buildings(() if solids is None else (solids,)),
        clear,
        far,
        searched,
    )


def velocities(choose, state, rules, **around):
    """Velocities (N, 3) that a policy chooses for rows of position, velocity and wish."""
    rows = np.array(state, float).reshape(-1, 9)
    wish = rows[None, :, 6:].copy()
    return choose(traffic_of(rows[:, :6], **around), wish, rules)[0]


def fly(choose, position, goal, rules, seconds, period=0.1):
    """Fly points at the velocities that are chosen; give the ends (N, 3) and the least distance."""
    position, goal = np.array(position, float), np.array(goal, float)
    velocity, least = np.zeros_like(position), np.inf
    for _ in range(round(seconds / period)):
        wish = goal - position
        size = np.linalg.norm(wish, axis=1, keepdims=True)
        wish *= rules.max_speed / np.maximum(size, rules.max_speed)
        state = np.concatenate([position, velocity, wish], axis=1)
        velocity = velocities(choose, state, rules)
        # The least distance on the way, of all pairs.
        gap = position[:, None] - position
        change = period * (velocity[:, None] - velocity)
        square = np.maximum((change**2).sum(axis=-1), 1e-12)
        time = np.clip(-(gap * change).sum(axis=-1) / square, 0, 1)
        apart = np.linalg.norm(gap + time[..., None] * change, axis=-1)
        least = min(least, apart[~np.eye(len(position), dtype=bool)].min())
        position = position + period * velocity
    return position, least
