"""Stage: events of the episodes."""

from bulletuav.compiled.program import Program
from bulletuav.envs.stages.base import Stage
from bulletuav.envs.worlds import Worlds


class ApplyEvents(Stage):
    """Change drones, wind and gravity by the events that are due, with option `events`."""

    name = "events"
    reads = ("time", "flying")
    writes = ("dynamics", "energy", "engine")

    def add_to(self, program: Program, worlds: Worlds) -> None:
        """Add the calls of the stage; see `Stage.add_to`."""
        state = worlds.state
        program.callback(lambda: worlds.schedule.apply_due(state.time, state.flying))
