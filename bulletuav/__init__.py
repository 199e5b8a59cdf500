"""bulletuav: a drone-swarm gym on PyBullet."""

from bulletuav.analysis.evaluation import evaluate
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.curriculum import curriculum_env
from bulletuav.envs.gymnasium import register_environments
from bulletuav.envs.parallel import aec_env, parallel_env
from bulletuav.envs.workers import batch_env
from bulletuav.tasks import list_tasks
from bulletuav.vehicle.airframe import Airframe, available_airframes, load_airframe
from bulletuav.version import __version__

__all__ = [
    "Airframe",
    "Aviary",
    "__version__",
    "aec_env",
    "available_airframes",
    "batch_env",
    "curriculum_env",
    "evaluate",
    "list_tasks",
    "load_airframe",
    "parallel_env",
]

register_environments()
