"""Policy `carrier_oracle`: the control of `carrier` with the true state of drones and loads."""

import numpy as np

from bulletuav.policies.carrier import Carrier, LoadView
from bulletuav.registry import register
from bulletuav.tasks.observations.observer import Observation
from bulletuav.tasks.parts.loads import POSITION, VELOCITY
from bulletuav.vehicle.swarm import Swarm


@register("policy")
class CarrierOracle(Carrier):
    """Policy `carrier` without noise, bias and loss of positions."""

    name = "carrier_oracle"
    reads_swarm = True

    def view(self, observations: Observation, swarm: Swarm) -> LoadView:
        """Return the true load as each drone would observe it; see `Carrier.view`."""
        memory, shape = self.aviary.scene.memory, swarm.position.shape
        position = memory[POSITION][:, :1]
        return LoadView(
            offset=np.broadcast_to(memory["place"][:, None] - position, shape),
            position=position - swarm.position,
            velocity=np.broadcast_to(memory[VELOCITY][:, :1], shape),
            end=self.task.loads.find_ends(memory) - swarm.position,
        )
