"""Recover a Crazyflie from a tilt of 60 degrees by rotor commands at 1 kHz.

Shows control of rotor speeds: a cascade from height and velocity to attitude to torques, and a
mixer that allocates thrust and torques to the rotors. The mixer is the inverse of the airframe's
allocation matrix. The drone starts with a roll of 60 degrees, at rest, with rotors at hover speed.
Prints settling time, loss of height and drift. Plots tilt, height and rotor speeds over time.

Run it:

    python examples/rotor_control.py
    python examples/rotor_control.py --tilt 120 --out steep

Takes 5 s, most of it for the start.
"""

import argparse
from pathlib import Path

import numpy as np

import bulletuav
from bulletuav import SetpointLevel
from bulletuav.geometry.rotation import axes, from_euler, to_body
from bulletuav.report.pictures import blank_figure

AIRFRAME = bulletuav.load_airframe("cf2x")
MIXER = np.linalg.pinv(AIRFRAME.allocation())  # thrust of each rotor from thrust and torques
HZ = 1000  # of physics and control
HEIGHT = 2.0  # m
GRAVITY = 9.80665  # m/s^2
ATTITUDE = 9.0  # rad/s, natural frequency of the attitude loop, below the motors' 1 / 0.065 s
CLIMB = 3.0  # rad/s, natural frequency of the height loop
BRAKE = 1.5  # 1/s, gain of horizontal velocity damping


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--tilt", type=float, default=60.0, help="roll at the start, degrees")
    parser.add_argument("--seconds", type=float, default=4.0, help="duration of the flight")
    parser.add_argument(
        "--out", type=Path, default=Path("rotor_control"), help="folder for the files"
    )
    return parser.parse_args()


def rotor_speeds(
    position: np.ndarray, quaternion: np.ndarray, velocity: np.ndarray, rates: np.ndarray
) -> np.ndarray:
    """Compute the speed of each rotor (R,), rad/s, from the state of the drone."""
    # Desired specific force: hold the height and damp the horizontal velocity
    force = np.array(
        [
            -BRAKE * velocity[0],
            -BRAKE * velocity[1],
            GRAVITY + CLIMB**2 * (HEIGHT - position[2]) - 1.6 * CLIMB * velocity[2],
        ]
    )
    force[2] = max(force[2], 0.3 * GRAVITY)
    # Attitude: turn the thrust axis towards the force, about the axis perpendicular to both
    upward = np.array(axes(quaternion)[2])
    error = to_body(quaternion, np.cross(upward, force / np.linalg.norm(force)))
    turn = ATTITUDE**2 * np.array(error) - 1.6 * ATTITUDE * rates
    torque = np.array(AIRFRAME.inertia) * turn + np.cross(rates, AIRFRAME.inertia * rates)
    # Thrust: component of the force along the thrust axis
    thrust = AIRFRAME.mass * max(force @ upward, 0.0)
    lift = MIXER @ np.array([thrust, *torque])
    most = AIRFRAME.max_thrust / len(lift)
    return np.sqrt(np.clip(lift, 0.0, most) / AIRFRAME.thrust_coefficient)


def recover(tilt: float, seconds: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fly from a roll of `tilt` degrees.

    Returns:
        Tilts (T,), degrees; positions (T, 3), m; and rotor speeds (T, R), rad/s.
    """
    airspace = bulletuav.Airspace([(0.0, 0.0, HEIGHT)], AIRFRAME, physics_hz=HZ, decision_hz=HZ)
    quaternion = from_euler(np.radians(tilt), 0.0, 0.0)
    airspace.place(0, (0.0, 0.0, HEIGHT), quaternion, rotor_speed=airspace.hover_speed[0])
    # Each step writes to the same arrays of the swarm
    state = [array[0] for array in airspace.swarm]
    tilts, track, speeds = [], [], []
    for _ in range(round(seconds * HZ)):
        airspace.command(0, SetpointLevel.ROTOR, rotor_speeds(*state[:4]))
        airspace.step()
        tilts.append(np.degrees(np.arccos(np.clip(axes(state[1])[2][2], -1.0, 1.0))))
        track.append(state[0].copy())
        speeds.append(state[4].copy())
    airspace.close()
    return np.array(tilts), np.array(track), np.array(speeds)


def draw(tilts: np.ndarray, track: np.ndarray, speeds: np.ndarray, path: Path) -> None:
    """Plot tilt, height and rotor speeds over time."""
    figure = blank_figure(8, 7)
    tilt, height, rotors = figure.subplots(3, 1, sharex=True)
    time = np.arange(1, len(tilts) + 1) / HZ
    tilt.plot(time, tilts, color="tab:red")
    tilt.set(ylabel="tilt (degrees)")
    height.plot(time, track[:, 2], color="tab:red")
    height.set(ylabel="height (m)")
    # Both rotors of one side have equal speeds
    rotors.plot(time, speeds[:, 0], label="right rotors")
    rotors.plot(time, speeds[:, 3], label="left rotors")
    rotors.set(xlabel="time (s)", ylabel="rotor speed (rad/s)")
    rotors.legend()
    for one in (tilt, height, rotors):
        one.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Fly the recovery, print and plot the results."""
    args = parse_arguments()
    args.out.mkdir(parents=True, exist_ok=True)

    tilts, track, speeds = recover(args.tilt, args.seconds)
    outside = np.flatnonzero((tilts > 3.0) | (np.abs(track[:, 2] - HEIGHT) > 0.05))
    settled = (outside[-1] + 1) / HZ if len(outside) else 0.0
    drift = np.linalg.norm(track[-1, :2])
    print(
        f"from {args.tilt:g} degrees: settles within 3 degrees and 5 cm in {settled:.2f} s, "
        f"falls {100 * (HEIGHT - track[:, 2].min()):.0f} cm, drifts {100 * drift:.0f} cm"
    )
    print(f"at the end the tilt is {tilts[-1]:.2f} degrees, the height {track[-1, 2]:.3f} m")
    draw(tilts, track, speeds, args.out / "recovery.png")
    print(f"the picture is {args.out / 'recovery.png'}")


if __name__ == "__main__":
    main()
