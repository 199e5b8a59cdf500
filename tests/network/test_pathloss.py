import math
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bulletuav.city.sight_probability import SIGMOIDS, elevation_los
from bulletuav.compiled.kernel import allocating
from bulletuav.network import pathloss
from bulletuav.network.pathloss import PATHLOSS_MODELS, check_validity
from bulletuav.network.propagation import (
    EXCESS,
    EXPONENTS,
    free_space,
    log_distance,
    mean_path_loss,
)
from bulletuav.network.tr36777 import (
    shadowing,
    uma_av_los_probability,
    umi_av_los,
    umi_av_los_probability,
)
from bulletuav.network.tr38901 import (
    uma_los,
    uma_los_probability,
    uma_nlos,
    umi_close_in_nlos,
    umi_los,
    umi_los_probability,
    umi_nlos,
)

FREE_SPACE = {1: 61.69574, 10: 81.69574, 100: 101.69574, 300: 111.23817, 500: 115.67514}
LOG_DISTANCE = {100: 131.69574, 300: 148.39499, 500: 156.15969}
CLOSE_IN = {50: 115.8451, 100: 125.4480, 300: 140.6681}
MEAN = {
    ("urban", 45): 83.0925,
    ("suburban", 30): 84.5911,
    ("dense", 60): 82.5683,
    ("high_rise", 45): 111.2918,
}
# TR 38.901: d2, base, user, f -> UMi LoS, NLoS, UMa LoS, NLoS; the last two beyond the breakpoint
GROUND = {
    (100, 10, 1.5, 29): (103.680788, 124.204260, 101.282351, 121.009052),
    (200, 25, 1.5, 2): (86.804757, 110.143403, 84.708764, 109.601212),
    (400, 10, 1.5, 2): (102.981828, 120.668117, 100.662096, 121.252936),
    (1000, 25, 1.5, 2): (110.805355, 134.716171, 108.911673, 136.805285),
}
AERIAL = {  # TR 36.777 at 2 GHz: d2, drone -> LoS, NLoS, chance of LoS in UMi-AV, then in UMa-AV
    (100, 50): (80.411347, 99.972402, 0.925652, 78.310218, 89.625795, 0.994805),
    (300, 100): (89.957083, 108.303966, 0.771170, 88.806886, 100.651515, 0.983843),
    (500, 50): (94.709594, 120.208497, 0.378936, 93.409868, 113.035201, 0.888749),
}
distances = st.floats(10, 4000)


def both(name, *link):
    return PATHLOSS_MODELS[name].los(*link), PATHLOSS_MODELS[name].nlos(*link)


@pytest.mark.parametrize("distance", FREE_SPACE)
def test_free_space(distance):
    assert free_space(distance, 29.0) == pytest.approx(FREE_SPACE[distance], abs=6e-6)


@pytest.mark.parametrize("distance", LOG_DISTANCE)
def test_log_distance(distance):
    assert log_distance(distance, 29.0, EXPONENTS["urbanmarl"]) == pytest.approx(
        LOG_DISTANCE[distance], abs=6e-6
    )


@pytest.mark.parametrize("distance", CLOSE_IN)
def test_close_in_law_has_its_own_constant(distance):
    assert umi_close_in_nlos(distance, 29.0) == pytest.approx(CLOSE_IN[distance], abs=6e-5)
    log = log_distance(distance, 29.0, EXPONENTS["umi_ci"])
    assert log - umi_close_in_nlos(distance, 29.0) == pytest.approx(0.0478, abs=6e-5)


@given(st.floats(1, 1e5), st.floats(0.1, 300))
def test_log_distance_with_2_is_free_space(distance, frequency):
    assert log_distance(distance, frequency, 2.0) == pytest.approx(
        free_space(distance, frequency), rel=1e-12
    )


def test_antennas_that_touch_are_a_metre_apart():
    assert free_space(0.0, 29.0) == free_space(1.0, 29.0)
    assert log_distance(0.0, 29.0, 3.5) == free_space(1.0, 29.0)
    assert umi_close_in_nlos(0.0, 1.0) == 32.4
    for name in PATHLOSS_MODELS:
        assert both(name, 0.0, 30.0, 30.0, 2.0) == both(name, 0.0, 30.0, 29.0, 2.0)


