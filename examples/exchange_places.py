"""Fly two Crazyflies to each other's positions, side by side and above each other.

Shows trajectories of several drones, and the effect of the wake of one drone on another. Both fly 3
m in 4 s. First each keeps to its right, so that they pass at 1 m. Then one flies half a metre above
the other, whose error shows the effect of the wake. Prints the minimum separation and the maximum
errors. Plots both flights.

Run it:

    python examples/exchange_places.py
    python examples/exchange_places.py --seconds 3 --out fast

Takes 5 s, most of it for the start.
"""

import argparse
from pathlib import Path

import numpy as np

import bulletuav
from bulletuav import SetpointLevel
from bulletuav.control.trajectory import Tracker, Trajectory
from bulletuav.report.pictures import blank_figure

AIRFRAME = bulletuav.load_airframe("cf2x")
HZ = 120  # commands per second
PLACES = np.array([(-1.5, 0.0, 1.0), (1.5, 0.0, 1.0)])  # m, starts of the drones
# Position of each drone halfway: (drones, 3), m
WAYS = {
    "to the right": np.array([(0.0, -0.5, 1.0), (0.0, 0.5, 1.0)]),
    "above": np.array([(0.0, 0.0, 1.25), (0.0, 0.0, 0.75)]),
}


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=4.0, help="duration of an exchange")
    parser.add_argument(
        "--out", type=Path, default=Path("exchange_places"), help="folder for the files"
    )
    return parser.parse_args()


def exchange(halfway: np.ndarray, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Fly each drone to the start of the other, and hover there for a second.

    Args:
        halfway: (2, 3) positions of the drones halfway, m.
        seconds: Duration of the flight.

    Returns:
        Positions of the drones and of their trajectories, (T, 2, 3), m.
    """
    times = [0.0, seconds / 2, seconds]
    trackers = [
        Tracker(AIRFRAME, Trajectory(times, [PLACES[i], halfway[i], PLACES[1 - i]])) for i in (0, 1)
    ]
    airspace = bulletuav.Airspace(
        PLACES, AIRFRAME, decision_hz=HZ, rotor_speed=AIRFRAME.hover_speed()
    )
    swarm = airspace.swarm
    track, wanted = [], []
    while airspace.time < seconds + 1.0:
        time = airspace.time
        for i, tracker in enumerate(trackers):
            setpoint = tracker.setpoint(time, swarm.position[i], swarm.velocity[i])
            airspace.command(i, SetpointLevel.ACCELERATION, setpoint)
        airspace.step()
        track.append(swarm.position.copy())
        wanted.append([tracker.trajectory.at(airspace.time).position for tracker in trackers])
    airspace.close()
    return np.array(track), np.array(wanted)


def draw(flights: dict[str, tuple[np.ndarray, np.ndarray]], path: Path) -> None:
    """Plot the first flight from above and the second from the side, a dot each half second."""
    figure = blank_figure(8, 5)
    views = ((1, "From above: each keeps to its right"), (2, "From the side: one flies above"))
    for axes, (axis, title), (track, wanted) in zip(
        figure.subplots(2, 1, sharex=True), views, flights.values(), strict=True
    ):
        for i, colour in enumerate(("tab:red", "tab:blue")):
            axes.plot(wanted[:, i, 0], wanted[:, i, axis], "--", color="0.5")
            axes.plot(track[:, i, 0], track[:, i, axis], color=colour)
            axes.plot(
                track[:: HZ // 2, i, 0], track[:: HZ // 2, i, axis], "o", color=colour, markersize=4
            )
        axes.set(title=title, ylabel=("y north (m)", "z up (m)")[axis - 1], aspect="equal")
        axes.grid(alpha=0.3)
    figure.axes[1].set(xlabel="x east (m)")
    figure.savefig(path, dpi=110)


def main() -> None:
    """Fly both exchanges, print separations and errors, and plot them."""
    args = parse_arguments()
    args.out.mkdir(parents=True, exist_ok=True)

    flights = {way: exchange(halfway, args.seconds) for way, halfway in WAYS.items()}
    for way, (track, wanted) in flights.items():
        separation = np.linalg.norm(track[:, 0] - track[:, 1], axis=1).min()
        errors = 100 * np.linalg.norm(track - wanted, axis=2).max(axis=0)
        print(
            f"{way}: separation {separation:.2f} m at least, errors {errors[0]:.1f} and "
            f"{errors[1]:.1f} cm at most"
        )
        ends = 100 * np.linalg.norm(track[-1] - PLACES[::-1], axis=1)
        print(f"{way}: {ends.max():.1f} cm from the other's place at the end")
    draw(flights, args.out / "exchange.png")
    print(f"the picture is {args.out / 'exchange.png'}")


if __name__ == "__main__":
    main()
