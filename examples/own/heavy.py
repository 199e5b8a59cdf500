"""A custom airframe, defined in heavy.urdf; this program prints its properties and flies it.

Run it:

    python examples/own/heavy.py
    cd examples/own && bulletuav fly hover --airframe heavy.urdf --set d_safe=2 --out out
"""

from pathlib import Path
from typing import Any

import bulletuav
from bulletuav.vehicle.airframe import STANDARD_GRAVITY

HEAVY = Path(__file__).with_name("heavy.urdf")


def main() -> None:
    """Load the airframe, which checks each value, and compare it with a lighter one."""
    airframe = bulletuav.load_airframe(HEAVY)
    lift = airframe.max_thrust / (airframe.mass * STANDARD_GRAVITY)
    print(f"{airframe.name}: {airframe.mass:g} kg, {len(airframe.rotors)} rotors", end=", ")
    print(f"{lift:.1f} times its weight of thrust, hovers at {airframe.hover_speed():.0f} rad/s")

    room: dict[str, Any] = {
        "d_safe": 2.0,
        "height": 8.0,
        "spacing": 6.0,
        "action": "velocity",
        "energy": "actuator",
    }
    bulletuav.check_dynamics("bullet", airframe=HEAVY, **room)
    for drone in (HEAVY, "hummingbird"):
        result = bulletuav.evaluate("hover", "straight", 10, airframe=drone, **room)
        figures = result.estimates()
        distance, energy = figures["goal_distance"].mean, figures["energy"].mean
        print(f"{Path(drone).stem}: {distance:.3f} m from its goal after 8 s, for {energy:.0f} J")


if __name__ == "__main__":
    main()