@pytest.mark.parametrize("name", PATHLOSS_MODELS)
def test_losses_are_finite_on_the_ground_too(name):
    heights = np.array([0.0, 0.5, 1.0, 1.5, 22.5, 23.0, 300.0])
    link = np.meshgrid([0.0, 1.0, 100.0, 1e4], heights, heights, 2.0)
    assert np.isfinite(both(name, *link)).all()


@pytest.mark.parametrize("place", MEAN)
def test_mean_path_loss(place):
    kind, elevation = place
    chance = elevation_los(elevation, SIGMOIDS[kind])
    distance = 100 / math.sin(math.radians(elevation))
    assert mean_path_loss(distance, 2.0, chance, *EXCESS[kind]) == pytest.approx(
        MEAN[place], abs=6e-5
    )


def test_excess_loss():
    found = [
        mean_path_loss(100.0, 2.0, chance, *EXCESS[kind]) - free_space(100.0, 2.0)
        for kind in SIGMOIDS
        for chance in (1, 0)
    ]
    assert found == pytest.approx([0.1, 21, 1, 20, 1.6, 23, 2.3, 34], abs=1e-12)


@given(distances, st.floats(0, 1))
def test_mean_path_loss_lies_between_its_ends(distance, chance):
    excess = mean_path_loss(distance, 2.0, chance, *EXCESS["urban"]) - free_space(distance, 2.0)
    assert excess == pytest.approx(20 - 19 * chance, abs=1e-9)


@pytest.mark.parametrize("link", GROUND)
def test_tr_38901(link):
    found = both("umi", *link) + both("uma", *link)
    assert found == pytest.approx(GROUND[link], abs=6e-7)


@pytest.mark.parametrize("law", [umi_los, uma_los])
@given(st.floats(2, 60), st.floats(1.5, 22.5), st.floats(0.5, 100))
def test_loss_in_sight_bends_at_the_breakpoint_without_a_jump(law, base, user, frequency):
    bend = 4 * (base - 1) * (user - 1) * frequency * 1e9 / 3e8
    before, after = (
        law(bend * (1 - 1e-9), base, user, frequency),
        law(bend * (1 + 1e-9), base, user, frequency),
    )
    assert after == pytest.approx(before, abs=1e-6)
    far = max(bend, 1.0) * 1e4
    assert law(10 * far, base, user, frequency) - law(far, base, user, frequency) == pytest.approx(
        40, abs=1e-5
    )


def test_antennas_on_the_ground_have_no_breakpoint():
    assert (
        umi_los(100, 0.0, 1.5, 2)
        == umi_los(100, 1.5, 0.0, 2)
        == pytest.approx(115.076820, abs=6e-7)
    )
    assert umi_los(100, 1.0, 1.0, 1) == pytest.approx(112.4, abs=1e-9)
    assert umi_los(100, 0.0, 0.9, 2) == umi_los(100, 0.9, 0.0, 2)


@pytest.mark.parametrize(("law", "gain"), [(umi_nlos, 0.3), (uma_nlos, 0.6)])
def test_users_without_sight_gain_by_height(law, gain):
    assert law(5000, 10, 1.5, 2) - law(5000, 10, 2.5, 2) == pytest.approx(gain, abs=1e-4)


@pytest.mark.parametrize(
    ("distance", "umi", "uma", "high"),
    [
        (50, 0.519585, 0.649402, 0.691983),
        (100, 0.230985, 0.347671, 0.478347),
        (200, 0.0935180, 0.128048, 0.325726),
    ],
)
def test_chances_of_sight_of_tr_38901(distance, umi, uma, high):
    assert umi_los_probability(distance) == pytest.approx(umi, abs=6e-7)
    assert uma_los_probability(distance, 1.5) == pytest.approx(uma, abs=6e-7)
    assert uma_los_probability(distance, 13.0) == uma_los_probability(distance, 1.5)
    assert uma_los_probability(distance, 20.0) == pytest.approx(high, abs=6e-7)


@pytest.mark.parametrize("place", AERIAL)
def test_tr_36777(place):
    distance, drone = place
    found = both("umi_av", distance, drone, 10, 2) + (umi_av_los_probability(distance, drone),)
    found += both("uma_av", distance, drone, 25, 2) + (uma_av_los_probability(distance, drone),)
    assert found == pytest.approx(AERIAL[place], abs=6e-7)


