"""Fly a Crazyflie around a square with the Crazyflie's PID controller.

Shows how well the controller follows a setpoint that moves along sides of 2 m at 0.5 m/s. Plots
track and setpoints, and the error over time. The drone lags 20 to 30 cm behind. At corners it
overshoots by up to 10 cm, until the integral term of the controller has unwound. The controller is
tuned for motors without lag, so motors have none here.

Run it:

    python examples/pid_flight.py
    python examples/pid_flight.py --seconds 30 --out square

Takes 5 s, most of it for the start.
"""

import argparse
from pathlib import Path

import numpy as np

import bulletuav
from bulletuav.report.pictures import blank_figure

DECISION_HZ = 48  # rate of setpoints
SPEED = 0.5  # m/s
CORNERS = np.array(  # m
    [(-1.0, -1.0, 1.0), (1.0, -1.0, 1.0), (1.0, 1.0, 1.0), (-1.0, 1.0, 1.0), (-1.0, -1.0, 1.0)]
)


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--seconds", type=float, default=20.0, help="duration of the flight; a round takes 16 s"
    )
    parser.add_argument("--out", type=Path, default=Path("pid_flight"), help="folder for the files")
    return parser.parse_args()


def square(time: np.ndarray) -> np.ndarray:
    """Return the setpoints (T, 3), m, at times (T,), s, on a periodic square."""
    sides = np.linalg.norm(np.diff(CORNERS, axis=0), axis=1)
    corner_distance = np.concatenate([[0.0], np.cumsum(sides)])
    distance = SPEED * time % corner_distance[-1]
    return np.stack(
        [np.interp(distance, corner_distance, CORNERS[:, axis]) for axis in range(3)], axis=1
    )


def fly(setpoints: np.ndarray) -> np.ndarray:
    """Fly to each setpoint of (T, 3) for one decision; return the positions (T, 3) after it, m."""
    aviary = bulletuav.Aviary(
        "hover",
        airframe="cf2x",
        action="target_position",
        controller="pid",
        effects=("ground_effect", "downwash"),  # the PID is tuned for motors without lag and drag
        start=(tuple(CORNERS[0]),),
        decision_hz=DECISION_HZ,
        horizon=len(setpoints),
    )
    aviary.reset(seeds=0)
    track = []
    for setpoint in setpoints:
        # Actions have the shape (worlds, drones, size of an action)
        aviary.step(aviary.action.encode(setpoint.reshape(1, 1, 3)))
        track.append(aviary.swarm.position[0, 0].copy())
    aviary.close()
    return np.array(track)


def draw(time: np.ndarray, setpoints: np.ndarray, track: np.ndarray, path: Path) -> None:
    """Plot the track from above on the left, and the error of each axis on the right."""
    figure = blank_figure(11, 5)
    above, error = figure.subplots(1, 2)
    above.plot(*setpoints[:, :2].T, "--", color="0.5", label="setpoint")
    above.plot(*track[:, :2].T, color="tab:red", label="Crazyflie")
    above.plot(*track[0, :2], "o", color="tab:red", label="start")
    above.set(xlabel="x east (m)", ylabel="y north (m)", aspect="equal", title="From above")
    for axis, name in enumerate(("x", "y", "z")):
        error.plot(time, 100 * (track - setpoints)[:, axis], label=name)
    error.set(xlabel="time (s)", ylabel="position minus setpoint (cm)", title="Error")
    for axes in (above, error):
        axes.grid(alpha=0.3)
        axes.legend()
    figure.savefig(path, dpi=110)


def main() -> None:
    """Fly, print the error and plot the flight."""
    args = parse_arguments()
    args.out.mkdir(parents=True, exist_ok=True)

    decisions = max(1, round(args.seconds * DECISION_HZ))
    time = np.arange(1, decisions + 1) / DECISION_HZ
    setpoints = square(time)
    track = fly(setpoints)

    error = 100 * np.linalg.norm(track - setpoints, axis=1)
    print(
        f"error {error.mean():.1f} cm on average, {error.max():.1f} cm at most, "
        f"{error[-1]:.1f} cm at the end"
    )
    draw(time, setpoints, track, args.out / "square.png")
    print(f"the picture is {args.out / 'square.png'}")


if __name__ == "__main__":
    main()
