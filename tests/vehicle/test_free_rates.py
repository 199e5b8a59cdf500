"""Body rates without torque against Euler's closed form and what stays in any body."""

import numpy as np
import pytest

from bulletuav.vehicle.airframes import load_airframe
from bulletuav.vehicle.parameters import parameter_rows
from bulletuav.vehicle.wrench import free_rates


def row_of(inertia):
    rows = parameter_rows([load_airframe("cf2x")])
    rows["inertia"] = inertia
    return rows.reshape(-1)[0]


def test_the_rates_of_a_symmetric_top_turn_evenly():
    """Euler: rates across the axis turn at r (jz - jx) / jx."""
    row = row_of((2e-5, 2e-5, 3e-5))
    angle = 30.0 * 0.5 / 60
    found = free_rates((4.0, 0.0, 30.0), 1 / 60, row)
    expected = (4 * np.cos(angle), 4 * np.sin(angle), 30.0)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("spin", [3.0, 30.0])
def test_energy_and_momentum_stay(spin):
    inertia = np.array([1.4e-5, 1.7e-5, 2.2e-5])
    rng = np.random.default_rng(0)
    for rates in rng.normal(size=(20, 3)) * spin:
        found = np.array(free_rates(tuple(rates.tolist()), 1 / 240, row_of(inertia)))
        assert inertia @ found**2 == pytest.approx(inertia @ rates**2, rel=1e-7)
        assert inertia**2 @ found**2 == pytest.approx(inertia**2 @ rates**2, rel=1e-7)
