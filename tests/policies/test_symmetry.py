"""Drones that meet in perfect symmetry, where nothing but a rule of the road decides."""

import numpy as np
import pytest

import bulletuav
from bulletuav.policies import find_policy
from bulletuav.tasks.converge import Converge
from bulletuav.tasks.frame import Spawn

POINTS = ("single_integrator", "double_integrator", "point_mass")
BODIES = ("rigid_body", "bullet")
EXACT = {"randomization": {}, "jitter": 0.0, "start_speed": (10.0, 10.0), "horizon": 300}


class Lift(Converge):
    """Two drones, one above the other, exchange heights."""

    name = "lift"

    def spawn(self, rng):
        places = np.array([(0.0, 0.0, 20.0), (0.0, 0.0, 60.0)])
        n = self.context.num_drones
        return Spawn(position=places[:n], goal=places[::-1][:n].copy())


def flown(task, policy, **options):
    """Fly one episode: decisions, conflicts, collisions, and who succeeded."""
    aviary = bulletuav.Aviary(task, **{**EXACT, **options})
    observations = aviary.reset(seeds=0)
    pilot = find_policy(policy)(aviary)
    decisions, conflicts, collisions = 0, 0, 0
    success = np.zeros(aviary.alive.shape, bool)
    while aviary.alive.any():
        step = aviary.step(pilot.act(observations, aviary.swarm))
        observations = step.observations
        decisions += 1
        conflicts += step.info["conflicts"].sum() // 2
        collisions += step.info["collision"].sum()
        success |= step.info["success"]
    aviary.close()
    return decisions, conflicts, collisions, success.all()


CASES = [(task, n) for task, n in (("converge", 2), ("converge", 4), ("converge", 12), (Lift, 2))]


@pytest.mark.parametrize(("task", "num_drones"), CASES)
@pytest.mark.parametrize(
    "dynamics", [*POINTS, *(pytest.param(one, marks=pytest.mark.slow) for one in BODIES)]
)
def test_orca_takes_at_most_twice_the_time_of_flight_straight(task, num_drones, dynamics):
    options = {"num_drones": num_drones, "dynamics": dynamics}
    # One alone, which nobody stops.
    straight, _, _, _ = flown(task, "straight", **options | {"num_drones": 1})
    decisions, conflicts, collisions, success = flown(task, "orca", **options)
    assert success
    assert conflicts == collisions == 0
    assert decisions <= 2 * straight


@pytest.mark.parametrize("policy", ["mvp", "voronoi"])
@pytest.mark.parametrize(("task", "num_drones"), [CASES[1], CASES[3]])
def test_others_arrive_too(policy, task, num_drones):
    options = {"num_drones": num_drones, "dynamics": "single_integrator"}
    _, conflicts, collisions, success = flown(task, policy, **options)
    assert success
    assert conflicts == collisions == 0


def test_symmetry_stays():
    """Four that meet do the same, each turned by a right angle."""
    aviary = bulletuav.Aviary("converge", num_drones=4, dynamics="single_integrator", **EXACT)
    observations = aviary.reset(seeds=0)
    pilot = find_policy("orca")(aviary)
    for _ in range(60):
        observations = aviary.step(pilot.act(observations, aviary.swarm)).observations
    east, north, _ = aviary.swarm.position[0].T
    np.testing.assert_allclose(east[1:], -north[:-1], atol=1e-6)
    np.testing.assert_allclose(north[1:], east[:-1], atol=1e-6)
    aviary.close()


@pytest.mark.slow
@pytest.mark.parametrize("dynamics", POINTS)
def test_a_hundred_points_meet_with_hardly_a_conflict(dynamics):
    """With 32 neighbours there were 22 conflicts an episode."""
    options = {"difficulty": "extreme", "dynamics": dynamics, "randomization": {}}
    aviary = bulletuav.Aviary("converge", 4, turbulence=None, **options)
    observations = aviary.reset(seeds=0)
    pilot = find_policy("orca")(aviary)
    conflicts = collisions = 0
    while aviary.alive.any():
        step = aviary.step(pilot.act(observations, aviary.swarm))
        observations = step.observations
        conflicts += step.info["conflicts"].sum() // 2
        collisions += step.info["collision"].sum()
    aviary.close()
    assert collisions == 0
    assert conflicts <= 3 * 4
