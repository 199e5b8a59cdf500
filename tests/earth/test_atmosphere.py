"""Air against tables of the standards, and the law of hydrostatics."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bulletuav.earth import (
    density,
    geometric_height,
    geopotential_height,
    pressure,
    pressure_altitude,
    temperature,
)
from bulletuav.earth.atmosphere import MAX_HEIGHT, MIN_HEIGHT

heights = st.floats(MIN_HEIGHT, MAX_HEIGHT)


@pytest.mark.parametrize(
    ("height", "kelvin", "pascal", "kilograms"),
    [
        (0, 288.150, 101325, 1.2250),
        (1000, 281.651, 89876, 1.1117),
        (5000, 255.676, 54048, 0.73643),
        (10000, 223.252, 26499, 0.41351),
        (15000, 216.650, 12111, 0.19476),
        (20000, 216.650, 5529.3, 0.088910),
    ],
)
def test_table_of_the_us_standard_atmosphere(height, kelvin, pascal, kilograms):
    """Table I of 1976, by geometric height; it cuts off digits."""
    assert temperature(height) == pytest.approx(kelvin, abs=6e-4)
    assert pressure(height) == pytest.approx(pascal, rel=8e-5)
    assert density(height) == pytest.approx(kilograms, rel=5e-5)


@pytest.mark.parametrize(
    ("geopotential", "kelvin", "pascal"),
    [(1000, 281.65, 89874.6), (11000, 216.65, 22632.1), (20000, 216.65, 5474.89)],
)
def test_table_by_geopotential_height(geopotential, kelvin, pascal):
    height = geometric_height(geopotential)
    assert temperature(height) == pytest.approx(kelvin, abs=1e-9)
    assert pressure(height) == pytest.approx(pascal, rel=5e-6)
    assert pressure_altitude(pascal) == pytest.approx(height, abs=0.05)


def test_heights_of_both_kinds():
    """ISO 2533: 11 km of geopotential are 11019 m, and 20 km are 20063 m."""
    assert geometric_height(11000) == pytest.approx(11019, abs=0.5)
    assert geometric_height(20000) == pytest.approx(20063, abs=0.5)
    assert geopotential_height(-5000) == pytest.approx(-5004, abs=0.5)


@given(heights)
def test_heights_come_back(height):
    assert geometric_height(geopotential_height(height)) == pytest.approx(height, abs=1e-8)


@given(heights, st.floats(90e3, 110e3), st.floats(230, 320))
def test_heights_come_back_from_pressures(height, pascal, kelvin):
    found = pressure_altitude(pressure(height, pascal, kelvin), pascal, kelvin)
    assert found == pytest.approx(height, abs=1e-8)


@given(st.floats(-4900, 19900), st.floats(90e3, 110e3), st.floats(230, 320))
def test_air_carries_itself(height, pascal, kelvin):
    """dp / dh = - density gravity, and gravity falls with the square of the distance."""
    step = 1.0
    above, below = pressure(np.array((height + step, height - step)), pascal, kelvin)
    gravity = 9.80665 * (6356766 / (6356766 + height)) ** 2
    weight = density(height, pascal, kelvin) * gravity
    assert (below - above) / (2 * step) == pytest.approx(weight, rel=2e-4)


def test_air_carries_itself_exactly_away_from_the_tropopause():
    height = np.array((0.0, 3000.0, 9000.0, 13000.0, 19000.0))
    gravity = 9.80665 * (6356766 / (6356766 + height)) ** 2
    slope = (pressure(height - 1.0) - pressure(height + 1.0)) / 2
    np.testing.assert_allclose(slope, density(height) * gravity, rtol=1e-8)


def test_other_air_at_sea_level():
    """Pressures scale, temperatures shift by as much at all heights, and warm air reaches up."""
    height = np.array((0.0, 1000.0, 15000.0))
    np.testing.assert_allclose(pressure(height, 98000.0), pressure(height) * 98000 / 101325)
    np.testing.assert_allclose(temperature(height, 298.15), temperature(height) + 10)
    assert pressure(0.0, 98000.0, 298.15) == 98000
    assert density(0.0, 101325.0, 303.15) == pytest.approx(1.1644, abs=1e-4)
    assert (pressure(height[1:], 101325.0, 298.15) > pressure(height[1:])).all()


def test_any_shape():
    height = np.linspace(MIN_HEIGHT, MAX_HEIGHT, 12).reshape(2, 2, 3)
    for function in (temperature, pressure, density, geopotential_height):
        assert function(height).shape == (2, 2, 3)
        assert function(height)[1, 0, 2] == pytest.approx(float(function(height[1, 0, 2])))
        assert function([]).shape == (0,)
    found = pressure_altitude(pressure(height))
    np.testing.assert_allclose(found, height, atol=1e-8)


@pytest.mark.parametrize(
    ("function", "arguments", "message"),
    [
        (pressure, (25000.0,), r"height is 25000 m: a number from -5000 to 20063"),
        (density, (-6000.0,), "height is -6000 m"),
        (temperature, ([0.0, np.nan],), "height is nan m"),
        (pressure, ("high",), "height is not numbers"),
        (pressure, (0.0, 1013.25), "sea_level_pressure is 1013.25: at least 80000"),
        (density, (0.0, 101325.0, 15.0), "sea_level_temperature is 15: at least 180"),
        (temperature, (0.0, np.nan), "sea_level_temperature is nan"),
        (geometric_height, (20001.0,), "geopotential is 20001 m"),
        (geometric_height, (-5010.0,), "geopotential is -5010 m"),
        (pressure_altitude, (1013.25,), "static_pressure is 1013.25 Pa: a number from 5474.88 to"),
        (pressure_altitude, (0.0,), "static_pressure is 0 Pa: a number"),
        (pressure_altitude, (-5.0,), "static_pressure is -5 Pa: a number"),
        (pressure_altitude, (2e5,), "static_pressure is 200000 Pa: a number"),
        (pressure_altitude, (np.inf,), "static_pressure is inf Pa: a number"),
        (pressure_altitude, (9e4, 1013.0), "sea_level_pressure is 1013"),
        (pressure_altitude, (9e4, 101325.0, 400.0), "sea_level_temperature is 400: at most 340"),
    ],
)
def test_what_cannot_be_is_refused(function, arguments, message):
    with pytest.raises(ValueError, match=message):
        function(*arguments)
