"""Golden trajectories: what the default environments do.

`python tests/golden.py TASK ...` writes them anew.
"""

import io
import lzma
import sys
from pathlib import Path

import numpy as np

import bulletuav
from bulletuav.dynamics import DEFAULT_DYNAMICS
from bulletuav.engine.calls import require_bullet

FOLDER = Path(__file__).parent / "golden"
STEPS = 100
OPTIONS = {
    "pad_landing": {  # without pictures, which have too many numbers
        "observation": (
            *("attitude", "velocity", "rates", "pad_clue"),
            *("lidar", "claimed_pads", "neighbours"),
        )
    },
    "transport": {"cable_length": 1.5},  # so that the drone does not descend onto the load
}
"""Options of tasks whose default environment gives more than a file can keep, or hits something"""
SEEDS = {"obstacles": 1}
"""Seeds with which nothing is hit, where that is not so with 0"""
SHORT = {"flocking": 30}
"""Numbers of steps of tasks with many drones that observe many others"""
DROPPED_BITS = 14
"""Low bits of doubles that files do not have; of float32 they have all"""
ROUNDING = 2.0 ** (DROPPED_BITS - 53)
"""Greatest relative error of doubles in files"""
MAX_ORDER = 3
FILTERS = [{"id": lzma.FILTER_LZMA2, "preset": 9 | lzma.PRESET_EXTREME, "lc": 0, "pb": 0}]


def fly(task):
    """Fly up to 100 steps of the default environment under smooth actions.

    Gives its observations, rewards and states.
    """
    aviary = bulletuav.Aviary(task, **OPTIONS.get(task, {}))
    if aviary.options.dynamics == DEFAULT_DYNAMICS:
        require_bullet("golden trajectories of the default dynamics")
    rows = {
        "observations": [aviary.reset(seeds=SEEDS.get(task, 0))[0]],
        "rewards": [],
        "position": [],
        "quaternion": [],
        "rotor_speed": [],
    }
    shape = (aviary.num_drones, aviary.action.low.shape[-1])
    phase = np.arange(np.prod(shape)).reshape(shape)
    for k in range(min(SHORT.get(task, STEPS), aviary.options.horizon - 1)):
        if aviary.options.action == "rotor":  # a hover with small disturbances
            airframe = aviary.options.airframe[0]
            hover = 2 * (airframe.hover_speed() / airframe.max_rotor_speed) ** 2 - 1
            action = hover + 0.001 * np.sin(0.9 * k + phase)
        else:
            size = 0.3  # small enough not to hit anything, or to leave the schedule of pursuit
            size = 0.1 if aviary.task.obstacles() or task == "pursuit" else size
            size = 0.05 if aviary.task.layouts() and not aviary.task.obstacles() else size
            size *= min(1.0, aviary.options.decision_hz / 10)
            action = (
                size * np.sin(0.07 * k + phase)
                + aviary.scene.goal_velocity[0] / aviary.options.max_speed
            )
        step = aviary.step(action[None])
        rows["observations"].append(step.observations[0])
        rows["rewards"].append(step.rewards[0])
        for name in ("position", "quaternion", "rotor_speed"):
            rows[name].append(getattr(aviary.swarm, name)[0].copy())
    flown = {name: np.array(value) for name, value in rows.items()}
    flown["alive"] = aviary.alive[0].copy()
    aviary.close()
    return flown


def pack(values):
    """Pack an array (T, ...) for compression.

    Its numbers become integers in the same order, of which each column is replaced by its
    differences in time, of the order 0 to 3 that gives the smallest ones.

    Returns:
        Bytes of the differences (8 or 4, ..., T), those of least weight first and other axes in
        reverse, and orders (...).
    """
    bits = values.view(f"i{values.itemsize}")
    bits = np.where(bits < 0, bits ^ np.iinfo(bits.dtype).max, bits)
    if values.dtype == np.float64:
        bits = (bits + (1 << (DROPPED_BITS - 1))) >> DROPPED_BITS
    differences = [bits]
    for _ in range(MAX_ORDER):
        differences.append(np.diff(differences[-1], axis=0, prepend=bits.dtype.type(0)))
    sizes = [np.log2(1 + np.abs(one.astype(float))).sum(axis=0) for one in differences]
    orders = np.argmin(sizes, axis=0).astype(np.uint8)
    chosen = np.take_along_axis(np.array(differences), orders[None, None], axis=0)[0]
    folded = (chosen << 1) ^ (chosen >> (8 * values.itemsize - 1))  # small ones stay small
    planes = np.ascontiguousarray(folded.T)[..., None].view(np.uint8)
    return np.ascontiguousarray(np.moveaxis(planes, -1, 0)), orders


def unpack(planes, orders):
    """Return the array of which `pack` gave the result."""
    folded = np.ascontiguousarray(np.moveaxis(planes, 0, -1)).view(f"u{len(planes)}")[..., 0].T
    bits = (folded >> 1).view(f"i{len(planes)}") ^ -(folded & 1).view(f"i{len(planes)}")
    for k in range(MAX_ORDER):
        bits = np.where(orders > k, np.cumsum(bits, axis=0, dtype=bits.dtype), bits)
    if len(planes) == 8:
        bits = bits << DROPPED_BITS
    bits = np.where(bits < 0, bits ^ np.iinfo(bits.dtype).max, bits)
    return bits.view(f"f{len(planes)}")


def write(path, flown):
    """Write the arrays of a flight."""
    arrays = {"alive": flown["alive"]}
    for name in flown.keys() - {"alive"}:
        arrays[name], arrays[f"{name} orders"] = pack(flown[name])
    file = io.BytesIO()
    np.savez(file, **dict(sorted(arrays.items())))
    path.write_bytes(lzma.compress(file.getvalue(), filters=FILTERS))


def read(path):
    """Read the arrays of a flight."""
    with np.load(io.BytesIO(lzma.decompress(path.read_bytes()))) as file:
        arrays = dict(file)
    names = [name for name in arrays if f"{name} orders" in arrays]
    packed = {name: unpack(arrays[name], arrays[f"{name} orders"]) for name in names}
    return {"alive": arrays["alive"], **packed}


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for name in sys.argv[1:] or bulletuav.list_tasks():
        write(FOLDER / f"{name}.npz.xz", fly(name))
