"""Places against published coordinates, formulas of small steps, and round trips."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from bulletuav.earth import Origin, degree_lengths, ecef_to_geodetic, geodetic_to_ecef
from bulletuav.earth.geodesy import ECCENTRICITY_SQUARED, SEMI_MAJOR_AXIS, SEMI_MINOR_AXIS

# The worked examples of IOGP Geomatics Guidance Note 7-2 (EPSG methods 9602 and 9837).
NORTH_SEA = (53 + 48 / 60 + 33.82 / 3600, 2 + 7 / 60 + 46.38 / 3600, 73.0)
NORTH_SEA_ECEF = (3771793.968, 140253.342, 5124304.349)
NORTH_SEA_ORIGIN = (55.0, 5.0, 200.0)
NORTH_SEA_LOCAL = (-189013.869, -128642.040, -4220.171)

places = st.tuples(st.floats(-90, 90), st.floats(-180, 180), st.floats(-1e3, 1e5))


def turn(longitude):
    """The same longitude from -180 to 180."""
    return (longitude + 180) % 360 - 180


@pytest.mark.parametrize(
    ("geodetic", "ecef"),
    [
        ((0, 0, 0), (6378137, 0, 0)),
        ((0, 90, 100), (0, 6378237, 0)),
        ((0, 180, -100), (-6378037, 0, 0)),
        ((90, 0, 0), (0, 0, 6356752.3142)),
        ((-90, 77, 500), (0, 0, -6357252.3142)),
        (NORTH_SEA, NORTH_SEA_ECEF),
        # Example 4 of www.navlab.net/nvector
        ((1, 2, 3), (6373290.27721828, 222560.20067474, 110568.82718179)),
        # Of PROJ 9.5
        ((-33.86, 151.21, 58), (-4646601.351670, 2553434.722233, -3533594.194180)),
        ((27.988056, 86.925278, 8848.86), (302742.711090, 5636029.982608, 2979489.179165)),
    ],
)
def test_published_places(geodetic, ecef):
    np.testing.assert_allclose(geodetic_to_ecef(geodetic), ecef, atol=6e-4)
    back = ecef_to_geodetic(ecef)
    np.testing.assert_allclose(back[[0, 2]], np.array(geodetic)[[0, 2]], atol=6e-4)
    # Metres of longitude, which is any at the poles
    off = turn(back[1] - geodetic[1]) * np.cos(np.radians(geodetic[0])) * 111e3
    assert abs(off) < 1e-3


def test_published_local_position():
    origin = Origin(*NORTH_SEA_ORIGIN)
    np.testing.assert_allclose(origin.to_local(NORTH_SEA), NORTH_SEA_LOCAL, atol=6e-4)
    np.testing.assert_allclose(origin.to_geodetic(NORTH_SEA_LOCAL), NORTH_SEA, atol=6e-4)
    np.testing.assert_allclose(origin.to_geodetic(NORTH_SEA_LOCAL)[:2], NORTH_SEA[:2], atol=1e-8)


@given(places)
@example((90.0, 0.0, 0.0))
@example((-90.0, 0.0, 1e5))
@example((0.0, 180.0, -1e3))
@example((1e-9, -180.0, 0.0))
@example((90 - 1e-9, 179.999999999, 0.0))
@example((45.0, 0.0, 1e5))
def test_ecef_goes_there_and_back(geodetic):
    latitude, longitude, altitude = ecef_to_geodetic(geodetic_to_ecef(geodetic))
    assert latitude == pytest.approx(geodetic[0], abs=1e-12)
    assert altitude == pytest.approx(geodetic[2], abs=2e-8)
    assert -180 <= longitude <= 180
    off = turn(longitude - geodetic[1]) * np.cos(np.radians(geodetic[0]))
    assert abs(off) < 1e-12


@given(places, st.tuples(*[st.floats(-5e4, 5e4)] * 3))
@example((90.0, 0.0, 0.0), (1e3, 1e3, 0.0))
@example((-90.0, -120.0, 0.0), (0.0, 0.0, 10.0))
@example((60.0, 180.0, 0.0), (500.0, 0.0, 0.0))
@example((0.0, -180.0, 0.0), (-500.0, 0.0, 0.0))
def test_local_positions_go_there_and_back_anywhere(place, position):
    origin = Origin(*place)
    np.testing.assert_allclose(origin.to_local(origin.to_geodetic(position)), position, atol=1e-7)


@given(places, st.tuples(*[st.floats(-5e4, 5e4)] * 3), st.tuples(*[st.floats(-5e4, 5e4)] * 3))
def test_distances_are_kept(place, first, second):
    ecef = geodetic_to_ecef(Origin(*place).to_geodetic((first, second)))
    expected = np.linalg.norm(np.subtract(first, second))
    assert np.linalg.norm(ecef[0] - ecef[1]) == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize("latitude", [-89.0, -45.0, 0.0, 47.4, 70.0])
def test_small_steps_follow_the_radii_of_curvature(latitude):
    """Degrees of a metre north and east, by the textbook radii of meridian and parallel."""
    altitude = 500.0
    origin = Origin(latitude, 8.5, altitude)
    root = np.sqrt(1 - ECCENTRICITY_SQUARED * np.sin(np.radians(latitude)) ** 2)
    meridian = SEMI_MAJOR_AXIS * (1 - ECCENTRICITY_SQUARED) / root**3 + altitude
    parallel = (SEMI_MAJOR_AXIS / root + altitude) * np.cos(np.radians(latitude))
    east, north, up = origin.to_geodetic(np.eye(3)) - (latitude, 8.5, altitude)
    assert np.radians(north[0]) == pytest.approx(1 / meridian, rel=1e-6)
    assert np.radians(east[1]) == pytest.approx(1 / parallel, rel=1e-6)
    np.testing.assert_allclose(up, (0, 0, 1), atol=1e-8)


def test_the_ground_falls_away_from_the_local_plane():
    """By d^2 / 2 R: 7.8 cm at 1 km, and 10^4 times as much at 100 km."""
    origin = Origin(0.0, 0.0, 0.0)
    near, far = origin.to_geodetic([(1e3, 0, 0), (1e5, 0, 0)])
    assert near[2] == pytest.approx(0.0784, abs=1e-4)
    assert far[2] == pytest.approx(784, abs=0.2)


def test_directions_at_the_date_line_and_the_pole():
    east = Origin(10.0, 180.0, 0.0).to_geodetic((1000.0, 0.0, 0.0))
    assert east[1] == pytest.approx(-179.9909, abs=1e-4)
    # North of an origin at the pole is where its longitude would go on: on the other side.
    over = Origin(90.0, 20.0, 0.0).to_geodetic((0.0, 1000.0, 0.0))
    assert over[1] == pytest.approx(-160.0, abs=1e-9)
    assert 89.99 < over[0] < 89.992


def test_axes_before_the_last_are_kept():
    position = np.random.default_rng(0).uniform(-1e3, 1e3, (2, 4, 3))
    origin = Origin(47.4, 8.5, 500.0)
    geodetic = origin.to_geodetic(position)
    assert geodetic.shape == (2, 4, 3)
    np.testing.assert_allclose(geodetic[1, 2], origin.to_geodetic(position[1, 2]), rtol=1e-14)
    np.testing.assert_allclose(origin.to_local(geodetic), position, atol=1e-7)
    assert origin.to_local(np.zeros((0, 3))).shape == (0, 3)


def test_the_semi_minor_axis_is_the_published_one():
    assert pytest.approx(6356752.3142, abs=5e-5) == SEMI_MINOR_AXIS
    assert pytest.approx(6.694379990141e-3, rel=1e-12) == ECCENTRICITY_SQUARED


def test_an_origin_keeps_floats_and_does_not_change():
    origin = Origin(np.int64(47), 8, np.float32(500))
    assert [type(number) for number in dataclasses.astuple(origin)] == [float] * 3
    with pytest.raises(dataclasses.FrozenInstanceError):
        origin.latitude = 0.0


@pytest.mark.parametrize(
    ("place", "message"),
    [
        ((90.001, 0, 0), "latitude is 90.001: at most 90"),
        ((-91, 0, 0), "latitude is -91: at least -90"),
        ((0, 180.5, 0), "longitude is 180.5: at most 180"),
        ((0, -181, 0), "longitude is -181: at least -180"),
        ((np.nan, 0, 0), "latitude is nan: a finite number"),
        ((0, np.inf, 0), "longitude is inf: a finite number"),
        ((0, 0, np.nan), "altitude is nan: a finite number"),
        (("47", 0, 0), "latitude is '47': a finite number"),
    ],
)
def test_origins_that_cannot_be(place, message):
    with pytest.raises(ValueError, match=message):
        Origin(*place)


@pytest.mark.parametrize(
    ("convert", "value", "message"),
    [
        (geodetic_to_ecef, (91, 0, 0), "latitude is 91 degrees: a number from -90 to 90"),
        (geodetic_to_ecef, [(0, 0, 0), (0, np.nan, 0)], r"geodetic is \[0.0, nan, 0.0\]: finite"),
        (geodetic_to_ecef, (0, 0), r"geodetic has shape \(2,\): .* latitude, longitude, altitude"),
        (geodetic_to_ecef, 5.0, r"geodetic has shape \(\)"),
        (geodetic_to_ecef, "here", "geodetic is not numbers"),
        (ecef_to_geodetic, (10, 20, 30), "position is 37.41657387 m from the Earth's centre"),
        (ecef_to_geodetic, (np.inf, 0, 0), "finite numbers are needed"),
        (Origin(0, 0, 0).to_geodetic, np.zeros((3, 2)), "east, north, up"),
        (Origin(0, 0, 0).to_local, (-90.1, 0, 0), "latitude is -90.1 degrees"),
    ],
)
def test_coordinates_that_cannot_be(convert, value, message):
    with pytest.raises(ValueError, match=message):
        convert(value)


@pytest.mark.parametrize("latitude", [0.0, 0.5, 48.0, -60.17, 89.9, 90.0])
def test_lengths_of_degrees_are_those_of_the_series(latitude):
    """The series are usual in navigation; they leave out up to 7 cm."""

    def cosine(times):
        return math.cos(math.radians(times * latitude))

    east = 111412.84 * cosine(1) - 93.5 * cosine(3) + 0.118 * cosine(5)
    north = 111132.92 - 559.82 * cosine(2) + 1.175 * cosine(4) - 0.0023 * cosine(6)
    assert degree_lengths(latitude) == pytest.approx((east, north), abs=0.1)


def test_lengths_of_degrees_are_those_of_local_coordinates():
    place = Origin(60.17, 24.94, 0.0)
    step = 1e-4
    beyond = place.to_local([(60.17, 24.94 + step, 0.0), (60.17 + step, 24.94, 0.0)])
    found = (beyond[0, 0] / step, beyond[1, 1] / step)
    assert degree_lengths(60.17) == pytest.approx(found, rel=1e-6)


def test_there_are_no_degrees_beyond_the_poles():
    with pytest.raises(ValueError, match="latitude is 91"):
        degree_lengths(91.0)
