"""bulletuav: a drone-swarm gym on PyBullet."""

from bulletuav import interrupts  # noqa: F401  # first: it handles Ctrl-C during the others
from bulletuav.adapters.self_play import team_env
from bulletuav.analysis.evaluation import evaluate
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.envs.airspace import Airspace
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.check import check_dynamics, check_sensor, check_task
from bulletuav.envs.curriculum import curriculum_env
from bulletuav.envs.parallel import aec_env, parallel_env
from bulletuav.envs.registration import register_environments
from bulletuav.envs.workers import batch_env
from bulletuav.policies.check import check_policy
from bulletuav.policies.versus import Versus
from bulletuav.registry import register
from bulletuav.tasks import list_tasks
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.airframes import available_airframes, load_airframe
from bulletuav.version import __version__

__all__ = [
    "Airframe",
    "Airspace",
    "Aviary",
    "SetpointLevel",
    "Versus",
    "__version__",
    "aec_env",
    "available_airframes",
    "batch_env",
    "check_dynamics",
    "check_policy",
    "check_sensor",
    "check_task",
    "curriculum_env",
    "evaluate",
    "list_tasks",
    "load_airframe",
    "parallel_env",
    "register",
    "team_env",
]

register_environments()
