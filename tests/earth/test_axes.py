"""Axes against matrices of scipy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from bulletuav.earth import (
    attitude_to_enu,
    attitude_to_ned,
    enu_to_ned,
    flu_to_frd,
    frd_to_flu,
    ned_to_enu,
)

number = st.floats(-3, 3)
vectors = st.tuples(number, number, number)
quaternions = st.tuples(number, number, number, number).filter(lambda q: np.linalg.norm(q) > 0.1)

EAST_NORTH_UP = np.array([(0, 1, 0), (1, 0, 0), (0, 0, -1)])
FORWARD_LEFT_UP = np.diag((1, -1, -1))


def test_vectors_by_hand():
    np.testing.assert_array_equal(enu_to_ned((1, 2, 3)), (2, 1, -3))
    np.testing.assert_array_equal(ned_to_enu((1, 2, 3)), (2, 1, -3))
    np.testing.assert_array_equal(flu_to_frd((1, 2, 3)), (1, -2, -3))
    np.testing.assert_array_equal(frd_to_flu((1, 2, 3)), (1, -2, -3))


@given(vectors)
def test_vectors_come_back(vector):
    np.testing.assert_array_equal(ned_to_enu(enu_to_ned(vector)), vector)
    np.testing.assert_array_equal(frd_to_flu(flu_to_frd(vector)), vector)


@given(quaternions)
def test_attitudes_agree_with_matrices_of_scipy(q):
    expected = EAST_NORTH_UP @ Rotation.from_quat(q).as_matrix() @ FORWARD_LEFT_UP
    ned = Rotation.from_quat(attitude_to_ned(q)).as_matrix()
    np.testing.assert_allclose(ned, expected, atol=1e-12)
    enu = Rotation.from_quat(attitude_to_enu(q)).as_matrix()
    np.testing.assert_allclose(enu, expected, atol=1e-12)


@given(quaternions)
def test_attitudes_come_back_with_sign_and_length(q):
    ned = attitude_to_ned(q)
    np.testing.assert_allclose(attitude_to_enu(ned), q, atol=1e-14)
    assert np.linalg.norm(ned) == pytest.approx(np.linalg.norm(q))


@given(quaternions, vectors)
def test_a_body_vector_turned_before_or_after_is_the_same(q, vector):
    before = enu_to_ned(Rotation.from_quat(q).apply(vector))
    after = Rotation.from_quat(attitude_to_ned(q)).apply(flu_to_frd(vector))
    np.testing.assert_allclose(before, after, atol=1e-12)


@given(st.floats(-3, 3), st.floats(-1.5, 1.5), st.floats(-3, 3))
def test_euler_angles_of_both_sides(roll, pitch, yaw):
    """Roll is the same, pitch the opposite, and yaw counts from north to the right."""
    here = Rotation.from_euler("ZYX", (yaw, pitch, roll)).as_quat()
    there = Rotation.from_euler("ZYX", (np.pi / 2 - yaw, -pitch, roll)).as_matrix()
    converted = Rotation.from_quat(attitude_to_ned(here)).as_matrix()
    np.testing.assert_allclose(converted, there, atol=1e-12)


def test_scalars_first():
    q = np.array([(0.1, 0.2, 0.3, 0.9), (0.0, 0.0, 0.0, 1.0)])
    last = attitude_to_ned(q)
    first = attitude_to_ned(q, scalar_first=True)
    np.testing.assert_array_equal(first, last[:, (3, 0, 1, 2)])
    np.testing.assert_allclose(attitude_to_enu(first, scalar_first=True), q, atol=1e-15)
    # Level and looking north: w is 1 there, and a left turn of 90 degrees here.
    north = attitude_to_enu((1, 0, 0, 0), scalar_first=True)
    np.testing.assert_allclose(north, (0, 0, 0.5**0.5, 0.5**0.5), atol=1e-15)


def test_axes_before_the_last_are_kept_and_arguments_are_not_changed():
    rng = np.random.default_rng(0)
    for convert, size in ((enu_to_ned, 3), (flu_to_frd, 3), (attitude_to_ned, 4)):
        value = rng.normal(size=(2, 5, size))
        copy = value.copy()
        converted = convert(value)
        assert converted.shape == value.shape
        np.testing.assert_array_equal(converted[1, 3], convert(value[1, 3]))
        np.testing.assert_array_equal(value, copy)


@pytest.mark.parametrize(
    ("convert", "value", "message"),
    [
        (enu_to_ned, (1, 2), r"vector has shape \(2,\): a last axis of east, north, up"),
        (ned_to_enu, np.zeros((3, 4)), r"vector has shape \(3, 4\): .* north, east, down"),
        (flu_to_frd, (1, 2, np.nan), r"vector is \[1.0, 2.0, nan\]: finite"),
        (frd_to_flu, "abc", "vector is not numbers"),
        (attitude_to_ned, (0, 0, 1), "a last axis of x, y, z, w is needed"),
        (attitude_to_enu, 1.0, r"quaternion has shape \(\)"),
    ],
)
def test_what_cannot_be_is_refused(convert, value, message):
    with pytest.raises(ValueError, match=message):
        convert(value)


def test_the_order_that_was_meant_is_named():
    with pytest.raises(ValueError, match="a last axis of w, x, y, z is needed"):
        attitude_to_enu((1, 0, 0), scalar_first=True)
