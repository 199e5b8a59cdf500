"""The magnetic field against published values, and against the gradient of its potential."""

import datetime
import math

import numpy as np
import pytest
from scipy.special import lpmv

from bulletuav.earth import Origin, geodetic_to_ecef, magnetic_field
from bulletuav.earth.magnetism import (
    COSINE_RATES,
    COSINES,
    MAX_DEGREE,
    SINE_RATES,
    SINES,
    decimal_year,
)


@pytest.mark.parametrize(
    ("place", "north_east_down"),
    [
        ((0.0, 0.0, 0.0), (27457, -1926, -15997)),
        ((45.0, 10.0, 0.0), (22843, 1451, 41825)),
        ((51.5, 0.0, 400e3), (16632, 69, 37519)),
        ((-33.86, 151.21, 0.0), (24040, 5450, -51381)),
    ],
)
def test_values_of_the_british_geological_survey(place, north_east_down):
    """Of its web service for IGRF-14 at 2025.0, geomag.bgs.ac.uk, to the nanotesla."""
    north, east, down = north_east_down
    np.testing.assert_allclose(magnetic_field(*place) * 1e9, (east, north, -down), atol=0.6)


@pytest.mark.parametrize(
    ("place", "north_east_down"),
    [
        ((89.0, -121.0, 28e3), (-255.4, -1482.5, 56194.3)),
        ((43.0, 93.0, 65e3), (24299.9, 210.5, 50037.9)),
        ((-33.0, 109.0, 51e3), (21737.8, -2090.3, -52710.0)),
    ],
)
def test_values_of_the_world_magnetic_model(place, north_east_down):
    """Test values of WMM2025 by NOAA, another model of the same field."""
    north, east, down = north_east_down
    np.testing.assert_allclose(magnetic_field(*place) * 1e9, (east, north, -down), atol=25)


@pytest.mark.parametrize(
    ("year", "kilometres", "colatitude", "longitude", "north_east_down"),
    [
        (2027.0, 101.99, 68.54, 277.27, (24647.90876, -2283.98317, 29268.17197)),
        (2028.6, 161.08, 35.10, 62.37, (15164.04454, 3451.76443, 50529.10557)),
        (2029.9, 554.55, 47.36, 192.94, (18365.55340, 2412.51292, 29274.52518)),
        (2026.6, 120.96, 89.19, 108.99, (38188.56964, 115.46005, -9120.05745)),
        (2030.0, 397.34, 17.78, 246.22, (4642.74152, 854.57128, 48023.38690)),
    ],
)
def test_values_of_other_years(year, kilometres, colatitude, longitude, north_east_down):
    """Of IAGA's program igrf14syn, which rounds its ellipsoid; tests of JuliaSpace/IGRF_Test."""
    north, east, down = north_east_down
    found = magnetic_field(90.0 - colatitude, longitude, 1e3 * kilometres, year) * 1e9
    np.testing.assert_allclose(found, (east, north, -down), atol=0.1)


def test_the_field_changes_steadily_from_the_epoch_on():
    fields = [magnetic_field(47.4, 8.5, 0.0, year) for year in (2025.0, 2026.0, 2027.0, 2030.0)]
    np.testing.assert_array_equal(fields[0], magnetic_field(47.4, 8.5, 0.0))
    yearly = fields[1] - fields[0]
    np.testing.assert_allclose(fields[2] - fields[1], yearly, rtol=1e-7)
    np.testing.assert_allclose(fields[3] - fields[0], 5 * yearly, rtol=1e-7)
    assert 20e-9 < np.linalg.norm(yearly) < 100e-9


def test_values_of_the_world_magnetic_model_in_the_middle_of_its_years():
    """WMM2025 by NOAA at 2027.5: its test values, 100 km high."""
    for place, (north, east, down) in (
        ((80.0, 0.0), (6196.7, 233.8, 52670.5)),
        ((0.0, 120.0), (37711.5, -148.7, -9969.8)),
        ((-80.0, 240.0), (5984.0, 14760.1, -49317.7)),
    ):
        found = magnetic_field(*place, 100e3, 2027.5) * 1e9
        np.testing.assert_allclose(found, (east, north, -down), atol=25)


@pytest.mark.parametrize(
    ("date", "year"),
    [
        (2026, 2026.0),
        (datetime.date(2025, 1, 1), 2025.0),
        (datetime.date(2027, 12, 31), 2027 + 364 / 365),
        (datetime.date(2028, 12, 31), 2028 + 365 / 366),
        (datetime.datetime(2026, 7, 2, 12, 0), 2026 + 182 / 365),
    ],
)
def test_days_have_decimal_years(date, year):
    assert decimal_year(date) == pytest.approx(year, abs=1e-12)


@pytest.mark.parametrize(
    ("date", "message"),
    [
        (2024.99, "date is 2024.99: at least 2025"),
        (2030.01, "date is 2030.01: at most 2030"),
        (datetime.date(2031, 5, 1), "date is .*: at most 2030"),
        (datetime.date(1999, 5, 1), "date is .*: at least 2025"),
        (math.nan, "date is nan: a finite number"),
        ("2026", "date is '2026'"),
        (None, "date is None"),
        (True, "date is True"),
    ],
)
def test_dates_that_are_not_foreseen_are_refused(date, message):
    with pytest.raises(ValueError, match=message):
        magnetic_field(0.0, 0.0, 0.0, date)


@pytest.mark.parametrize(
    ("latitude", "longitude", "sign"), [(85.762, 139.298, -1), (-63.851, 135.078, 1)]
)
def test_it_is_vertical_at_the_magnetic_poles(latitude, longitude, sign):
    """NOAA's places of 2025; the field enters the ground in the north."""
    east, north, up = magnetic_field(latitude, longitude, 0.0) * 1e9
    assert math.hypot(east, north) < 20
    assert 50e3 < sign * up < 70e3


