"""A hexacopter of one's own, from a parts list to flight: its numbers, its hover and its answer to a step.

One sees a URDF written from masses, places and two coefficients of propellers, what follows from it (thrust to weight,
hover speed), how fast the rotors turn when it hovers in the engine, and a picture of a step of 2 m to the side. The
controller's gains follow from the URDF. Takes 5 s, most of it to start.

    python examples/custom_airframe.py
    python examples/custom_airframe.py --payload 0.8 --out loaded
"""

import argparse
import math
from pathlib import Path

import numpy as np

import bulletuav
from bulletuav.report.pictures import blank_figure
from bulletuav.vehicle.airframe import Airframe

HUB, HUB_SIZE = (
    0.95,
    (0.2, 0.14, 0.08),
)  # kg, m: frame, electronics and a battery of 4 cells, 5 Ah (0.5 kg), as one box
ROTOR, ROD, ARM = (
    0.075,
    0.035,
    0.275,
)  # kg: motor with propeller, carbon tube; m: propellers of 10 inches 2 cm apart
RADIUS = 0.127  # m: propellers of 10 inches by 4.5
THRUST, POWER = (
    0.11,
    0.05,
)  # c_T = T / (rho n^2 D^4), c_P = P / (rho n^3 D^5), static: a figure of merit of 0.58
AIR = 1.225  # kg/m^3, ISA at sea level
REVOLUTIONS = (
    8000 / 60
)  # 1/s, of a motor with 920 rpm/V under load at 14.8 V: about 60 % of those without
LAG = 0.05  # s, our choice: the airframes of the package have 0.0125 to 0.065 s
DRAG = 0.3  # 1/s in the rotor plane; 0.4 to 0.5 at 0.6 kg in M. Faessler et al. (2018), and less for what is heavier
ANGLES = np.radians([30, 90, 150, 210, 270, 330])  # of the arms from the nose, to the left


def write_urdf(path: Path, payload: float) -> None:
    """The parts with `payload`, kg, in the middle of the box. Formulas are those of rigid bodies and of propellers."""
    mass = HUB + payload + 6 * (ROTOR + ROD)
    x, y, z = HUB_SIZE
    on_arms = 6 * (
        ROTOR * ARM**2 + ROD * ARM**2 / 3
    )  # points at the ends, rods from the middle; half of it on each axis
    ixx = (HUB + payload) / 12 * (y**2 + z**2) + on_arms / 2
    iyy = (HUB + payload) / 12 * (x**2 + z**2) + on_arms / 2
    izz = (HUB + payload) / 12 * (x**2 + y**2) + on_arms
    thrust = (
        THRUST * AIR * (2 * RADIUS) ** 4 / (2 * math.pi) ** 2
    )  # N/(rad/s)^2, as n = omega / 2 pi
    torque = POWER / (2 * math.pi * THRUST) * 2 * RADIUS  # m: Q / T, as P = 2 pi n Q
    hover = math.sqrt(mass * 9.80665 / (6 * thrust))
    drag = DRAG * mass / (6 * hover)  # N/(rad/s m/s): each rotor's force is drag omega v
    rotors = "\n".join(
        f'    <rotor x="{ARM * math.cos(a):.6f}" y="{ARM * math.sin(a):.6f}" spin="{("cw", "ccw")[k % 2]}"/>'
        for k, a in enumerate(ANGLES)
    )
    path.write_text(f"""<?xml version="1.0"?>
<robot name="{path.stem}">
  <airframe>
    <thrust_coefficient value="{thrust:.6g}"/>
    <torque_ratio value="{torque:.6g}"/>
    <max_rotor_speed value="{2 * math.pi * REVOLUTIONS:.6g}"/>
    <motor_lag up="{LAG}" down="{LAG}"/>
    <rotor_drag xy="{drag:.4g}" z="{drag:.4g}"/>
    <propeller_radius value="{RADIUS}"/>
    <ground_effect gain="1"/>
    <max_speed value="15"/>
{rotors}
  </airframe>
  <link name="base">
    <inertial>
      <mass value="{mass:.6g}"/>
      <inertia ixx="{ixx:.6g}" iyy="{iyy:.6g}" izz="{izz:.6g}"/>
    </inertial>
    <collision><geometry><cylinder radius="{ARM + RADIUS}" length="0.12"/></geometry></collision>
    <visual><geometry><box size="{x} {y} {z}"/></geometry></visual>
  </link>
</robot>
""")


def step_of_two_metres(airframe: Path, decision_hz: int = 60) -> tuple[np.ndarray, np.ndarray]:
    """Hover for 2 s, then go 2 m east for 6 s: (T, 3) positions from the start, m, and (T,) mean rotor speeds, rad/s."""
    options = {
        "airframe": str(airframe),
        "action": "target_position",
        "start": ((0.0, 0.0, 5.0),),
        "height": 5.0,
    }
    aviary = bulletuav.Aviary("hover", decision_hz=decision_hz, horizon=8 * decision_hz, **options)
    aviary.reset(seeds=0)
    track, speed = [], []
    for k in range(aviary.options.horizon):
        place = np.array((2.0 if k >= 2 * decision_hz else 0.0, 0.0, 5.0))
        aviary.step(aviary.action.encode(place.reshape(1, 1, 3)))
        track.append(aviary.swarm.position[0, 0] - (0, 0, 5))
        speed.append(aviary.swarm.rotor_speed[0, 0].mean())
    aviary.close()
    return np.array(track), np.array(speed)


def report(airframe: Airframe, track: np.ndarray, speed: np.ndarray, folder: Path) -> None:
    time = np.arange(1, len(track) + 1) / 60 - 2
    east, measured = track[time > 0, 0], speed[time <= 0][-1]
    settled = np.flatnonzero(np.abs(east - 2) > 0.1)[-1] / 60
    print(
        f"{airframe.mass:.2f} kg, inertia {', '.join(f'{moment:.4f}' for moment in airframe.inertia)} kg m^2"
    )
    print(f"thrust to weight {airframe.max_thrust / (airframe.mass * 9.80665):.2f}")
    print(
        f"hover speed {airframe.hover_speed():.1f} rad/s by formula, {measured:.1f} rad/s in the engine"
    )
    print(
        f"step of 2 m: overshoot {50 * max(0.0, east.max() - 2):.1f} %, within 5 % after {settled:.2f} s"
    )
    figure = blank_figure(8, 4.5)
    axes = figure.subplots()
    axes.plot(time, np.where(time > 0, 2.0, 0.0), "--", color="0.5", label="setpoint, east")
    axes.plot(time, track[:, 0], color="tab:red", label="east")
    axes.plot(time, track[:, 2], color="tab:blue", label="up")
    axes.set(xlabel="time (s)", ylabel="m from the start", title=airframe.name)
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(folder / "step.png", dpi=110)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--payload", type=float, default=0.0, help="kg, carried in the middle")
    parser.add_argument("--out", type=Path, default=Path("custom_airframe"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)

    urdf = args.out / "hexacopter.urdf"
    write_urdf(urdf, args.payload)
    report(bulletuav.load_airframe(urdf), *step_of_two_metres(urdf), args.out)
    print(f"{urdf} and the picture are in {args.out}")
