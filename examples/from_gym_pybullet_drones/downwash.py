"""The script downwash.py of gym-pybullet-drones in bulletuav: two Crazyflies cross vertically.

One drone flies back and forth at a height of 1 m, the other at 0.5 m, each 1 m in 2.5 s, so that
they meet every 2.5 s. They fly twice, with the wake of the upper drone and without it. The docs
compare this script with the original, line by line. Prints how far the wake pushes the lower drone
down, and plots heights over time.

Run it:

    python examples/from_gym_pybullet_drones/downwash.py
    python examples/from_gym_pybullet_drones/downwash.py --seconds 30 --out wakes

Takes 5 s, most of it for the start.
"""

import argparse
from pathlib import Path

import numpy as np

import bulletuav
from bulletuav import SetpointLevel
from bulletuav.report.pictures import blank_figure

HZ, PERIOD = 48, 5.0  # commands per second, s
HEIGHTS = np.array([1.0, 0.5])  # m

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument("--seconds", type=float, default=12.0, help="duration of the flight")
parser.add_argument("--out", type=Path, default=Path("downwash"), help="folder for the picture")
args = parser.parse_args()


def targets(time: float) -> np.ndarray:
    """Return the target position of each drone, (2, 3), m."""
    x = 0.5 * np.cos(2 * np.pi * time / PERIOD + np.array([0.0, np.pi]))
    return np.stack([x, np.zeros(2), HEIGHTS], axis=1)


def fly(effects: tuple[str, ...]) -> np.ndarray:
    """Fly back and forth; return positions (T, 2, 3), m."""
    airspace = bulletuav.Airspace(
        targets(0.0), "cf2x", physics_hz=240, decision_hz=HZ, controller="pid", effects=effects
    )
    track = []
    for k in range(round(args.seconds * HZ)):
        airspace.command(None, SetpointLevel.POSITION, targets(k / HZ), yaw=0.0)
        airspace.step()
        track.append(airspace.swarm.position.copy())
    airspace.close()
    return np.array(track)


calm, blown = fly(effects=()), fly(effects=("downwash",))
down = 100 * (calm[:, 1, 2] - blown[:, 1, 2])
print(f"the wake pushes the lower drone down by {down.max():.1f} cm at most")
print(f"and the upper one by {100 * np.abs(calm[:, 0, 2] - blown[:, 0, 2]).max():.1f} cm")

figure = blank_figure(8, 4)
heights = figure.subplots()
time = np.arange(1, len(calm) + 1) / HZ
heights.plot(time, blown[:, 0, 2], label="upper drone")
heights.plot(time, blown[:, 1, 2], label="lower drone")
heights.plot(time, calm[:, 1, 2], "--", color="0.5", label="lower drone, without wake")
heights.set(xlabel="time (s)", ylabel="height (m)", ylim=(0, 1.1))
heights.legend(loc="lower right")
heights.grid(alpha=0.3)
args.out.mkdir(parents=True, exist_ok=True)
figure.savefig(args.out / "heights.png", dpi=110)
