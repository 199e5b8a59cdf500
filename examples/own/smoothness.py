"""A custom reward term, in addition to those of any task, written in two ways.

A function of the quantities of one drone, with the decorator @reward, is compiled. A function of
`frame` receives the arrays of all drones of all worlds, and is plain NumPy. Both have the same
result.

Run it:

    python examples/own/smoothness.py
"""

import math

import numpy as np

import bulletuav
from bulletuav.geometry.rotation import Vec3
from bulletuav.tasks import Frame, reward


@reward
def smoothness(velocity: Vec3, velocity_before: Vec3) -> float:
    """Return the norm of the change of velocity in the decision, m/s."""
    x = velocity[0] - velocity_before[0]
    y = velocity[1] - velocity_before[1]
    z = velocity[2] - velocity_before[2]
    return math.sqrt(x * x + y * y + z * z)


def smoothness_of_all(frame: Frame) -> np.ndarray:
    """Return the norm of the change of velocity of all drones (W, N), m/s."""
    change: np.ndarray = np.linalg.norm(frame.after.velocity - frame.before.velocity, axis=-1)
    return change


def main() -> None:
    """Check both terms, fly with both, and compare their totals."""
    terms = {"smooth": (smoothness, -0.1), "smooth_of_all": (smoothness_of_all, -0.1)}
    bulletuav.check_task("crossing", reward=terms)
    aviary = bulletuav.Aviary("crossing", 2, dynamics="point_mass", reward=terms)
    aviary.reset(seeds=0)
    rng = np.random.default_rng(0)
    totals = dict.fromkeys(terms, 0.0)
    for _ in range(50):
        step = aviary.step(rng.uniform(-1.0, 1.0, (2, aviary.num_drones, 3)))
        for name in terms:
            totals[name] += float(step.info[f"reward/{name}"].sum())
    aviary.close()
    for name, total in totals.items():
        print(f"{name}: {total:.6f}")


if __name__ == "__main__":
    main()
