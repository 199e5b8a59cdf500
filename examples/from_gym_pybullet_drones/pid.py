"""The script pid.py of gym-pybullet-drones in bulletuav: three Crazyflies on circles.

Each drone flies a circle of 0.6 m in 10 s at its own height, with the Crazyflie's PID. Targets are
set at 48 Hz, physics runs at 240 Hz, with rigid-body motion only. The docs compare this script with
the original, line by line. Prints errors and plots the circles.

Run it:

    python examples/from_gym_pybullet_drones/pid.py
    python examples/from_gym_pybullet_drones/pid.py --seconds 30 --out circles

Takes 5 s, most of it for the start.
"""

import argparse
from pathlib import Path

import numpy as np

import bulletuav
from bulletuav import SetpointLevel
from bulletuav.geometry.rotation import from_euler
from bulletuav.report.pictures import blank_figure

RADIUS, PERIOD, HZ = 0.3, 10.0, 48  # m, s, commands per second

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument("--seconds", type=float, default=12.0, help="duration of the flight")
parser.add_argument("--out", type=Path, default=Path("pid"), help="folder for the picture")
args = parser.parse_args()

phase = np.array([0, 1, 2]) * np.pi / 3 + np.pi / 2
height = np.array([0.1, 0.15, 0.2])
yaw = np.array([0, 1, 2]) * np.pi / 6


def targets(time: float) -> np.ndarray:
    """Return the target position and yaw of each drone, (3, 4)."""
    angle = phase + 2 * np.pi * time / PERIOD
    x, y = RADIUS * np.cos(angle), RADIUS * np.sin(angle) - RADIUS
    return np.stack([x, y, height, yaw], axis=1)


starts = targets(0.0)[:, :3]
airspace = bulletuav.Airspace(
    starts, "cf2x", physics_hz=240, decision_hz=HZ, controller="pid", effects=()
)
airspace.place(None, starts, [from_euler(0.0, 0.0, one) for one in yaw])

track, wanted = [], []
for k in range(round(args.seconds * HZ)):
    target = targets(k / HZ)
    airspace.command(None, SetpointLevel.POSITION, target)
    airspace.step()
    track.append(airspace.swarm.position.copy())
    wanted.append(target[:, :3])
airspace.close()

error = 100 * np.linalg.norm(np.array(track) - np.array(wanted), axis=2)
for i in range(3):
    print(
        f"drone {i}: error {error[:, i].mean():.1f} cm on average, {error[:, i].max():.1f} at most"
    )

figure = blank_figure(6, 6)
above = figure.subplots()
for i in range(3):
    above.plot(*np.array(track)[:, i, :2].T, label=f"drone {i}")
above.plot(*np.array(wanted)[:, 0, :2].T, "--", color="0.5", label="target of drone 0")
above.set(xlabel="x east (m)", ylabel="y north (m)", aspect="equal", title="From above")
above.legend()
args.out.mkdir(parents=True, exist_ok=True)
figure.savefig(args.out / "circles.png", dpi=110)
