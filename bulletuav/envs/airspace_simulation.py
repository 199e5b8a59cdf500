"""Simulation of an airspace: the stages of a step in their order."""

from bulletuav.compiled.program import Program
from bulletuav.envs.airspace_world import AirspaceWorld
from bulletuav.envs.stages import Stage, airspace_stages
from bulletuav.envs.stages.base import format_stages, insert_stage, stage_programs_of


class AirspaceSimulation:
    """Simulates one world of N drones that hold setpoints, step by step; `print` lists the stages.

    Attributes:
        world: Components and state of the world.
        stages: Stages of a step, in their order; see `insert`.
        program: Calls of a step; None before the first step.
    """

    def __init__(self, world: AirspaceWorld) -> None:
        """Create a simulation of a world."""
        self.world, self.stages = world, airspace_stages()
        self.program: Program | None = None

    def __repr__(self) -> str:
        """Return a table of the stages, with the arrays that each reads and writes."""
        dynamics, drones = self.world.options.dynamics_name, self.world.state.alive.shape[1]
        return f"airspace in {dynamics}: {drones} drones\n{format_stages(self.stages)}"

    def insert(self, stage: Stage, after: str | None = None, *, before: str | None = None) -> None:
        """Insert a custom stage; see `Simulation.insert`."""
        arrays = self.world.state.named()
        self.stages = insert_stage(self.stages, stage, arrays, after, before)
        self.program = None

    def update_scene(self) -> None:
        """Update the program if bodies changed since it was made."""
        if self.world.dynamics.look_around():
            self.program = None

    def step(self) -> None:
        """Simulate one step."""
        self.update_scene()
        program = self.program or self.make_program()
        try:
            program.run()
        except BaseException:
            # Then `Airspace.place` is enough to continue
            self.world.dynamics.force[:] = self.world.dynamics.torque[:] = 0.0
            raise

    def make_program(self) -> Program:
        """Make the program of a step."""
        program = Program(self.world.options.threads)
        for stage in self.stages:
            stage.add_to(program, self.world)
        program.compile()  # now, so that the first step is as fast as later ones
        self.program = program
        return program

    def stage_programs(self) -> dict[str, Program]:
        """Make a program of each stage alone, by its name."""
        return stage_programs_of(self.stages, self.world)
