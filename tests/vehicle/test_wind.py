"""The wind in flights: steady, with a profile over height, as a function; gusts on top."""

import numpy as np
import pytest

import bulletuav
from bulletuav.envs.airspace import Airspace
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.vehicle.wind import (
    PROFILES,
    TURBULENCE,
    Profile,
    Wind,
    as_profile,
    profile_speed_ratio,
)

FOOT = 0.3048


def test_named_levels():
    assert TURBULENCE["light"] == pytest.approx(7.7167, abs=5e-5)
    assert TURBULENCE["severe"] == pytest.approx(23.15, abs=0.01)


# Profiles


@pytest.mark.parametrize(
    ("feet", "profile", "share"),
    [
        (20, "power", 1.0),
        (200, "power", 1.389495),
        (200, ("power", 0.25), 1.778279),
        (1, ("power", 1.0), 0.05),
        (0, "power", 0.0),
        (-5, "power", 0.0),
        (1000, "power", 1.748679),
        (5000, "power", 1.748679),
        # ln(h / 0.15) / ln(20 / 0.15) in feet, by hand
        (20, "log", 1.0),
        (3, "log", 0.612267),
        (200, "log", 1.470602),
        (1000, "log", 1.799538),
        (5000, "log", 1.799538),
        (200, ("log", 2 * FOOT), 2.0),
        (2, ("log", 2 * FOOT), 0.0),
        (0.01, "log", 0.0),
        (-5, "log", 0.0),
    ],
)
def test_profiles_by_hand(feet, profile, share):
    law, number = as_profile(profile)
    found = profile_speed_ratio(feet * FOOT, law == "log", number)
    assert found == pytest.approx(share, abs=1e-6)
    wind = Wind((3.0, -4.0, 0.5), 0.0, 1, as_profile(profile))
    found = wind.sample(np.array([[(1.0, 2.0, feet * FOOT)]]), np.zeros(1))[0, 0]
    np.testing.assert_allclose(found, (3 * share, -4 * share, 0.5), atol=1e-5)


@pytest.mark.parametrize("law", PROFILES)
def test_wind_never_falls_with_height(law):
    _, number = as_profile(law)
    shares = [profile_speed_ratio(h, law == "log", number) for h in np.linspace(-1, 400, 2000)]
    assert (np.diff(shares) >= 0).all()
    assert np.abs(np.diff(shares)).max() < 0.6


def test_a_profile_without_a_slope_is_a_uniform_wind():
    place, time = np.random.default_rng(0).uniform(0, 99, (2, 5, 3)), np.zeros(2)
    steady = (3.0, -4.0, 0.5)
    level = Wind(steady, 0.0, 2, Profile("power", 0.0)).sample(place, time)
    np.testing.assert_array_equal(level, Wind(steady, 0.0, 2).sample(place, time))


def test_gusts_are_the_same_with_a_profile():
    place, time = np.random.default_rng(0).uniform(10, 99, (1, 5, 3)), np.ones(1)
    found = []
    for profile in (None, Profile("power", 0.0), Profile("log", 0.1)):
        wind = Wind((3.0, -4.0, 0.5), 7.0, 1, profile)
        wind.reset(0, np.random.default_rng(0))
        calm = Wind((3.0, -4.0, 0.5), 0.0, 1, profile)
        found.append(wind.sample(place, time) - calm.sample(place, time))
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_allclose(found[0], found[2], atol=1e-12)


def test_drones_higher_up_drift_faster():
    """Points at 6.096 and 60.96 m reach the wind's speeds there, 1 to 1.389495."""
    airspace = Airspace(
        [(0, 0, 20 * FOOT), (0, 0, 200 * FOOT)],
        wind=(5.0, 0.0, 0.0),
        wind_profile="power",
        dynamics="point_mass",
    )
    airspace.step()
    low, high = airspace.swarm.velocity[:, 0]
    assert high / low == pytest.approx(1.389495, rel=1e-6)
    airspace.close()


@pytest.mark.parametrize(
    ("profile", "message"),
    [
        ("logg", "unknown wind_profile 'logg': did you mean 'log'"),
        ("", "unknown wind_profile ''"),
        (("pow", 0.2), "unknown wind_profile 'pow'"),
        ((1, 0.2), "unknown wind_profile"),
        (0.143, "wind_profile is 0.143: a list or tuple of 2 values is needed"),
        (("log",), "a list or tuple of 2 values is needed"),
        (("log", 0.0), "wind_profile: roughness length of 'log' is 0"),
        (("log", 6.1), "wind_profile: roughness length of 'log' is 6.1"),
        (("log", "rough"), "wind_profile: roughness length of 'log' is 'rough'"),
        (("power", -0.1), "wind_profile: exponent of 'power' is -0.1"),
        (("power", 1.5), "wind_profile: exponent of 'power' is 1.5"),
        (("power", float("nan")), "wind_profile: exponent of 'power' is nan"),
    ],
)
def test_profiles_that_cannot_be_are_refused(profile, message):
    with pytest.raises(ValueError, match="wind_profile") as refused:
        EnvSpec("hover", 1, {"wind_profile": profile})
    assert message in str(refused.value)


