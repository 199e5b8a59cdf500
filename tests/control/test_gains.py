"""Gains: the mixer is the exact pseudo-inverse."""

import numpy as np
import pytest
from bench import MULTIROTORS

from bulletuav import load_airframe
from bulletuav.control.gains import exact_pseudo_inverse, gain_rows


@pytest.mark.parametrize("name", MULTIROTORS)
def test_the_mixer_is_the_pseudo_inverse_of_the_rotors_allocation(name):
    airframe = load_airframe(name)
    allocation = airframe.allocation()
    mixer = gain_rows([airframe], 10.0)[0]["mixer"][: len(airframe.rotors)]
    np.testing.assert_allclose(mixer, np.linalg.pinv(allocation), rtol=1e-12, atol=1e-12)
    rounding = 4 * np.finfo(float).eps * (np.abs(allocation) @ np.abs(mixer))
    assert (np.abs(allocation @ mixer - np.eye(4)) <= rounding).all()
    np.testing.assert_array_equal(mixer, exact_pseudo_inverse(allocation))


def test_an_x_mixes_by_hand():
    """Rotors at (+-1, +-1) m, torque 0.5 m: a quarter of thrust and moments, half of the yaw."""
    x, y, turn = np.array([(1, -1, -1), (-1, -1, 1), (-1, 1, -1), (1, 1, 1)]).T
    allocation = np.array([np.ones(4), y, -x, 0.5 * turn])
    expected = np.array([np.ones(4), y, -x, 2 * turn]).T / 4
    np.testing.assert_array_equal(exact_pseudo_inverse(allocation), expected)


def test_rounding_does_not_depend_on_the_order_of_the_rotors():
    """Which a library's sums do: the exact inverse is permuted, to the bit."""
    allocation = load_airframe("firefly").allocation()
    order = [3, 0, 5, 1, 4, 2]
    np.testing.assert_array_equal(
        exact_pseudo_inverse(allocation[:, order]), exact_pseudo_inverse(allocation)[order]
    )


def test_a_pivot_that_is_zero_is_exchanged():
    matrix = np.array([[0.0, 1.0], [1.0, 0.0]])
    np.testing.assert_array_equal(exact_pseudo_inverse(matrix), matrix)
