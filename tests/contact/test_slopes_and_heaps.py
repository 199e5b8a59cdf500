"""Slopes hold as friction says; stacks stand; heaps come down."""

import numpy as np
import pytest
from contact.heaps import drop_heap, slide, stack


@pytest.mark.parametrize("friction", [0.25, 0.5])
def test_drones_slide_exactly_where_the_slope_is_steeper_than_friction(friction):
    tangents = friction * np.array([0.5, 0.999, 1.01, 1.2, 2.0])
    slid, expected = slide(friction, tangents)
    assert (slid[:2] < 1e-4).all()
    np.testing.assert_allclose(slid[2:], expected[2:], rtol=6e-3)


def test_a_stack_of_ten_stands():
    heap = stack()
    assert heap.speed.max() < 0.01
    assert heap.depth < 5e-4
    steps = np.diff(np.sort(heap.height))
    np.testing.assert_allclose(steps, 0.03, atol=2e-4)


def test_a_heap_comes_to_rest_on_the_ground():
    heap = drop_heap(16, seconds=4.0)
    assert heap.speed.max() < 0.01
    assert heap.spin.max() < 0.1
    assert heap.depth < 5e-4
    assert heap.height.min() == pytest.approx(5e-5, abs=1e-4)
