"""Take off, fly a figure 8 at 1 m/s, and land.

Shows how to follow a trajectory: `Trajectory` interpolates points at given times by smooth curves,
and `Tracker` computes the acceleration that follows them. The drone starts on the ground with its
motors off, climbs to 1 m, flies the 8 twice, 2.2 m wide, and lands. Ground effect increases the
thrust near the ground, so the descent aims below the ground, and motors stop on contact.

Prints the error on the 8, the overshoot of the climb, and whether the drone rests on the ground at
the end. Plots the 8 from above, and height and error over time.

Run it:

    python examples/figure_eight.py
    python examples/figure_eight.py --seconds 20 --out slow

Takes 10 s, half of it for the start.
"""

import argparse
from pathlib import Path

import numpy as np

import bulletuav
from bulletuav import SetpointLevel
from bulletuav.control.trajectory import Tracker, Trajectory
from bulletuav.report.pictures import blank_figure

AIRFRAME = bulletuav.load_airframe("cf2x")
HEIGHT = 1.0  # m
WIDTH = 2.2  # m, of the 8
ROUNDS = 2
LENGTH = 13.41  # m, of both rounds
CLIMB, HOVER, DESCENT = 2.0, 1.0, 3.0  # s


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--seconds", type=float, default=LENGTH, help="duration of the 8 in s; 13.4 is 1 m/s"
    )
    parser.add_argument("--out", type=Path, default=Path("figure_eight"), help="folder of pictures")
    return parser.parse_args()


def eight(begin: float, seconds: float) -> Trajectory:
    """Return a figure 8 around the origin; its first and last pieces take three times as long."""
    angle = np.linspace(0, 2 * np.pi * ROUNDS, 16 * ROUNDS + 1)
    x = WIDTH / 2 * np.sin(angle)
    points = np.stack([x, x * np.cos(angle), np.full_like(x, HEIGHT)], axis=1)
    share = np.ones(len(angle) - 1)
    share[[0, -1]] = 3.0
    times = np.concatenate([[0.0], np.cumsum(share)])
    return Trajectory(begin + seconds * times / times[-1], points)


def plan(seconds: float) -> list[Trajectory]:
    """Return the trajectories of climb, 8 and descent."""
    ground, high = (0.0, 0.0, AIRFRAME.standing_height), (0.0, 0.0, HEIGHT)
    climb = Trajectory([0.0, CLIMB], [ground, high])
    flight = eight(CLIMB + HOVER, seconds)
    start = flight.end + HOVER
    return [climb, flight, Trajectory([start, start + DESCENT], [high, (0.0, 0.0, -0.2)])]


def fly(legs: list[Trajectory]) -> tuple[np.ndarray, np.ndarray, np.ndarray, bool]:
    """Fly the legs, and wait for a second.

    Args:
        legs: Climb, flight and descent.

    Returns:
        Times (T,), s; positions (T, 3) and reference positions (T, 3), m; and True if the drone
        rests on the ground.
    """
    airspace = bulletuav.Airspace([(0.0, 0.0, AIRFRAME.standing_height)], AIRFRAME)
    trackers = [Tracker(AIRFRAME, leg) for leg in legs]
    rows = []
    landed = False
    position, velocity = airspace.swarm.position[0], airspace.swarm.velocity[0]
    while airspace.time < legs[-1].end + 1.0:
        time = airspace.time
        k = max(i for i, leg in enumerate(legs) if leg.begin <= time)
        if k == len(legs) - 1 and len(airspace.contacts.drone):
            landed = True
            airspace.stop()
        if not landed:
            setpoint = trackers[k].setpoint(time, position, velocity)
            airspace.command(0, SetpointLevel.ACCELERATION, setpoint)
        x, y, z = legs[k].at(time).position
        rows.append((time, *position, x, y, max(z, AIRFRAME.standing_height)))
        airspace.step()
    touches = len(airspace.contacts.drone) > 0
    rests = touches and np.linalg.norm(velocity) < 0.01
    airspace.close()
    table = np.array(rows)
    return table[:, 0], table[:, 1:4], table[:, 4:], bool(rests)


def draw(
    time: np.ndarray, track: np.ndarray, wanted: np.ndarray, on_eight: np.ndarray, path: Path
) -> None:
    """Plot the 8 from above on the left, height and error over time on the right."""
    figure = blank_figure(11, 5)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.3, 1))
    above, height, error = (figure.add_subplot(grid[cell]) for cell in (np.s_[:, 0], 1, 3))
    above.plot(*wanted[on_eight, :2].T, "--", color="0.5", label="trajectory")
    above.plot(*track[on_eight, :2].T, color="tab:red", label="Crazyflie")
    above.set(xlabel="x east (m)", ylabel="y north (m)", aspect="equal", title="From above")
    above.legend(loc="lower center", ncols=2)
    height.plot(time, wanted[:, 2], "--", color="0.5")
    height.plot(time, track[:, 2], color="tab:red")
    height.set(ylabel="height (m)", ylim=(0, None))
    error.plot(time, 100 * np.linalg.norm(track - wanted, axis=1), color="tab:red")
    error.axvspan(time[on_eight][0], time[on_eight][-1], color="0.9", label="on the 8")
    error.set(xlabel="time (s)", ylabel="error (cm)", ylim=(0, None))
    error.legend()
    for axes in (above, height, error):
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Fly, print the errors and plot the flight."""
    args = parse_arguments()
    args.out.mkdir(parents=True, exist_ok=True)

    legs = plan(args.seconds)
    time, track, wanted, rests = fly(legs)
    climbing = time < legs[1].begin
    on_eight = (time >= legs[1].begin) & (time <= legs[1].end)
    error = 100 * np.linalg.norm(track - wanted, axis=1)[on_eight]
    path = np.linalg.norm(np.diff(wanted[on_eight], axis=0), axis=1).sum()

    overshoot = 100 * (track[climbing, 2].max() - HEIGHT)
    print(f"the climb to {HEIGHT:g} m overshoots by {overshoot:.1f} cm")
    print(
        f"on the 8, at {path / args.seconds:.2f} m/s on average: "
        f"error {np.sqrt((error**2).mean()):.1f} cm rms, {error.max():.1f} cm at most"
    )
    print(
        f"at the end it {'rests' if rests else 'does not rest'} on the ground, "
        f"{100 * np.linalg.norm(track[-1, :2]):.1f} cm beside where it began"
    )
    draw(time, track, wanted, on_eight, args.out / "eight.png")
    print(f"the picture is {args.out / 'eight.png'}")


if __name__ == "__main__":
    main()
