"""Cruise of aircraft that cannot hover: trim, tightest turn, and speed limits of fleets."""

from collections.abc import Sequence
from functools import lru_cache

from bulletuav.compiled.functions import tan
from bulletuav.vehicle.airframe import STANDARD_GRAVITY, Airframe
from bulletuav.vehicle.envelope import Trim, find_envelope, find_trim


@lru_cache(128)
def cruise_trim(airframe: Airframe) -> Trim:
    """Return the trim of an aircraft in level flight at its cruise speed."""
    return find_trim(airframe, find_envelope(airframe).cruise_speed)


def turn_radius(airframe: Airframe) -> float:
    """Return the radius of the tightest turn at cruise speed, V^2 / (g tan(max_bank)), m."""
    envelope = find_envelope(airframe)
    speed = envelope.cruise_speed
    return float(speed * speed / (STANDARD_GRAVITY * tan(envelope.max_bank)))


def top_speed(airframe: Airframe) -> float:
    """Return the speed limit of a drone: that of its airframe, or of level flight, m/s."""
    return find_envelope(airframe).max_speed if airframe.needs_airspeed else airframe.max_speed


def limiting_airframe(airframes: Sequence[Airframe]) -> Airframe:
    """Return the airframe whose top speed is the largest speed limit of a fleet.

    It is the slowest one. In fleets with aircraft that cannot hover it is the fastest one, as the
    slowest may be slower than others can fly; each drone then has its own limit.
    """
    choose = max if any(one.needs_airspeed for one in airframes) else min
    return choose(airframes, key=top_speed)
