"""Build a custom hexacopter, from a parts list to flight.

Writes a URDF from masses, positions and two propeller coefficients. Prints the thrust-to-weight
ratio, the hover speed by formula and in the simulation, and overshoot and settling time of a
lateral step of 2 m. Plots that step. The gains of the controller follow from the URDF.

Run it:

    python examples/custom_airframe.py
    python examples/custom_airframe.py --payload 0.8 --out loaded

Takes 5 s, most of it for the start.
"""

import argparse
import math
from pathlib import Path

import numpy as np

import bulletuav
from bulletuav.report.pictures import blank_figure
from bulletuav.vehicle.airframe import Airframe

# The hub is one box: frame, electronics and a battery of 4 cells, 5 Ah (0.5 kg)
HUB_MASS = 0.95  # kg
HUB_SIZE = (0.2, 0.14, 0.08)  # m
ROTOR_MASS = 0.075  # kg, motor and propeller
ROD_MASS = 0.035  # kg, carbon tube of an arm
ARM_LENGTH = 0.275  # m, which leaves 2 cm between propellers
ARM_ANGLES = np.radians([30, 90, 150, 210, 270, 330])  # from the nose, to the left

# Propellers of 10 by 4.5 inches, in static air; the coefficients give a figure of merit of 0.58
PROPELLER_RADIUS = 0.127  # m
THRUST_COEFFICIENT = 0.11  # c_T = T / (rho n^2 D^4)
POWER_COEFFICIENT = 0.05  # c_P = P / (rho n^3 D^5)
AIR_DENSITY = 1.225  # kg/m^3, ISA at sea level

# A motor with 920 rpm/V at 14.8 V; under load it reaches about 60 % of that speed.
MAX_REVOLUTIONS = 8000 / 60  # 1/s
MOTOR_LAG = 0.05  # s, assumed: the airframes of the package have 0.0125 to 0.065 s
# M. Faessler et al. (2018) measured 0.4 to 0.5 at 0.6 kg; heavier drones have less.
DRAG = 0.3  # 1/s in the rotor plane
GRAVITY = 9.80665  # m/s^2

DECISION_HZ = 60


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--payload", type=float, default=0.0, help="payload in the centre, kg")
    parser.add_argument(
        "--out", type=Path, default=Path("custom_airframe"), help="folder for the files"
    )
    return parser.parse_args()


def write_urdf(path: Path, payload: float) -> None:
    """Write the URDF of the airframe with a payload (kg) in the centre of the hub.

    The formulas are those of rigid bodies and propellers.
    """
    mass = HUB_MASS + payload + 6 * (ROTOR_MASS + ROD_MASS)

    # Moments of inertia: a box, point masses at the ends of the arms, and rods from the centre. The
    # arms point in all directions of the plane, so half of their inertia counts for x and y.
    x, y, z = HUB_SIZE
    arms = 6 * (ROTOR_MASS * ARM_LENGTH**2 + ROD_MASS * ARM_LENGTH**2 / 3)
    ixx = (HUB_MASS + payload) / 12 * (y**2 + z**2) + arms / 2
    iyy = (HUB_MASS + payload) / 12 * (x**2 + z**2) + arms / 2
    izz = (HUB_MASS + payload) / 12 * (x**2 + y**2) + arms

    # Thrust T = thrust omega^2 and torque Q = torque T, as n = omega / 2 pi and P = 2 pi n Q.
    diameter = 2 * PROPELLER_RADIUS
    thrust = THRUST_COEFFICIENT * AIR_DENSITY * diameter**4 / (2 * math.pi) ** 2  # N/(rad/s)^2
    torque = POWER_COEFFICIENT / (2 * math.pi * THRUST_COEFFICIENT) * 2 * PROPELLER_RADIUS  # m

    # Rotor drag is drag omega v for each rotor, and DRAG m v in total in hover
    hover_speed = math.sqrt(mass * GRAVITY / (6 * thrust))
    drag = DRAG * mass / (6 * hover_speed)  # N/(rad/s m/s)

    rotors = "\n".join(
        f'    <rotor x="{ARM_LENGTH * math.cos(angle):.6f}" y="{ARM_LENGTH * math.sin(angle):.6f}" '
        f'spin="{("cw", "ccw")[i % 2]}"/>'
        for i, angle in enumerate(ARM_ANGLES)
    )
    path.write_text(f"""<?xml version="1.0"?>
<robot name="{path.stem}">
  <airframe>
    <thrust_coefficient value="{thrust:.6g}"/>
    <torque_ratio value="{torque:.6g}"/>
    <max_rotor_speed value="{2 * math.pi * MAX_REVOLUTIONS:.6g}"/>
    <motor_lag up="{MOTOR_LAG}" down="{MOTOR_LAG}"/>
    <rotor_drag xy="{drag:.4g}" z="{drag:.4g}"/>
    <propeller_radius value="{PROPELLER_RADIUS}"/>
    <max_speed value="15"/>
{rotors}
  </airframe>
  <link name="base">
    <inertial>
      <mass value="{mass:.6g}"/>
      <inertia ixx="{ixx:.6g}" iyy="{iyy:.6g}" izz="{izz:.6g}"/>
    </inertial>
    <collision>
      <geometry><cylinder radius="{ARM_LENGTH + PROPELLER_RADIUS}" length="0.12"/></geometry>
    </collision>
    <visual><geometry><box size="{x} {y} {z}"/></geometry></visual>
  </link>
</robot>
""")


