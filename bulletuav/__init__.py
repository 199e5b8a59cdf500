"""bulletuav: a drone-swarm gym on PyBullet."""

from bulletuav.envs.aviary import Aviary
from bulletuav.envs.parallel import parallel_env
from bulletuav.physics.airframe import Airframe, available_airframes, load_airframe
from bulletuav.tasks import list_tasks
from bulletuav.version import __version__

__all__ = ["Airframe", "Aviary", "__version__", "available_airframes", "list_tasks", "load_airframe", "parallel_env"]
