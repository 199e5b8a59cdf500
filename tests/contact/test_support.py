"""What loads a drone at rest bears: known ones by hand, and agreement with the full solution."""

import numpy as np
import pytest
from contact.rig import Rig

from bulletuav.contact.resting_support import SUPPORT, compute_support_force
from bulletuav.control.setpoint import SetpointLevel

MASS = 2.0


def support(span=0.1, height=0.03, friction=0.5):
    """Give what a drone on level ground rests on."""
    row = np.zeros(1, dtype=SUPPORT).view(np.recarray)[0]
    row.normal[:] = 0, 0, 1
    row.height, row.span, row.friction = height, span, friction
    return row


def pressed(force, torque=(0.0, 0.0, 0.0), **shape):
    """Return the support force of a load, and whether it is carried."""
    acceleration = tuple(float(one) / MASS for one in force)
    return compute_support_force.py_func(support(**shape), MASS, acceleration, tuple(torque))


@pytest.mark.parametrize(
    ("force", "torque", "bears"),
    [
        ((0, 0, -10), (0, 0, 0), True),
        ((0, 0, 1), (0, 0, 0), False),  # lifts off
        ((2.4, 0, -10), (0, 0, 0), True),  # half of the friction of 5 N
        ((2.6, 0, -10), (0, 0, 0), False),  # presses, although it may slide
        ((0, 0, -10), (0, 0.49, 0), True),  # half of 10 N at .1 m
        ((0, 0, -10), (0, 0.51, 0), False),
        ((0, 0, -10), (0, 0, 0.24), True),  # turned about the normal at .1 m
        ((0, 0, -10), (0, 0, 0.26), False),
        # Pulled at .03 m above the surface: .06 N m towards the pull, on top of .45
        ((2.0, 0, -10), (0, 0.45, 0), False),
        ((2.0, 0, -10), (0, -0.45, 0), True),
    ],
)
def test_what_is_borne(force, torque, bears):
    press, borne = pressed(force, torque)
    assert borne == bears
    assert press == pytest.approx(max(0.0, -force[2]))


def test_no_base_bears_nothing():
    assert pressed((0, 0, -10), span=0.0) == (0.0, False)


@pytest.mark.parametrize("dynamics", ["rigid_body", "bullet"])
def test_sleeping_drones_record_the_load_that_rotors_leave(dynamics):
    """Half of the weight presses when rotors carry the other half; then it wakes and flies."""
    with Rig(("cf2x",), dynamics=dynamics, substeps=24) as rig:
        rig.swarm.position[..., 2] = rig.airframes[0].shape.half[2] + 5e-5
        rig.place()
        for _ in range(10):
            rig.fly()
        assert rig.dynamics.contact.asleep.all()
        half = np.full(4, rig.airframes[0].hover_speed() * np.sqrt(0.5))
        for _ in range(10):
            contacts = rig.fly(SetpointLevel.ROTOR, half)
        assert rig.dynamics.contact.asleep.all()
        weight = rig.airframes[0].mass * rig.gravity
        assert contacts.impulse == pytest.approx(0.5 * weight * 24 * rig.dt, rel=1e-3)
        rig.fly(SetpointLevel.ROTOR, 2 * half)
        assert not rig.dynamics.contact.asleep.any()
        assert rig.swarm.velocity[0, 0, 2] > 0.1


def test_uneven_rotors_tip_it_over_as_if_it_never_slept():
    """Two rotors on one side lift that side: sleeping drones and others must rise."""
    risen = []
    for wait in (0, 10):
        with Rig(("cf2x",), substeps=24) as rig:
            rig.swarm.position[..., 2] = rig.airframes[0].shape.half[2] + 5e-5
            rig.place()
            for _ in range(wait):
                rig.fly()
            assert rig.dynamics.contact.asleep.all() == (wait > 0)
            speed = 1.3 * rig.airframes[0].hover_speed()
            for _ in range(3):
                rig.fly(SetpointLevel.ROTOR, [speed, speed, 0.0, 0.0])
            risen.append(rig.swarm.quaternion[0, 0].copy())
    assert abs(risen[0][:2]).max() > 0.01
    np.testing.assert_allclose(risen[0], risen[1], atol=0.02)