@pytest.mark.parametrize(("aerial", "ground"), [("umi_av", "umi"), ("uma_av", "uma")])
def test_low_drones_of_tr_36777_are_terminals_of_tr_38901(aerial, ground):
    assert both(aerial, 800.0, 22.5, 1.5, 2.0) == both(ground, 800.0, 1.5, 22.5, 2.0)
    for above, below in zip(
        both(aerial, 800.0, 22.6, 1.5, 2.0), both(ground, 800.0, 1.5, 22.6, 2.0), strict=True
    ):
        assert abs(above - below) > 0.1
    assert umi_av_los_probability(80.0, 20.0) == umi_los_probability(80.0)
    assert uma_av_los_probability(80.0, 20.0) == uma_los_probability(80.0, 20.0)


def test_uma_av_drones_above_100_metres_are_seen():
    assert uma_av_los_probability(3000.0, 100.0) < 0.6
    assert uma_av_los_probability(3000.0, 100.1) == 1
    assert PATHLOSS_MODELS["uma_av"].nlos(200.0, 250.0, 250.0, 2.0) == PATHLOSS_MODELS[
        "uma_av"
    ].nlos(200.0, 100.0, 100.0, 2.0)


@pytest.mark.parametrize("law", [umi_av_los_probability, uma_av_los_probability])
def test_low_aerial_drones_too_are_seen_up_to_18_metres(law):
    assert law(18.0, 23.0) == 1
    assert law(18.01, 23.0) < 1


def test_umi_av_in_sight_is_never_better_than_free_space():
    drone, distance = np.array([[30.0], [300]]), np.geomspace(1, 4000, 50)
    loss, least = (
        umi_av_los(distance, drone, 10.0, 2.0),
        free_space(np.hypot(distance, drone - 10), 2.0),
    )
    assert (loss >= least).all()
    assert umi_av_los(0.0, 300.0, 300.0, 2.0) == free_space(1.0, 2.0)


@given(distances, distances, st.floats(1.5, 300))
def test_chances_are_chances_and_fall_with_distance(one, other, height):
    near, far = min(one, other), max(one, other)
    for chance in (
        umi_los_probability,
        lambda d: umi_av_los_probability(d, height),
        lambda d: uma_av_los_probability(d, height),
    ):
        if chance(far) != chance(near):
            assert 0 <= chance(far) < chance(near) <= 1


@pytest.mark.parametrize("law", [umi_los_probability, lambda d: uma_los_probability(d, 13.0)])
def test_sight_is_certain_up_to_18_metres(law):
    assert law(0.0) == law(18.0) == 1
    assert law(18.01) == pytest.approx(1, abs=1e-3)
    assert law(18.01) < 1


@pytest.mark.parametrize("name", PATHLOSS_MODELS)
@given(distances, distances, st.floats(30, 100), st.floats(0.5, 6))
def test_losses_grow_with_distance_and_without_sight(name, one, other, drone, frequency):
    los, nlos = both(name, np.array([min(one, other), max(one, other)]), drone, 1.5, frequency)
    assert los[0] <= los[1]
    assert nlos[0] <= nlos[1]
    assert (nlos >= los).all()


@pytest.mark.parametrize(
    ("name", "drone", "los", "nlos"),
    [
        ("log_distance", 50, 0, 0),
        ("umi", 50, 4, 7.82),
        ("uma", 50, 4, 6),
        ("umi_av", 22.5, 4, 7.82),
        ("umi_av", 50, 3.032653, 8),
        ("umi_av", 100, 2, 8),
        ("uma_av", 22.5, 4, 6),
        ("uma_av", 100, 2.398190, 6),
    ],
)
def test_shadowing(name, drone, los, nlos):
    model = PATHLOSS_MODELS[name]
    assert shadowing(drone, *model.shadowing_los) == pytest.approx(los, abs=6e-7)
    assert shadowing(drone, *model.shadowing_nlos) == nlos


