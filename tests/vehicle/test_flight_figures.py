"""The laws against figures of real flights: bins of benchmarks/flight_data/measured.json."""

import json
from pathlib import Path

import numpy as np
import pytest

from bulletuav import load_airframe
from bulletuav.vehicle.aerodynamics import drag, ground_effect
from bulletuav.vehicle.parameters import parameter_rows
from bulletuav.vehicle.wake import downwash

MEASURED = json.loads(
    (Path(__file__).parents[2] / "benchmarks" / "flight_data" / "measured.json").read_text()
)
CF2X = load_airframe("cf2x")
ROW = parameter_rows([CF2X])[0]
GRAM = 9.80665e-3
"""Weight of a gram, N."""


def columns(test, half, *names):
    bins = MEASURED[test]["bins"][half]
    return [np.array([one[name] for one in bins]) for name in names]


def rms(errors):
    return float(np.sqrt(np.mean(np.square(errors))))


@pytest.mark.parametrize("half", ["fit", "kept"])
def test_the_wake_pushes_as_measured(half):
    """0.65 g over all bins of the kept half; without a wake they are 4 g off."""
    distance, drop, upper, push = columns("wake", half, "distance", "drop", "upper", "push")
    law = [
        downwash(d * d, z, t * GRAM, ROW)[0] / GRAM
        for d, z, t in zip(distance, drop, upper, strict=True)
    ]
    assert rms(law - push) < 0.65
    assert rms(push) > 3


@pytest.mark.parametrize("half", ["fit", "kept"])
def test_the_wake_tips_as_measured(half):
    """Bins within 0.15 m; beyond, the measurements scatter by 0.5 mN m about nothing."""
    distance, drop, upper, moment = columns("wake", half, "distance", "drop", "upper", "moment")
    near = distance < 0.15
    law = [
        1e3 * CF2X.arm**2 * d * downwash(d * d, z, t * GRAM, ROW)[1]
        for d, z, t in zip(distance, drop, upper, strict=True)
    ]
    assert rms((law - moment)[near]) < 0.45
    assert rms(moment[near]) > 1.2


@pytest.mark.parametrize("half", ["fit", "kept"])
def test_the_ground_lifts_as_measured(half):
    height, share = columns("ground_effect", half, "height", "share")
    law = np.array([ground_effect(h, ROW) for h in height])
    assert 100 * rms(law - share) < 0.9
    assert 100 * rms(share) > 6


@pytest.mark.parametrize("half", ["fit", "kept"])
def test_drag_turns_a_drone_as_measured(half):
    """The torque of horizontal drag, over the velocity along the body's axes, mN m."""
    velocity, moment = columns("drag_moment", half, "velocity", "moment")
    hover = 4 * CF2X.hover_speed()
    law = [1e3 * drag((0.0, 0.0, 0.0, 1.0), (v, 0.0, 0.0), hover, ROW)[1][1] for v in velocity]
    signed = np.abs(law) * np.sign(velocity)
    assert rms(signed - moment) < 0.05 or rms(-signed - moment) < 0.05
    assert rms(moment) > 0.2


def test_predictions_of_flights_reach_what_docs_tell():
    """Recorded by benchmarks/truth.py from the flights themselves."""
    goals = {"positions": (0.015, 0.053, 0.015, 0.056), "rates": (1.9, 1.8, 0.65)}
    for test, most in goals.items():
        errors = MEASURED[test]["errors"]
        assert (np.array(errors["now"]["kept"]) <= most).all()
        naive = "constant velocity" if test == "positions" else "constant rates"
        for other in (naive, "gym-pybullet-drones", "before"):
            assert (np.array(errors["now"]["kept"]) < errors[other]["kept"]).all()
    soon = MEASURED["rates_soon"]["errors"]
    for half in ("fit", "kept"):
        for other in ("constant rates", "rates of 0", "gym-pybullet-drones", "before"):
            assert (np.array(soon["now"][half]) < soon[other][half]).all()
