"""Stage: separations and collisions."""

import numpy as np

from bulletuav.compiled.program import Program
from bulletuav.envs.stages.base import Stage
from bulletuav.envs.worlds import Worlds
from bulletuav.tasks.frame_measures import add_frame_measures, mark_contacts, mark_landings


class Separate(Stage):
    """Compute separations, conflicts, collisions, landings and distances to goals."""

    name = "separate"
    reads = ("before", "swarm", "scene.goal", "flown", "readings", "dynamics")
    writes = ("account",)

    def add_to(self, program: Program, worlds: Worlds) -> None:
        """Add the calls of the stage; see `Stage.add_to`."""
        account, frame = worlds.account, worlds.frame
        add_frame_measures(program, account, frame, worlds.dynamics.contact)
        if worlds.collects_contacts:

            def mark() -> None:
                # Compiled code has marked all other contacts
                if worlds.contacts.is_collected or worlds.options.contacts == "bullet":
                    mark_contacts(account, frame)

            program.callback(mark)
        if worlds.task.lands:
            standing = np.array(worlds.task.context.standing_height)
            places = worlds.task.landing_places
            program.callback(lambda: mark_landings(account, frame, standing, places))
