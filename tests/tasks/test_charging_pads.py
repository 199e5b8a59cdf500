"""Charging pads: power, zones, one drone at a time, landing, observation and options."""

import contextlib
import json

import numpy as np
import pytest

import bulletuav
from bulletuav.analysis.recording import fly_episode
from bulletuav.policies import find_policy
from bulletuav.report.film import Film
from bulletuav.report.pictures import plot_tracks
from bulletuav.tasks.parts.charging_pads import assign_pads

HUNDRED = {"city": "open", "area": 200.0, "dynamics": "single_integrator", "min_separation": 5.0}
"""A small city without buildings"""
PADS = ((0.0, 0.0), (40.0, 0.0))
TASKS = (
    "default",
    "navigation",
    "lidar_navigation",
    "coverage",
    "los",
    "mobile_users",
    "mec",
    "mec_advanced",
    "pursuit_evasion",
)


def aviary_of(task="coverage", **options):
    aviary = bulletuav.Aviary(task, 1, **{**HUNDRED, "charging_pads": PADS, **options})
    aviary.reset(seeds=3, charge=np.full(aviary.num_drones, 0.5))
    return aviary


def stay(aviary, decisions):
    step = None
    for _ in range(decisions):
        step = aviary.step(np.zeros((1, aviary.num_drones, 3)))
    return step


def test_a_pad_adds_its_power_to_a_drone_in_its_zone_until_the_battery_is_full():
    # 250 W for 1 s, less the power of hover, of a battery of 2 W h
    start = ((1.0, 0.0, 2.0), (2.5, 5.0, 2.0), (40.0, 0.0, 3.5))
    with contextlib.closing(
        aviary_of(num_drones=3, start=start, height=(1.0, 10.0), battery_capacity=2.0, d_safe=1.0)
    ) as aviary:
        stay(aviary, 1)  # the pad finds the drone at the end of the first decision
        before = aviary.readings["charge"].copy()
        step = stay(aviary, 10)
        gained = aviary.readings["charge"] - before
        hover = aviary.readings["power"][0, 0]
        assert hover == pytest.approx(70.268, abs=0.001)
        np.testing.assert_allclose(gained[0, 0], (250.0 - hover) / (2 * 3600), rtol=1e-9)
        np.testing.assert_allclose(gained[0, 1:], -hover / (2 * 3600), rtol=1e-9)
        np.testing.assert_array_equal(step.info["charging"], [[True, False, False]])
        stay(aviary, 200)
        assert aviary.readings["charge"][0, 0] == 1.0


def test_a_drone_leaves_a_pad_to_the_nearest_one_that_waits():
    position = np.array([[(0.0, 0.0, 1.0), (1.0, 0.0, 1.0), (0.5, 0.0, 1.0)]])
    pad, drone = np.zeros((1, 1, 3)), np.zeros((1, 1))
    alive = np.ones((1, 3), dtype=bool)
    assign_pads(position, alive, pad, 2.0, 3.0, drone)
    assert drone[0, 0] == 1
    position[0, 0, 0] = 1.9  # the farthest now, but still there
    assign_pads(position, alive, pad, 2.0, 3.0, drone)
    assert drone[0, 0] == 1
    position[0, 0, 2] = 3.1  # too high
    assign_pads(position, alive, pad, 2.0, 3.0, drone)
    assert drone[0, 0] == 3
    alive[0, 2] = False
    assign_pads(position, alive, pad, 2.0, 3.0, drone)
    assert drone[0, 0] == 2
    position[0, :, 1] = 2.1
    assign_pads(position, alive, pad, 2.0, 3.0, drone)
    assert drone[0, 0] == 0


def test_pads_are_observed_by_distance_with_their_state():
    start = ((1.0, 0.0, 2.0), (38.0, 0.0, 2.0))
    with contextlib.closing(
        aviary_of(num_drones=2, start=start, height=(1.0, 10.0), num_neighbours=3)
    ) as aviary:
        stay(aviary, 1)
        part = aviary.observer.slices["pads"]
        first, second = aviary.observations()[0, :, part]
        np.testing.assert_allclose(first, [-1, 0, -2, 0, 39, 0, -2, 1, 1], rtol=1e-6)
        np.testing.assert_allclose(second, [2, 0, -2, 0, -38, 0, -2, 1, 1], rtol=1e-6)


