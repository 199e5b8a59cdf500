"""Dynamics by name, one file a level of detail: how drones move under setpoints.

A dynamics is one substep of flight; contacts are dealt with for all of them, see `base`.
"""

from bulletuav.dynamics.base import Dynamics
from bulletuav.registry import find, require_declared

DYNAMICS = ("single_integrator", "double_integrator", "point_mass", "rigid_body", "bullet")
"""Names of the package's own dynamics, the cheapest first"""


def find_dynamics(source: str | type[Dynamics]) -> type[Dynamics]:
    """Find a dynamics.

    Args:
        source: A name, `module:Name`, or a class derived from `Dynamics`.

    Returns:
        The class, which is called with a `Flight`.

    Raises:
        ValueError: There is none of that name (the nearest are listed), what was given is no class
            derived from `Dynamics`, or the class has an unknown public attribute.
    """
    found: type[Dynamics] = find("dynamics", source, _is_dynamics)
    require_declared("dynamics", found, Dynamics)
    return found


def _is_dynamics(candidate: object) -> bool:
    """Tell whether an object is a class derived from `Dynamics`."""
    return isinstance(candidate, type) and issubclass(candidate, Dynamics)
