"""Neural-Swarm: logs of Crazyflies that fly near each other and near the ground, at 100 Hz.

G. Shi et al., Neural-Swarm (ICRA 2020), Neural-Swarm2 (T-RO 2021). The repository has no licence:
figures alone are derived from it. The package reads the logs.
"""

from bulletuav.reproduction.swarm_logs import SWARM_COLUMNS as COLUMNS
from bulletuav.reproduction.swarm_logs import SWARM_DT as DT
from bulletuav.reproduction.swarm_logs import SWARM_STATE as STATE
from bulletuav.reproduction.swarm_logs import SwarmLog as Log
from bulletuav.reproduction.swarm_logs import decompress_quaternions as decompress
from bulletuav.reproduction.swarm_logs import find_training_folder as training
from bulletuav.reproduction.swarm_logs import read_swarm_log as load

REPOSITORY, LICENCE = "neural-swarm", "none: figures only"

__all__ = [
    "COLUMNS",
    "DT",
    "LICENCE",
    "REPOSITORY",
    "STATE",
    "Log",
    "decompress",
    "load",
    "training",
]
