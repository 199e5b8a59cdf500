"""bulletuav: a drone-swarm gym on PyBullet.

Names are imported when they are first used (PEP 562): importing the package takes milliseconds, and
a program imports only the modules that it needs.
"""

import importlib
from types import ModuleType
from typing import TYPE_CHECKING, Any

from bulletuav import interrupts  # noqa: F401  # first: it handles Ctrl-C during other imports
from bulletuav.deferred_import import import_name
from bulletuav.envs.registration import register_on_import, register_plugins
from bulletuav.version import __version__ as __version__

MODULES = {
    "Airframe": "bulletuav.vehicle.airframe",
    "Airspace": "bulletuav.envs.airspace",
    "AirspaceRecorder": "bulletuav.analysis.airspace_recorder",
    "Aviary": "bulletuav.envs.aviary",
    "SetpointLevel": "bulletuav.control.setpoint",
    "Versus": "bulletuav.policies.versus",
    "aec_env": "bulletuav.envs.parallel",
    "available_airframes": "bulletuav.vehicle.airframes",
    "batch_env": "bulletuav.envs.workers",
    "check_dynamics": "bulletuav.envs.check",
    "check_policy": "bulletuav.policies.check",
    "check_sensor": "bulletuav.envs.check",
    "check_task": "bulletuav.envs.check",
    "curriculum_env": "bulletuav.envs.curriculum",
    "evaluate": "bulletuav.analysis.evaluation",
    "list_tasks": "bulletuav.tasks",
    "load_airframe": "bulletuav.vehicle.airframes",
    "make_load": "bulletuav.vehicle.load",
    "parallel_env": "bulletuav.envs.parallel",
    "register": "bulletuav.registry",
    "team_env": "bulletuav.adapters.self_play",
}
"""Module of each public name"""
__all__ = sorted([*MODULES, "__version__"])

if TYPE_CHECKING:  # the names of `MODULES` for type checkers and editors
    from bulletuav.adapters.self_play import team_env as team_env
    from bulletuav.analysis.airspace_recorder import AirspaceRecorder as AirspaceRecorder
    from bulletuav.analysis.evaluation import evaluate as evaluate
    from bulletuav.control.setpoint import SetpointLevel as SetpointLevel
    from bulletuav.envs.airspace import Airspace as Airspace
    from bulletuav.envs.aviary import Aviary as Aviary
    from bulletuav.envs.check import check_dynamics as check_dynamics
    from bulletuav.envs.check import check_sensor as check_sensor
    from bulletuav.envs.check import check_task as check_task
    from bulletuav.envs.curriculum import curriculum_env as curriculum_env
    from bulletuav.envs.parallel import aec_env as aec_env
    from bulletuav.envs.parallel import parallel_env as parallel_env
    from bulletuav.envs.workers import batch_env as batch_env
    from bulletuav.policies.check import check_policy as check_policy
    from bulletuav.policies.versus import Versus as Versus
    from bulletuav.registry import register as register
    from bulletuav.tasks import list_tasks as list_tasks
    from bulletuav.vehicle.airframe import Airframe as Airframe
    from bulletuav.vehicle.airframes import available_airframes as available_airframes
    from bulletuav.vehicle.airframes import load_airframe as load_airframe
    from bulletuav.vehicle.load import make_load as make_load
else:  # type checkers would take any name for an attribute if they saw `__getattr__`

    def __getattr__(name: str) -> Any:
        """Import a public name or a subpackage, and keep it."""
        if name in MODULES:
            found = import_name(MODULES[name], name)
            register_plugins()
        else:
            found = _import_subpackage(f"{__name__}.{name}")
            if found is None:
                raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        globals()[name] = found
        return found

    def _import_subpackage(path: str) -> ModuleType | None:
        """Import a subpackage; return None if there is none of that name."""
        try:
            return importlib.import_module(path)
        except ModuleNotFoundError as error:
            if error.name != path:
                raise
            return None

    def __dir__() -> list[str]:
        """List all names, also those that are not imported yet."""
        return sorted({*globals(), *__all__})


register_on_import()
