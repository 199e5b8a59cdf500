"""Switch off the motors of a Crazyflie in flight, report its contacts, and fly on.

Shows contacts and external forces: a static body, motors that stop, torques and gusts, contacts, a
drone at rest, and a drone that is placed. The drone flies above a roof. A torque turns it over and
its motors stop, so that it falls onto the roof and tumbles to the ground. When it is at rest it is
placed upright elsewhere, takes off, and is hit by a gust. Prints each contact that begins, with
time, body, position, speed and impulse. Plots the height over time, and a picture of the crashed
drone.

Run it:

    python examples/crash_and_recovery.py
    python examples/crash_and_recovery.py --blow 12 --out harder

Takes 5 s, most of it for the start.
"""

import argparse
from pathlib import Path

import numpy as np

import bulletuav
from bulletuav import SetpointLevel
from bulletuav.geometry.rotation import axes, product
from bulletuav.report.pictures import blank_figure
from bulletuav.vehicle.swarm import GROUND

AIRFRAME = bulletuav.load_airframe("cf2x")
# Corners of a roof with its ridge along y, m
ROOF = [(x, y, z) for y in (-0.5, 0.5) for x, z in ((-0.6, 0.0), (0.0, 0.6), (0.6, 0.0))]
AGAIN = (1.5, 0.0)  # m, where it is placed again
HZ = 100  # steps per second
HEIGHT, SPEED = 1.5, 0.5  # m and m/s, above the roof
GUST = 0.1  # N, for 0.1 s
STILL = 1e-3  # m/s and rad/s


class Flight:
    """An airspace with a roof, and a log of the flight.

    Attributes:
        airspace: The airspace.
        names: Names of the bodies in contacts.
        touched: Bodies in contact with the drone in the last step.
        rows: Time (s) and height (m) after each step.
        hits: Time (s) and height (m) of each contact that began.
    """

    def __init__(self) -> None:
        self.airspace = bulletuav.Airspace(
            [(-1.0, 0.0, HEIGHT)],
            AIRFRAME,
            physics_hz=500,
            decision_hz=HZ,
            rotor_speed=AIRFRAME.hover_speed(),
        )
        roof = self.airspace.add_body(ROOF, (0.0, 0.0, 0.0))
        self.names = {GROUND: "the ground", roof: "the roof"}
        self.touched: set[int] = set()
        self.rows: list[tuple[float, float]] = []
        self.hits: list[tuple[float, float]] = []

    def step(self) -> None:
        """Step, and print the contacts that begin."""
        self.airspace.step()
        contacts, time = self.airspace.contacts, self.airspace.time
        self.rows.append((time, self.airspace.swarm.position[0, 2]))
        for k, other in enumerate(contacts.other):
            if other not in self.touched:
                x, y, z = contacts.point[k].round(2) + 0.0  # no -0
                speed = np.linalg.norm(contacts.velocity[k])
                print(
                    f"{time:.2f} s: touches {self.names[int(other)]} at ({x:.2f}, {y:.2f}, "
                    f"{z:.2f}) m with {speed:.2f} m/s and {1000 * contacts.impulse[k]:.1f} mN s"
                )
                self.hits.append((time, z))
        self.touched = set(contacts.other.tolist())

    def fly(self, seconds: float) -> None:
        """Step for some seconds."""
        for _ in range(round(seconds * HZ)):
            self.step()

    def fall(self) -> None:
        """Step until the drone has been at rest for half a second."""
        swarm = self.airspace.swarm
        still = 0
        while still < HZ // 2:
            self.step()
            moves = max(np.abs(swarm.velocity).max(), np.abs(swarm.rates).max())
            still = still + 1 if self.touched and moves < STILL else 0


def camera() -> tuple[float, float, float, float]:
    """Return the quaternion of a camera that looks to the left, and 25 degrees down."""
    left, down = np.radians(90) / 2, np.radians(25) / 2
    turn, nod = (0.0, 0.0, np.sin(left), np.cos(left)), (0.0, np.sin(down), 0.0, np.cos(down))
    return product(turn, nod)


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--blow", type=float, default=10.0, help="torque in the step when motors stop, mN m"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("crash_and_recovery"), help="folder for the files"
    )
    return parser.parse_args()


def draw(flight: Flight, pixels: np.ndarray, path: Path) -> None:
    """Plot the height over time on the left, and the picture on the right."""
    figure = blank_figure(12, 5)
    height, scene = figure.subplots(1, 2)
    height.plot(*np.array(flight.rows).T, color="tab:red", label="Crazyflie")
    height.plot(*np.array(flight.hits).T, "x", color="k", label="contact begins")
    height.axhline(ROOF[1][2], color="tab:brown", linestyle="--", label="ridge of the roof")
    height.set(xlabel="time (s)", ylabel="height (m)", ylim=(0, None))
    height.grid(alpha=0.3)
    height.legend()
    scene.imshow(pixels)
    scene.set(title="Where it lies")
    scene.axis("off")
    figure.savefig(path, dpi=110)


def main() -> None:
    """Fly the script, print the events and plot them."""
    args = parse_arguments()
    args.out.mkdir(parents=True, exist_ok=True)
    flight = Flight()
    airspace, swarm = flight.airspace, flight.airspace.swarm

    airspace.command(0, SetpointLevel.VELOCITY, (SPEED, 0.0, 0.0))
    while swarm.position[0, 0] < -0.1:
        flight.step()
    print(f"{airspace.time:.2f} s: a blow, and the motors stop")
    airspace.apply(0, torque=(0.0, args.blow / 1000, 0.0))
    airspace.stop(0)
    flight.fall()

    lies = swarm.position[0].round(4) + 0.0  # no -0
    tilt = np.degrees(np.arccos(np.clip(axes(swarm.quaternion[0])[2][2], -1.0, 1.0)))
    print(
        f"{airspace.time:.2f} s: lies still at ({lies[0]:.2f}, {lies[1]:.2f}, {lies[2]:.3f}) m, "
        f"tilted by {tilt:.0f} degrees"
    )
    picture = airspace.picture(position=(0.5, -1.2, 0.7), quaternion=camera())

    airspace.place(0, (*AGAIN, AIRFRAME.standing_height))
    airspace.command(0, SetpointLevel.POSITION, (*AGAIN, HEIGHT))
    print(f"{airspace.time:.2f} s: is stood up, and takes off")
    flight.fly(5.0)
    for _ in range(HZ // 10):
        airspace.apply(0, force=(0.0, GUST, 0.0))
        flight.step()
    away = 0.0
    for _ in range(5 * HZ):
        flight.step()
        away = max(away, abs(swarm.position[0, 1] - AGAIN[1]))
    error = np.linalg.norm(swarm.position[0] - (*AGAIN, HEIGHT))
    print(f"the gust moved it by {100 * away:.0f} cm; at the end the error is {100 * error:.1f} cm")
    draw(flight, picture.pixels, args.out / "crash.png")
    print(f"the picture is {args.out / 'crash.png'}")
    airspace.close()


if __name__ == "__main__":
    main()
