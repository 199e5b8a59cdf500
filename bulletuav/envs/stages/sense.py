"""Stage: sensors."""

from bulletuav.compiled.program import Program
from bulletuav.envs.stages.base import Stage
from bulletuav.envs.worlds import Worlds


class Sense(Stage):
    """Measure with all sensors: range finders, cameras, positions, radio."""

    name = "sense"
    reads = ("before", "swarm", "scene", "flown", "steps", "rng")
    writes = ("readings",)

    def add_to(self, program: Program, worlds: Worlds) -> None:
        """Add the calls of the stage; see `Stage.add_to`."""
        state = worlds.state
        if worlds.sensors.sensors:
            program.callback(lambda: worlds.measure(state.before, state.swarm, state.flown))
