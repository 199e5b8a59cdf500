"""A simulation of an airspace: its parts and state, and the stages of a step in their order."""

from bulletuav.compiled.program import Program
from bulletuav.envs.airspace_world import AirspaceWorld
from bulletuav.envs.stages import Stage, airspace_stages
from bulletuav.envs.stages.base import inserted, programs_of, table


class AirspaceSimulation:
    """One world of N drones that hold setpoints, step by step; `print` shows the stages.

    Attributes:
        world: Parts and state.
        stages: Stages of a step, in their order; see `insert`.
        program: Calls of a step; None before the first one.
    """

    def __init__(self, world: AirspaceWorld) -> None:
        """Make a simulation of a world."""
        self.world, self.stages = world, airspace_stages()
        self.program: Program | None = None

    def __repr__(self) -> str:
        """Show the stages, with what each reads and writes."""
        dynamics, drones = self.world.options.dynamics_name, self.world.state.alive.shape[1]
        return f"airspace in {dynamics}: {drones} drones\n{table(self.stages)}"

    def insert(self, stage: Stage, after: str | None = None, *, before: str | None = None) -> None:
        """Insert a stage of one's own; see `Simulation.insert`."""
        self.stages, self.program = inserted(self.stages, stage, after, before), None

    def look(self) -> None:
        """Take over what stands now; a program knows only what stood when it was made."""
        if self.world.dynamics.look_around():
            self.program = None

    def step(self) -> None:
        """Fly one step."""
        self.look()
        program = self.program or self.make_program()
        try:
            program.run()
        except BaseException:
            # So that `Airspace.place` is enough to go on
            self.world.dynamics.force[:] = self.world.dynamics.torque[:] = 0.0
            raise

    def make_program(self) -> Program:
        """Make the program of a step."""
        program = Program()
        for stage in self.stages:
            stage.add_to(program, self.world)
        program.compile()  # now, so that the first step takes no longer than others
        self.program = program
        return program

    def stage_programs(self) -> dict[str, Program]:
        """Make a program of each stage alone, by its name."""
        return programs_of(self.stages, self.world)
