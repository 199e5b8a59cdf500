"""Stage: observations."""

from bulletuav.compiled.program import Program
from bulletuav.envs.stages.base import Stage
from bulletuav.envs.worlds import Worlds


class Observe(Stage):
    """Write the observations of all drones."""

    name = "observe"
    reads = ("action", "swarm", "scene", "flown", "present", "account", "readings")
    writes = ("observations",)

    def add_to(self, program: Program, worlds: Worlds) -> None:
        """Add the calls of the stage; see `Stage.add_to`."""
        self.add_observation(program, worlds)
        if worlds.options.render_mode == "human":
            program.callback(lambda: self._show(worlds))

    def add_observation(self, program: Program, worlds: Worlds) -> None:
        """Add that observations are written, without updating the live window."""
        worlds.observer.add_to(program, worlds.frame, worlds.vector)

    def _show(self, worlds: Worlds) -> None:
        state = worlds.state
        worlds.show(state.swarm, state.alive)
        worlds.renderer.show(state.swarm, state.alive, 1 / worlds.options.decision_hz)
