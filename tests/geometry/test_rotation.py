import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from bulletuav.geometry import rotation

number = st.floats(-3, 3)
vectors = st.tuples(number, number, number)
quaternions = (
    st.tuples(number, number, number, number)
    .filter(lambda q: np.linalg.norm(q) > 0.1)
    .map(rotation.normalise_quaternion)
)


@given(quaternions, vectors)
def test_turning_vectors_agrees_with_scipy(q, v):
    reference = Rotation.from_quat(q)
    np.testing.assert_allclose(rotation.to_world(q, v), reference.apply(v), atol=1e-12)
    np.testing.assert_allclose(rotation.to_body(q, v), reference.inv().apply(v), atol=1e-12)
    np.testing.assert_allclose(np.array(rotation.axes(q)).T, reference.as_matrix(), atol=1e-12)


@given(quaternions, quaternions)
def test_products_agree_with_scipy(p, q):
    """The second turn comes first, as with matrices."""
    reference = (Rotation.from_quat(p) * Rotation.from_quat(q)).as_matrix()
    product = np.array(rotation.axes(rotation.product(p, q))).T
    np.testing.assert_allclose(product, reference, atol=1e-12)


@given(vectors)
def test_exponential_agrees_with_scipy(v):
    expected = Rotation.from_rotvec(v).as_matrix()
    np.testing.assert_allclose(
        Rotation.from_quat(rotation.exp_map(v)).as_matrix(), expected, atol=1e-12
    )


@pytest.mark.parametrize("angle", [0.0, 1e-13, 1e-9, 1e-6])
def test_exponential_of_small_angles(angle):
    np.testing.assert_allclose(
        rotation.exp_map((angle, 0.0, 0.0)), (angle / 2, 0, 0, 1), rtol=1e-12
    )


@given(vectors)
def test_logarithm_is_the_inverse_of_the_exponential(v):
    expected = Rotation.from_rotvec(v).as_rotvec()
    q = np.array(rotation.exp_map(v))
    for same in (q, -q):  # two signs, one rotation
        back = rotation.log_map(same)
        assert np.linalg.norm(back) <= np.pi + 1e-12
        np.testing.assert_allclose(
            Rotation.from_rotvec(back).as_matrix(),
            Rotation.from_rotvec(expected).as_matrix(),
            atol=1e-9,
        )


@pytest.mark.parametrize("angle", [0.0, 1e-13, 1e-9, 1e-6])
def test_logarithm_of_small_angles(angle):
    back = rotation.log_map((0.0, angle / 2, 0.0, 1.0))
    np.testing.assert_allclose(back, (0.0, angle, 0.0), rtol=1e-12)


@given(st.floats(-3, 3), st.floats(-1.5, 1.5), st.floats(-3, 3))
def test_euler_angles_agree_with_scipy(roll, pitch, yaw):
    q = rotation.from_euler(roll, pitch, yaw)
    expected = Rotation.from_euler("ZYX", (yaw, pitch, roll)).as_matrix()
    np.testing.assert_allclose(Rotation.from_quat(q).as_matrix(), expected, atol=1e-12)


@given(vectors, vectors)
def test_products_of_vectors(a, b):
    np.testing.assert_allclose(rotation.cross(a, b), np.cross(a, b), atol=1e-12)
    assert rotation.dot(a, b) == pytest.approx(np.dot(a, b), abs=1e-12)
