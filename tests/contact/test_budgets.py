"""Drones with budget left touch nothing: checking them in each substep changes no bit."""

import numpy as np
import pytest
from contact.rig import Rig, random_attitudes

from bulletuav.geometry.obstacle import Obstacle


def hop(recheck, dynamics, airframe):
    """Fly spinning drones low over the ground; return states, contacts and number of checks."""
    rng = np.random.default_rng(3)
    worlds = 40
    with Rig([airframe] * 2, dynamics=dynamics, worlds=worlds, restitution=0.8) as rig:
        radius = rig.airframes[0].collision_radius
        rig.swarm.position[:, 1, 0] = rng.uniform(2.1, 4.0, worlds) * radius
        rig.swarm.position[..., 2] = rng.uniform(1.05, 1.5, (worlds, 2)) * radius
        rig.swarm.velocity[:] = rng.normal(size=(worlds, 2, 3)) * 0.3
        rig.swarm.quaternion[:] = random_attitudes(rng, worlds, 2)
        if rig.contacts == "impulse":
            rig.swarm.rates[:] = rng.normal(size=(worlds, 2, 3)) * 8.0
        rig.place()
        states, touches, looks = [], [], 0
        for _ in range(150):
            if recheck:
                rig.dynamics.contact.budget[:] = -1.0
            budget = rig.dynamics.contact.budget.copy()
            touches.append(rig.fly())
            states.append([one.copy() for one in rig.swarm])
            # Only a checked drone gets more budget
            looks += (rig.dynamics.contact.budget > budget).sum()
        return states, touches, looks


@pytest.mark.parametrize(
    ("dynamics", "airframe"),
    [
        ("rigid_body", "cf2x"),
        ("rigid_body", "iris"),
        ("bullet", "cf2x"),
        ("double_integrator", "cf2x"),
    ],
)
def test_looking_in_each_substep_changes_nothing(dynamics, airframe):
    states, touches, looks = hop(False, dynamics, airframe)
    all_states, all_touches, all_looks = hop(True, dynamics, airframe)
    for one, other in zip(states, all_states, strict=True):
        assert all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))
    for one, other in zip(touches, all_touches, strict=True):
        assert all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))
    assert sum(len(one.world) for one in touches) > 20
    assert looks < 0.75 * all_looks


def test_drones_close_to_the_ground_are_seldom_checked():
    """The sphere about it reaches into the ground all the time."""
    with Rig(["cf2x"], gravity=0.0) as rig:
        rig.swarm.position[..., 2] = 0.04
        rig.swarm.velocity[..., 0] = 0.3
        rig.swarm.rates[..., 2] = 1.0
        rig.place()
        looks = 0
        for _ in range(240):
            budget = rig.dynamics.contact.budget.copy()
            assert len(rig.fly().world) == 0
            looks += (rig.dynamics.contact.budget > budget).sum()
        # 0.3 m, and 1 rad of the outermost points, over the 24 mm that are free
        assert 10 < looks < 20


@pytest.mark.parametrize("airframe", ["cf2x", "iris"])
@pytest.mark.parametrize("stands", ["obstacle", "city"])
def test_a_drone_that_lands_next_to_a_sleeping_one_touches_it(stands, airframe):
    """The budget of a sleeper close by a box is below zero: that is no room for others."""
    obstacles = [Obstacle("box", (6.0, 6.0, 0.2))] if stands == "obstacle" else []
    boxes = [((-3, -3, 0), (3, 3, 0.2))] if stands == "city" else []
    with Rig([airframe] * 2, gravity=1.0, obstacles=obstacles, boxes=boxes) as rig:
        radius, _, half = rig.airframes[0].shape.half
        if obstacles:
            rig.obstacle[:] = (0, 0, 0.1)
        # The other one stands on its rim and hits that of the sleeper
        top = 0.2 + half
        rig.swarm.position[0] = (0, 0, top + 1e-4), (1.3 * radius, 0, top + 2.5 * radius)
        rig.swarm.quaternion[0, 1] = (np.sqrt(0.5), 0, 0, np.sqrt(0.5))
        rig.place()
        slept, recorded, least = False, False, np.inf
        for _ in range(400):
            found = rig.fly()
            slept = slept or rig.dynamics.contact.asleep[0, 0]
            recorded = recorded or ((found.drone == 1) & (found.other == 0)).any()
            least = min(least, rig.gaps(0, 1)[0])
    assert slept
    assert recorded
    assert least > 0