def fly_step(airframe: Path) -> tuple[np.ndarray, np.ndarray]:
    """Hover for 2 s, then step 2 m to the east and stay there for 6 s.

    Returns:
        Positions from the start (T, 3), m, and mean rotor speeds (T,), rad/s, after each decision.
    """
    aviary = bulletuav.Aviary(
        "hover",
        airframe=str(airframe),
        action="target_position",
        start=((0.0, 0.0, 5.0),),
        height=5.0,
        decision_hz=DECISION_HZ,
        horizon=8 * DECISION_HZ,
    )
    aviary.reset(seeds=0)
    track, speed = [], []
    for k in range(aviary.options.horizon):
        target = np.array((2.0 if k >= 2 * DECISION_HZ else 0.0, 0.0, 5.0))
        # Actions have the shape (worlds, drones, size of an action)
        aviary.step(aviary.action.encode(target.reshape(1, 1, 3)))
        track.append(aviary.swarm.position[0, 0] - (0, 0, 5))
        speed.append(aviary.swarm.rotor_speed[0, 0].mean())
    aviary.close()
    return np.array(track), np.array(speed)


def print_results(
    airframe: Airframe, time: np.ndarray, track: np.ndarray, speed: np.ndarray
) -> None:
    """Print properties of the airframe, and the response to the step at time 0."""
    east = track[time > 0, 0]
    hover_speed = speed[time <= 0][-1]
    settled = np.flatnonzero(np.abs(east - 2) > 0.1)[-1] / DECISION_HZ
    inertia = ", ".join(f"{moment:.4f}" for moment in airframe.inertia)
    print(f"{airframe.mass:.2f} kg, inertia {inertia} kg m^2")
    print(f"thrust to weight {airframe.max_thrust / (airframe.mass * GRAVITY):.2f}")
    print(
        f"hover speed {airframe.hover_speed():.1f} rad/s by formula, "
        f"{hover_speed:.1f} rad/s in the simulation"
    )
    overshoot = 50 * max(0.0, east.max() - 2)  # in percent of 2 m
    print(f"step of 2 m: overshoot {overshoot:.1f} %, within 5 % after {settled:.2f} s")


def draw(title: str, time: np.ndarray, track: np.ndarray, path: Path) -> None:
    """Plot the response to the step at time 0."""
    figure = blank_figure(8, 4.5)
    axes = figure.subplots()
    axes.plot(time, np.where(time > 0, 2.0, 0.0), "--", color="0.5", label="setpoint, east")
    axes.plot(time, track[:, 0], color="tab:red", label="east")
    axes.plot(time, track[:, 2], color="tab:blue", label="up")
    axes.set(xlabel="time (s)", ylabel="m from the start", title=title)
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=110)


def main() -> None:
    """Write the airframe, fly the step, print and plot the results."""
    args = parse_arguments()
    args.out.mkdir(parents=True, exist_ok=True)

    urdf = args.out / "hexacopter.urdf"
    write_urdf(urdf, args.payload)
    airframe = bulletuav.load_airframe(urdf)

    track, speed = fly_step(urdf)
    time = np.arange(1, len(track) + 1) / DECISION_HZ - 2
    print_results(airframe, time, track, speed)
    draw(airframe.name, time, track, args.out / "step.png")
    print(f"{urdf} and the picture are in {args.out}")


if __name__ == "__main__":
    main()