def test_a_wind_function_takes_no_profile():
    options = {"wind": lambda position, time: position, "wind_profile": "log"}
    with pytest.raises(ValueError, match="wind_profile changes a steady wind"):
        EnvSpec("hover", 1, options)


def test_options_keep_the_number_of_a_profile():
    options = EnvSpec("hover", 1, {"wind_profile": ["log", 1]}).options
    assert options.wind_profile == ("log", 1.0)
    assert EnvSpec("hover", 1, {}).options.wind_profile is None


# Functions


def test_wind_as_a_function_of_place_and_time():
    calls = []

    def field(position, time):
        calls.append((position.shape, time.copy()))
        return np.stack(
            [position[..., 2], 0 * position[..., 0], 0 * position[..., 0] + time[:, None]], axis=-1
        )

    aviary = bulletuav.Aviary(
        "hover", 2, num_drones=2, wind=field, dynamics="point_mass", action="velocity"
    )
    aviary.reset(seeds=0)
    for _ in range(3):
        aviary.step(np.zeros((2, 2, 3)))
    assert calls[0][0] == (2, 2, 3)
    np.testing.assert_allclose([time[0] for _, time in calls], (0, 1 / 30, 2 / 30))
    assert (aviary.swarm.velocity[..., 0] > 0).all()
    aviary.close()


@pytest.mark.parametrize("answer", [np.zeros(3), np.full((1, 1, 3), np.nan)])
def test_a_wind_function_that_answers_wrongly_is_named_and_nothing_is_lost(answer):
    good = [True]
    aviary = bulletuav.Aviary(
        "hover", wind=lambda position, time: np.zeros((1, 1, 3)) if good[0] else answer
    )
    aviary.reset(seeds=0)
    good[0] = False
    with pytest.raises(ValueError, match="the wind function returned shape"):
        aviary.step(np.zeros((1, 1, 4)))
    good[0] = True
    assert aviary.steps[0] == 0
    aviary.step(np.zeros((1, 1, 4)))
    aviary.close()


# Gusts in flight


def test_flights_feel_the_field_and_draw_nothing_for_it():
    """What a decision flew in is what anyone is told of these places and times."""
    aviary = bulletuav.Aviary(
        "hover", 2, num_drones=3, turbulence="light", wind=(2.0, 0.0, 0.0), wind_profile="log"
    )
    aviary.reset(seeds=0)
    states = [rng.bit_generator.state for rng in aviary.rng]
    for k in range(3):
        place, time = aviary.swarm.position.copy(), np.full(2, k / aviary.options.decision_hz)
        aviary.step(np.zeros((2, 3, aviary.given.shape[-1])))
        np.testing.assert_array_equal(
            aviary.worlds.state.wind, aviary.worlds.wind.sample(place, time)
        )
    assert [rng.bit_generator.state for rng in aviary.rng] == states
    aviary.close()


def test_gusts_and_functions_add_up():
    """Beside a function, the gusts are those of still air."""
    place, time = np.random.default_rng(0).uniform(10, 99, (1, 5, 3)), np.ones(1)
    found = []
    for steady in ((0.0, 0.0, 0.0), lambda position, time: 2 * position):
        wind = Wind(steady, 7.0, 1)
        wind.reset(0, np.random.default_rng(0))
        found.append(wind.sample(place, time))
    np.testing.assert_allclose(found[1], found[0] + 2 * place, atol=1e-12)


def test_an_airspace_has_one_field_for_all():
    """Drones that swap places swap flights, and 3 m apart they are pushed alike."""
    places = [(0.0, 0.0, 20.0), (3.0, 0.0, 20.0)]
    ends = []
    for order in (places, places[::-1]):
        airspace = Airspace(order, turbulence="severe", seed=3, dynamics="point_mass")
        for _ in range(60):
            airspace.step()
        ends.append(airspace.swarm.velocity.copy())
        airspace.close()
    np.testing.assert_array_equal(ends[0], ends[1][::-1])
    one, two = ends[0]
    assert 0 < np.linalg.norm(one - two) < 0.5 * np.linalg.norm(one)


def test_turbulence_shakes_reproducibly_and_world_by_world():
    ends = []
    for worlds in (1, 3):
        aviary = bulletuav.Aviary(
            "hover", worlds, turbulence="severe", action="velocity", dynamics="rigid_body"
        )
        for _ in range(2):
            aviary.reset(seeds=[7, 8, 9][:worlds])
            for _ in range(30):
                aviary.step(np.zeros((worlds, 1, 3)))
            ends.append(aviary.swarm.position[0, 0].copy())
        aviary.close()
    np.testing.assert_array_equal(ends, [ends[0]] * 4)
    calm = bulletuav.Aviary("hover", action="velocity", dynamics="rigid_body")
    calm.reset(seeds=7)
    for _ in range(30):
        calm.step(np.zeros((1, 1, 3)))
    assert np.abs(calm.swarm.position[0, 0] - ends[0]).max() > 0.01
    calm.close()
