"""A Crazyflie flies a square by its own PID controller; one sees its track beside the setpoints.

The setpoint moves along sides of 2 m at 0.5 m/s. The drone lags 20 to 30 cm behind and overshoots by up to 10 cm, until
the controller's integral term has unwound. It is made for motors without lag, so that they have none here. Takes 5 s, most
of it to start.

    python examples/pid_flight.py
    python examples/pid_flight.py --seconds 30 --out square
"""

import argparse
from pathlib import Path

import numpy as np

import bulletuav
from bulletuav.report.pictures import blank_figure

HZ = 48  # decisions, which are setpoints, a second
SPEED = 0.5  # m/s
CORNERS = np.array(
    [(-1.0, -1.0, 1.0), (1.0, -1.0, 1.0), (1.0, 1.0, 1.0), (-1.0, 1.0, 1.0), (-1.0, -1.0, 1.0)]
)


def along_square(seconds: np.ndarray) -> np.ndarray:
    """(T, 3) places of the setpoint, m, round and round."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(CORNERS, axis=0), axis=1))])
    gone = SPEED * seconds % way[-1]
    return np.stack([np.interp(gone, way, CORNERS[:, axis]) for axis in range(3)], axis=1)


def fly(setpoint: np.ndarray) -> np.ndarray:
    """(T, 3) positions after each decision, m."""
    aviary = bulletuav.Aviary(
        "hover",
        airframe="cf2x",
        action="target_position",
        controller="pid",
        effects=("drag", "ground_effect", "downwash"),  # all but "lag"
        start=(tuple(CORNERS[0]),),
        decision_hz=HZ,
        horizon=len(setpoint),
    )
    aviary.reset(seeds=0)
    track = []
    for place in setpoint:
        aviary.step(aviary.action.encode(place.reshape(1, 1, 3)))
        track.append(aviary.swarm.position[0, 0].copy())
    aviary.close()
    return np.array(track)


def draw(time: np.ndarray, setpoint: np.ndarray, track: np.ndarray, path: Path) -> None:
    figure = blank_figure(11, 5)
    above, error = figure.subplots(1, 2)
    above.plot(*setpoint[:, :2].T, "--", color="0.5", label="setpoint")
    above.plot(*track[:, :2].T, color="tab:red", label="Crazyflie")
    above.plot(*track[0, :2], "o", color="tab:red", label="start")
    above.set(xlabel="x east (m)", ylabel="y north (m)", aspect="equal", title="From above")
    for axis, name in enumerate(("x", "y", "z")):
        error.plot(time, 100 * (track - setpoint)[:, axis], label=name)
    error.set(xlabel="time (s)", ylabel="position minus setpoint (cm)", title="Error")
    for axes in (above, error):
        axes.grid(alpha=0.3)
        axes.legend()
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=20.0, help="of flight; a round takes 16")
    parser.add_argument("--out", type=Path, default=Path("pid_flight"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)

    time = np.arange(1, max(1, round(args.seconds * HZ)) + 1) / HZ
    setpoint = along_square(time)
    track = fly(setpoint)
    error = 100 * np.linalg.norm(track - setpoint, axis=1)
    print(
        f"error {error.mean():.1f} cm on average, {error.max():.1f} cm at most, {error[-1]:.1f} cm at the end"
    )
    draw(time, setpoint, track, args.out / "square.png")
    print(f"the picture is {args.out / 'square.png'}")
