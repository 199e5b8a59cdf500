"""Stage: wind at each drone."""

from bulletuav.compiled.program import Program
from bulletuav.envs.airspace_world import AirspaceWorld
from bulletuav.envs.stages.base import Stage
from bulletuav.envs.worlds import Worlds


class SampleWind(Stage):
    """Compute the wind, with its gusts, at the drones' positions before the flight."""

    name = "wind"
    reads = ("swarm.position", "time")
    writes = ("wind",)

    def add_to(self, program: Program, worlds: Worlds | AirspaceWorld) -> None:
        """Add the calls of the stage; see `Stage.add_to`."""
        state = worlds.state
        worlds.wind.add_to(program, state.swarm.position, state.time, state.wind)