def test_the_dipole_lies_where_it_is_published():
    """Geomagnetic pole of 2025: 80.85 N, 72.76 W in geodetic coordinates (NOAA)."""
    (axial, x), (_, y) = COSINES[0], SINES[0]
    geocentric = np.arctan2(-axial, np.hypot(x, y))
    latitude = np.arctan(np.tan(geocentric) / (1 - 6.69438e-3))
    assert np.degrees(latitude) == pytest.approx(80.85, abs=0.005)
    assert np.degrees(np.arctan2(-y, -x)) == pytest.approx(-72.76, abs=0.005)


def test_there_is_a_coefficient_of_each_degree_and_order():
    assert [len(row) for row in COSINES] == [len(row) for row in SINES] == list(range(2, 15))
    assert {row[0] for row in SINES} == {0.0}
    assert len(COSINES) == MAX_DEGREE
    # Sums of the columns 2025.0 of igrf14coeffs.txt
    assert sum(map(sum, COSINES)) == pytest.approx(-26449.7, abs=0.05)
    assert sum(map(sum, SINES)) == pytest.approx(487.6, abs=0.05)
    # and of the columns 2025-30
    assert [len(row) for row in COSINE_RATES] == list(range(2, 10))
    assert [len(row) for row in SINE_RATES] == list(range(2, 10))
    assert sum(map(sum, COSINE_RATES)) == pytest.approx(-26.1, abs=0.05)
    assert sum(map(sum, SINE_RATES)) == pytest.approx(-54.2, abs=0.05)


def potential(position):
    """Equation 1 of Alken et al. with scipy's Legendre functions, nT m, at ECEF (3,)."""
    radius = np.linalg.norm(position)
    longitude = np.arctan2(position[1], position[0])
    total = 0.0
    for n in range(1, MAX_DEGREE + 1):
        for m in range(n + 1):
            # Schmidt's factor, and the sign of Condon and Shortley that scipy has
            factor = math.sqrt((2 - (m == 0)) * math.factorial(n - m) / math.factorial(n + m))
            legendre = (-1) ** m * factor * lpmv(m, n, position[2] / radius)
            turned = COSINES[n - 1][m] * np.cos(m * longitude)
            turned += SINES[n - 1][m] * np.sin(m * longitude)
            total += (6371.2e3 / radius) ** (n + 1) * turned * legendre
    return 6371.2e3 * total


@pytest.mark.parametrize(
    "place",
    [
        (0.0, 0.0, 0.0),
        (47.4, 8.5, 500.0),
        (-77.8, 166.7, 1e4),
        (12.0, -179.9, 4e5),
        (89.9, 60.0, 0.0),
        (-90.0, 25.0, 0.0),
        (90.0, -100.0, 1e6),
    ],
)
def test_it_is_the_gradient_of_its_potential(place):
    origin = Origin(*place)
    step = 200.0
    gradient = [
        (
            potential(geodetic_to_ecef(origin.to_geodetic(offset)))
            - potential(geodetic_to_ecef(origin.to_geodetic(-offset)))
        )
        / (2 * step)
        for offset in step * np.eye(3)
    ]
    np.testing.assert_allclose(magnetic_field(*place) * 1e9, -np.array(gradient), atol=0.01)


@pytest.mark.parametrize("pole", [90.0, -90.0])
def test_a_pole_has_one_field_whatever_its_longitude(pole):
    longitude = np.array((-180.0, -40.0, 0.0, 77.0, 180.0))
    fields = magnetic_field(pole, longitude, 0.0)
    turned = np.radians(longitude)
    # To axes that do not turn with the longitude
    north = -np.sign(pole) * fields[:, 1]
    x = north * np.cos(turned) - fields[:, 0] * np.sin(turned)
    y = north * np.sin(turned) + fields[:, 0] * np.cos(turned)
    np.testing.assert_allclose(np.stack([x, y, fields[:, 2]]).std(axis=1), 0, atol=1e-18)
    np.testing.assert_allclose(
        magnetic_field(pole * (1 - 1e-10), longitude, 0.0), fields, atol=1e-15
    )


def test_longitudes_go_round_and_shapes_fit_together():
    np.testing.assert_allclose(
        magnetic_field(30.0, 200.0, 0.0), magnetic_field(30.0, -160.0, 0.0), rtol=1e-12
    )
    latitude = np.array((-60.0, 0.0, 60.0))[:, None]
    fields = magnetic_field(latitude, np.array((5.0, 100.0)), 300.0)
    assert fields.shape == (3, 2, 3)
    np.testing.assert_allclose(fields[2, 1], magnetic_field(60.0, 100.0, 300.0), rtol=1e-12)
    assert magnetic_field([], 0.0, 0.0).shape == (0, 3)


@pytest.mark.parametrize(
    ("place", "message"),
    [
        ((91.0, 0.0, 0.0), "latitude is 91 degrees: a number from -90 to 90"),
        (([80.0, 95.0, -91.0], 0.0, 0.0), "latitude is 95 degrees"),
        ((0.0, np.nan, 0.0), "longitude is nan degrees: a finite number"),
        ((0.0, -np.inf, 0.0), "longitude is -inf degrees: a finite number"),
        ((0.0, 0.0, 2e6), r"altitude is 2000000 m: a number from -10000 to 1e\+06"),
        ((0.0, 0.0, -2e4), "altitude is -20000 m"),
        (("north", 0.0, 0.0), "latitude is not numbers"),
    ],
)
def test_what_cannot_be_is_refused(place, message):
    with pytest.raises(ValueError, match=message):
        magnetic_field(*place)