def test_drones_may_land_on_pads_and_charge_there():
    with contextlib.closing(
        aviary_of(
            num_drones=1,
            start=((0.0, 0.0, 1.0),),
            height=(0.5, 10.0),
            dynamics="rigid_body",
            city="open",
        )
    ) as aviary:
        for _ in range(40):
            step = aviary.step(np.array([[[0.0, 0.0, -0.05]]]))
        assert step.info["landed"][0, 0]
        assert step.info["charging"][0, 0]
        assert aviary.alive[0, 0]
        assert not step.info["collision"][0, 0]


@pytest.mark.parametrize("task", TASKS)
def test_every_task_in_a_city_has_pads(task):
    options = {"area": 250.0, "charging_pads": 3, "battery_capacity": 5.0}
    if task in ("default", "navigation", "lidar_navigation"):
        options["leg"] = 50.0
    if task == "default":
        del options["leg"]
    with contextlib.closing(bulletuav.Aviary(task, 2, **options)) as aviary:
        aviary.reset(seeds=1)
        pads = aviary.scene.memory["pad"]
        assert pads.shape == (2, 3, 3)
        assert not np.array_equal(pads[0], pads[1])
        assert aviary.observer.slices["pads"]
        for w in range(2):
            solids = aviary.solids(w).bounds
            inside = (pads[w, :, None, :2] > solids[:, 0, :2]) & (
                pads[w, :, None, :2] < solids[:, 1, :2]
            )
            assert not inside.all(axis=-1).any()
        stay_action = np.zeros((2, aviary.num_drones, aviary.action.low.shape[-1]))
        assert "charging" in aviary.step(stay_action).info


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"charging_pads": -1}, "charging_pads is -1: a whole number, at least 0"),
        ({"charging_pads": 1.5}, "charging_pads is 1.5"),
        ({"charging_pads": ((0.0, 0.0, 0.0),)}, "a list or tuple of 2 values"),
        ({"charging_pads": ((0.0, 0.0), (3.0, 0.0))}, "3 m apart, and 6 m are needed"),
        ({"charging_pads": ((500.0, 0.0),)}, "outside of the city"),
        ({"charging_pads": 1000, "area": 60.0, "min_separation": 1.0}, "no place is left for pad"),
        ({"pad_power": 0.0}, "pad_power is 0: it must be above 0"),
        ({"pad_radius": 0.0}, "pad_radius is 0: it must be above 0"),
        ({"pad_height": 0.01}, "pad_height is 0.01 m: more than"),
        ({"battery_capacity": None}, "no effect without battery_capacity"),
    ],
)
def test_wrong_options_of_pads_name_the_remedy(options, message):
    with pytest.raises(ValueError, match=message):
        aviary_of(**options)


def test_places_in_buildings_are_an_error():
    with contextlib.closing(bulletuav.Aviary("coverage", 1, city="dense")) as aviary:
        aviary.reset(seeds=0)
        middle = aviary.solids().bounds[0, :, :2].mean(axis=0)
    with pytest.raises(ValueError, match="in or near a building of layout"):
        bulletuav.Aviary("coverage", 1, city="dense", charging_pads=(tuple(middle),))


def test_a_task_without_pads_is_unchanged():
    for number in (0, ()):
        with contextlib.closing(bulletuav.Aviary("coverage", 1, charging_pads=number)) as aviary:
            assert "pads" not in aviary.observer.slices
            assert not aviary.task.overrides_method("charging_power")
            assert not aviary.task.lands


def test_pads_are_in_pictures(tmp_path):
    with contextlib.closing(
        aviary_of(num_drones=1, area=60.0, charging_pads=((5.0, -5.0), (-5.0, 5.0)), horizon=4)
    ) as aviary:
        flown = fly_episode(aviary, find_policy("stay")(aviary), 0)
    pads = json.loads(str(flown.scene["about"]))["pads"]
    assert pads == {"places": [[5.0, -5.0, 0.0], [-5.0, 5.0, 0.0]], "radius": 2.0}
    plot_tracks(flown, 2.0, "pads", tmp_path / "pads.png", {})
    with contextlib.closing(Film(flown, "", camera="still")) as film:
        red, green, blue = film.picture(0.0)[..., :3].reshape(-1, 3).T.astype(int)
    assert ((blue > green + 10) & (green > red + 30)).sum() > 20
