"""Dynamics models by name, one file for each level of detail: how drones move under setpoints.

A dynamics model integrates one substep of flight. The base class resolves contacts for all models,
see `bulletuav.dynamics.base`.
"""

import functools
import warnings

from bulletuav.dynamics.base import Dynamics
from bulletuav.engine.calls import HAS_BULLET
from bulletuav.errors import install
from bulletuav.registry import find, require_declared

DYNAMICS = ("single_integrator", "double_integrator", "point_mass", "rigid_body", "bullet")
"""Names of the built-in dynamics, the cheapest first"""
DEFAULT_DYNAMICS = "bullet" if HAS_BULLET else "rigid_body"
"""Name of the dynamics that flies if none is given"""


def default_dynamics(contacts: object = None) -> str:
    """Return `DEFAULT_DYNAMICS`; warn once in a process if PyBullet is not installed.

    Args:
        contacts: Value of the option `contacts`. Bullet's contacts need dynamics "bullet".

    Returns:
        The name of the dynamics.
    """
    if isinstance(contacts, str) and contacts == "bullet":
        return "bullet"
    _warn_without_bullet()
    return DEFAULT_DYNAMICS


@functools.cache
def _warn_without_bullet() -> None:
    """Warn if the default is another dynamics than on a machine with PyBullet."""
    if DEFAULT_DYNAMICS != "bullet":
        warnings.warn(
            f"PyBullet is not installed, so the default dynamics is {DEFAULT_DYNAMICS!r} instead "
            f"of 'bullet': the same forces, integrated differently (about 2 cm apart after a "
            f"second), so that results have other bits; name the dynamics to fly the same on all "
            f"machines, or install PyBullet: {install('bullet')}",
            stacklevel=3,
        )


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