def test_laws_of_arrays_and_in_kernels_are_those_of_numbers():
    distance = np.geomspace(1, 4000, 40)

    @allocating
    def losses(distance, drone, user, frequency):
        found = np.empty((10, len(distance)))
        for i, d in enumerate(distance):
            found[0, i] = pathloss.log_distance_los(d, drone, user, frequency)
            found[1, i] = pathloss.log_distance_nlos(d, drone, user, frequency)
            found[2, i] = pathloss.umi_los(d, drone, user, frequency)
            found[3, i] = pathloss.umi_nlos(d, drone, user, frequency)
            found[4, i] = pathloss.uma_los(d, drone, user, frequency)
            found[5, i] = pathloss.uma_nlos(d, drone, user, frequency)
            found[6, i] = pathloss.umi_av_los(d, drone, user, frequency)
            found[7, i] = pathloss.umi_av_nlos(d, drone, user, frequency)
            found[8, i] = pathloss.uma_av_los(d, drone, user, frequency)
            found[9, i] = pathloss.uma_av_nlos(d, drone, user, frequency)
        return found

    arrays = [
        law(distance, 60.0, 1.5, 2.0)
        for model in PATHLOSS_MODELS.values()
        for law in (model.los, model.nlos)
    ]
    numbers = [
        [law(d, 60.0, 1.5, 2.0) for d in distance]
        for model in PATHLOSS_MODELS.values()
        for law in (model.los, model.nlos)
    ]
    np.testing.assert_array_equal(losses(distance, 60.0, 1.5, 2.0), arrays)
    np.testing.assert_array_equal(arrays, numbers)


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("umi", {"frequency": 0.4}, "frequency is 0.4: TR 38.901 UMi is valid for 0.5 to 100 GHz"),
        ("uma", {"frequency": 101}, "frequency is 101: TR 38.901 UMa is valid for 0.5 to 100 GHz"),
        (
            "uma_av",
            {"frequency": 29},
            "frequency is 29: TR 36.777 UMa-AV is valid for 0.5 to 6 GHz",
        ),
        (
            "log_distance",
            {"frequency": 29e9},
            "frequency is .*: log-distance is valid for 3e-06 to 3000 GHz",
        ),
        ("log_distance", {"frequency": math.nan}, "frequency is nan"),
        ("log_distance", {"frequency": 2, "drone": math.inf}, "drone is inf"),
        ("umi", {"frequency": 2, "distance": 9.9}, "distance is 9.9: .* 10 to 5000 m"),
        (
            "umi_av",
            {"frequency": 2, "distance": [10, 4001]},
            "distance is .10, 4001.: .* 0 to 4000 m",
        ),
        ("umi_av", {"frequency": 2, "drone": 301}, "drone is 301: .* 1.5 to 300 m"),
        ("uma", {"frequency": 2, "user": 0}, "user is 0: .* 1.5 to 22.5 m"),
        ("uma", {"frequency": 2, "drone": math.nan}, "drone is nan"),
        ("uma", {"frequency": "high"}, "frequency is not numbers"),
        ("umi_ah", {"frequency": 2}, "unknown path loss model 'umi_ah': did you mean"),
    ],
)
def test_what_a_model_is_not_for_is_refused_by_name(name, values, message):
    with pytest.raises(ValueError, match=message):
        check_validity(name, **values)


@pytest.mark.parametrize(
    ("name", "end", "height"), [("umi", "drone", 10), ("uma", "drone", 25), ("umi_av", "user", 10)]
)
def test_a_base_at_another_height_is_warned_about(name, end, height):
    with pytest.warns(UserWarning, match=f"{end} is 5.0: .* the base station, at {height} m in"):
        check_validity(name, 2.0, **{end: 5.0})


def test_ranges_are_those_of_the_standards():
    found = {name: tuple(model.validity[1:]) for name, model in PATHLOSS_MODELS.items()}
    assert found == {
        "log_distance": ((3e-6, 3000), (0, math.inf), (0, math.inf), (0, math.inf)),
        "umi": ((0.5, 100), (10, 5000), (10, 10), (1.5, 22.5)),
        "uma": ((0.5, 100), (10, 5000), (25, 25), (1.5, 22.5)),
        "umi_av": ((0.5, 6), (0, 4000), (1.5, 300), (10, 10)),
        "uma_av": ((0.5, 6), (0, 4000), (1.5, 300), (25, 25)),
    }


def test_what_a_model_is_for_passes():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert (
            check_validity("umi", 29.0, np.array([10.0, 5000]), 10.0, (1.5, 22.5))
            is PATHLOSS_MODELS["umi"]
        )
        assert (
            check_validity("uma_av", 6.0, 0.0, np.linspace(1.5, 300, 9), 25)
            is PATHLOSS_MODELS["uma_av"]
        )
        assert (
            check_validity("log_distance", 29.0, 0.0, 500.0, 0.0) is PATHLOSS_MODELS["log_distance"]
        )
