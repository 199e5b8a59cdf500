"""The exported C function of `foundation` in a loop as that of a flight controller."""

import ctypes
import subprocess

import numpy as np
import pytest

import bulletuav
from bulletuav.adapters import c_source
from bulletuav.adapters.deployed import deployed
from bulletuav.policies.run import FOUNDATION, SHIPPED
from bulletuav.vehicle.airframes import load_airframe

HERTZ, EACH = 500, 17
"""Rate of the loop, and ticks between calls of the policy: 29.4 Hz"""


@pytest.fixture
def make_step(tmp_path):
    """A function that compiles the C function of an airframe, and returns one that calls it."""

    def make(airframe):
        policy = deployed(SHIPPED / FOUNDATION, airframe=airframe)
        source, _ = c_source.write_c(policy, tmp_path / "pilot.c", "float")
        library = tmp_path / f"{airframe}.so"
        compiler = c_source.find_compiler()
        subprocess.run(
            [compiler, "-O2", "-shared", "-fPIC", source, "-o", library, "-lm"], check=True
        )
        function = ctypes.CDLL(str(library)).pilot
        hidden, speeds = (ctypes.c_float * policy.memory)(), (ctypes.c_float * 4)()

        def step(observed):
            function((ctypes.c_float * len(observed))(*observed), hidden, speeds)
            return np.array(speeds)

        return step

    return make


def to_body(quaternion, vector):
    x, y, z, w = quaternion
    turned = np.cross(-np.array([x, y, z]), vector)
    return vector + 2 * (w * turned + np.cross(-np.array([x, y, z]), turned))


@pytest.mark.parametrize("airframe", ["cf2x", "racer", "hummingbird"])
@pytest.mark.skipif(c_source.find_compiler() is None, reason="needs a C compiler")
def test_the_c_function_hovers_in_a_loop_of_500_hertz(airframe, make_step):
    step, body = make_step(airframe), load_airframe(airframe)
    airspace = bulletuav.Airspace(
        [(0.5, -0.5, 2.5)],
        airframe,
        dynamics="rigid_body",
        physics_hz=HERTZ,
        decision_hz=HERTZ,
        rotor_speed=body.hover_speed(),
    )
    goal, speeds, action, errors = np.array([0.0, 0.0, 3.0]), None, np.zeros(4), []
    for k in range(8 * HERTZ):
        swarm = airspace.swarm
        if k % EACH == 0:
            turn, rates = swarm.quaternion[0], swarm.rates[0]
            vectors = (goal - swarm.position[0], swarm.velocity[0], np.array([0.0, 0.0, 1.0]))
            seen = [to_body(turn, one) for one in vectors]
            speeds = step(np.concatenate([*seen, rates, action]))
            action = 2.0 * (speeds / body.max_rotor_speed) ** 2 - 1.0
        airspace.command(0, bulletuav.SetpointLevel.ROTOR, speeds)
        airspace.step()
        errors.append(np.linalg.norm(airspace.swarm.position[0] - goal))
    airspace.close()
    assert max(errors[-2 * HERTZ :]) < 0.1
