"""Nothing passes through anything, and every contact is recorded."""

import numpy as np
import pytest
from bench import MULTIROTORS
from contact.rig import Rig
from contact.shots import TARGETS, Range
from contact.trains import push

from bulletuav.dynamics import DYNAMICS, find_dynamics


@pytest.fixture(scope="module")
def ranges():
    """Ranges by airframe, dynamics and rate; each is built once."""
    made = {}

    def get(airframe, dynamics="rigid_body", hz=240, shots=60):
        key = airframe, dynamics, hz
        if key not in made:
            made[key] = Range(airframe, dynamics=dynamics, hz=hz, shots=shots)
        return made[key]

    yield get
    for one in made.values():
        one.rig.close()


@pytest.mark.parametrize("name", TARGETS)
@pytest.mark.parametrize("hz", [60, 240, 1000])
def test_no_shot_passes(ranges, name, hz):
    shots = ranges("cf2x", hz=hz).shoot(name)
    assert not shots.missed()
    assert shots.hits.sum() > 30


@pytest.mark.parametrize("name", TARGETS)
def test_nothing_passes_through_drones_that_spin(ranges, name):
    assert not ranges("racer").shoot(name, spin=30.0).missed()


@pytest.mark.parametrize("name", TARGETS)
@pytest.mark.parametrize("dynamics", DYNAMICS)
def test_moving_obstacles_are_met_by_all_dynamics(ranges, dynamics, name):
    missed = set(ranges("hummingbird", dynamics).shoot(name, drift=10.0).missed())
    if find_dynamics(dynamics).contacts[0] == "stop":
        # An obstacle that moves goes on through a drone that stopped
        missed -= {"beyond", "depth"}
    assert not missed


@pytest.mark.parametrize("airframe", MULTIROTORS)
def test_no_airframe_passes_the_thinnest_wall(ranges, airframe):
    shots = ranges(airframe, hz=120).shoot("wall of 2 mm")
    assert not shots.missed()
    assert np.any(shots.misses)


def test_trains_push_no_drone_through_a_wall():
    train = push("cf2x", hz=240, worlds=6, drones=5)
    assert not train.missed()


def test_energy_does_not_grow_after_a_hit_in_bullet(ranges):
    """Errors of the attitude by Bullet's step are no torques that act on after the hit."""
    shots = ranges("iris", dynamics="bullet", hz=60).shoot("corner", spin=30.0)
    assert shots.hits.sum() > 10
    assert shots.gained.max() < 1e-6


@pytest.mark.parametrize("name", TARGETS)
def test_no_drone_ends_within_a_static_shape_however_fast_it_spins(ranges, name):
    """Bullet turns bodies by pi / 4 a substep at most: that is the way that is looked at."""
    shots = ranges("cf2x", "bullet").shoot(name, spin=600.0)
    assert not {"beyond", "depth"} & set(shots.missed())


def test_a_drone_that_rolls_off_a_moving_obstacle_touches_it_once() -> None:
    """This drone leaves the end of a wire that moves at 2 m/s, where searches once gave up."""
    wire = list(TARGETS).index("wire of 2 cm")
    with Rig(["firefly"], hz=60, gravity=0.0, obstacles=list(TARGETS.values())) as rig:
        rig.obstacle[0, wire] = 9.242109607e-02, 7.275863391e-03, 9.995263270e01
        rig.turn[0, wire] = 0.115592413, -0.822031295, 0.282955357, 0.480457293
        rig.drift[0, wire] = 1.848421921, 0.145517268, -0.947346056
        swarm = rig.swarm
        swarm.position[0, 0] = 1.683501195, 1.076850313, 100.566678932
        swarm.velocity[0, 0] = 6.182716637, 0.978563538, 7.779104182
        swarm.quaternion[0, 0] = 0.333877776, 0.013555912, -0.106930069, 0.936433568
        swarm.rates[0, 0] = -9.940837260, -28.73479209, -3.461065054e-03
        rig.place().fly()
        assert rig.dynamics.contact.space.motions["impacts"][0] == 1
        assert rig.gaps(0, rig.engine.scenery.first_body + wire)[0] > 0.0


def test_a_search_of_many_steps_without_contact_records_none() -> None:
    """The search for a touch takes more than 200 steps here, beside the corner of a moving box."""
    box = list(TARGETS).index("corner")
    with Rig(["iris"], hz=60, gravity=0.0, obstacles=list(TARGETS.values())) as rig:
        rig.obstacle[0, box] = 0.010212627280, -0.10271730430, 100.06674658
        rig.turn[0, box] = -0.4383155818, 0.7678049283, 0.1893458567, -0.4272039201
        rig.drift[0, box] = 0.1531894092, -1.5407595645, 1.0011987681
        swarm = rig.swarm
        swarm.position[0, 0] = -0.063072698716, -0.82699668927, 99.650711774
        swarm.velocity[0, 0] = 1.829187668, 4.9300734101, -0.0502967701
        swarm.quaternion[0, 0] = -0.4810046409, 0.4011859175, 0.4022639236, 0.6677335777
        swarm.rates[0, 0] = -23.951834773, -19.670279150, 0.0
        assert len(rig.place().fly().world) == 0
        assert rig.dynamics.contact.space.motions["impacts"][0] == 0
        assert rig.gaps(0, rig.engine.scenery.first_body + box)[0] > 0.0
