"""Dynamics models by name, one file for each level of detail: how drones move under setpoints.

A dynamics model integrates one substep of flight. The base class resolves contacts for all models,
see `bulletuav.dynamics.base`.
"""

from bulletuav.dynamics.base import Dynamics
from bulletuav.registry import find, require_declared

DYNAMICS = ("single_integrator", "double_integrator", "point_mass", "rigid_body", "bullet")
"""Names of the built-in dynamics, the cheapest first"""


def find_dynamics(source: str | type[Dynamics]) -> type[Dynamics]:
    """Find a dynamics class by its name.

    Args:
        source: A registered name, `module:Name`, or a class derived from `Dynamics`.

    Returns:
        The class. It is constructed with a `FlightSetup`.

    Raises:
        ValueError: If no dynamics has that name (the message lists the nearest names), if `source`
            is not a class derived from `Dynamics`, or if the class has an unknown public attribute.
    """
    found: type[Dynamics] = find("dynamics", source, _is_dynamics)
    require_declared("dynamics", found, Dynamics)
    return found


def _is_dynamics(candidate: object) -> bool:
    """Check whether an object is a class derived from `Dynamics`."""
    return isinstance(candidate, type) and issubclass(candidate, Dynamics)
