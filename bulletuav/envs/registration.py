"""Registration of all tasks with Gymnasium and PettingZoo."""

import gymnasium
import pettingzoo

from bulletuav.envs import gymnasium as central
from bulletuav.envs import parallel
from bulletuav.tasks import list_tasks


def register_environments() -> None:
    """Register every task for `gymnasium.make`, `gymnasium.make_vec` and `pettingzoo.make`."""
    for task in list_tasks():
        name, options = central.environment_id(task), {"task": task}
        gymnasium.register(
            name,
            entry_point=f"{central.__name__}:CentralAviary",
            vector_entry_point=f"{central.__name__}:CentralVectorAviary",
            kwargs=options,
        )
        # PettingZoo before 1.27 has no registry
        if hasattr(pettingzoo, "register"):
            pettingzoo.register(
                "parallel", name, f"{parallel.__name__}:parallel_env", kwargs=options
            )
            pettingzoo.register("aec", name, f"{parallel.__name__}:aec_env", kwargs=options)
