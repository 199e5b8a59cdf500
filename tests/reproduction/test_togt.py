"""Tests of the table `togt`: tracks, plans and flights."""

import math
from pathlib import Path

import numpy as np
import pytest

from bulletuav.reproduction.time_optimal import (
    Opening,
    QuadrotorLimits,
    exceed_limits,
    join_pieces,
    optimize_flight,
)
from bulletuav.reproduction.togt import (
    TOGT_LIMITS,
    TogtTrack,
    fly_plan,
    read_togt_track,
    write_togt_urdf,
)

TRACK = """
orders: [Gate1, Gate2, Gate3]
initState: {pos: [0, 0, 2]}
endState: {pos: [12, 0, 2]}
Gate1: {type: RectanglePrisma, position: [4, 0, 2], rpy: [0, -90, 0], width: 2.4, height: 2.0,
        marginW: 0.4, marginH: 0.0, length: 0.0}
Gate2: {type: SingleBall, position: [6, 0, 2], radius: 0.3, margin: 0.1}
Gate3: {type: PentagonPrisma, position: [8, 0, 2], rpy: [0, -90, 0], radius: 2.0, margin: 0.0,
        length: 2.0, midpoints: 1}
"""


@pytest.fixture
def track_file(tmp_path: Path) -> Path:
    """A track with a rectangle, a ball and a tunnel."""
    path = tmp_path / "track.yaml"
    path.write_text(TRACK)
    return path


def test_openings_have_the_shapes_of_the_file(track_file: Path) -> None:
    """The rectangle is 2 m wide and high, the ball has 0.2 m, the tunnel is 2 m long."""
    track = read_togt_track(track_file)
    assert len(track.openings) == 5
    gate, ball, *tunnel = track.openings
    for offset, outside in (((0, 0.99, 0.99), 0.0), ((0, 1.1, 0), 0.1), ((0, 0, -1.2), 0.2)):
        assert gate.excess(gate.centre + offset).max() == pytest.approx(outside)
    assert gate.excess(gate.centre + (0.3, 0, 0)).max() == pytest.approx(0.3)
    assert ball.excess(ball.centre + (0, 0.5, 0)).max() == pytest.approx(0.3)
    # With a pitch of -90 degrees the axis of the tunnel is -x, and the first face is half ahead
    assert [round(float(one.centre[0]), 9) for one in tunnel] == [7.0, 8.0, 9.0]
    # A corner of the pentagon is up, 2 m from the centre
    assert tunnel[0].excess(tunnel[0].centre + (0, 0, 1.99)).max() == pytest.approx(0.0)
    assert tunnel[0].excess(tunnel[0].centre - (0, 0, 1.99)).max() > 0.3


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("SingleBall", "Ring", "type of gate 'Gate2'"),
        ("radius: 0.3", "radius: .nan", "radius of gate 'Gate2'"),
        ("margin: 0.1", "margin: 0.4", "widen"),
        ("[4, 0, 2]", "[4, 0]", "position of gate 'Gate1'"),
        ("endState", "last", "endState"),
        ("Gate3]", "Gate4]", "Gate4"),
    ],
)
def test_damaged_tracks_raise_an_error(track_file: Path, old: str, new: str, words: str) -> None:
    """The message names the gate and the field."""
    track_file.write_text(TRACK.replace(old, new))
    with pytest.raises(ValueError, match=words):
        read_togt_track(track_file)


def test_one_piece_is_the_known_minimum_snap_polynomial() -> None:
    """From rest to rest: 35 u^4 - 84 u^5 + 70 u^6 - 20 u^7."""
    flight = join_pieces(
        np.zeros((0, 3)), np.array([2.0]), np.array([[0.0] * 3, [1.0, 0, 0]]), np.zeros(0, int)
    )
    expected = [0, 0, 0, 0, 35, -84, 70, -20]
    assert np.allclose(flight.coefficients[0, :, 0], expected, atol=1e-6)
    # Half of the way at half of the time, at 35 / 16 of the mean speed
    motion = flight.motion(np.array([1.0]))[0]
    assert motion[:2, 0] == pytest.approx([0.5, 35 / 32])


def test_hover_uses_a_quarter_of_the_weight_per_rotor() -> None:
    """Reserves of a drone that hovers at 1 m, with numbers computed by hand."""
    motion = np.zeros((1, 5, 3))
    motion[:, 0, 2] = 1.0
    excess = exceed_limits(motion, TOGT_LIMITS)[0]
    assert excess[0] == pytest.approx(0.85 * 9.8066 / 4 / 6.879 - 1.0, abs=1e-4)
    assert excess[3] == pytest.approx(-0.7)


def test_straight_flight_approaches_the_bang_bang_time(tmp_path: Path) -> None:
    """No plan is faster than the point mass, more pieces are faster, and the drone follows."""
    limits = TOGT_LIMITS
    ends = np.array([[0.0, 0.0, 5.0], [12.0, 0.0, 5.0]])
    flat = np.array([[1.0, 0, 0], [-1.0, 0, 0]])
    gate = Opening(np.array([6.0, 0, 5.0]), flat, np.zeros(2), math.inf)
    one, three = optimize_flight([gate], ends, limits, (1, 3), 40)
    # Level: the horizontal acceleration that thrust leaves beside the weight
    level = math.sqrt((4 * limits.max_thrust / limits.mass) ** 2 - limits.gravity**2)
    fastest = 2 * math.sqrt(12.0 / level)
    assert fastest < three.duration < one.duration < 2.0 * fastest
    times = np.linspace(0.0, one.duration, 500)
    assert exceed_limits(one.motion(times), limits)[:, (0, 2)].max() < 0.01
    urdf = tmp_path / "togt.urdf"
    write_togt_urdf(urdf)
    flight = fly_plan(one, TogtTrack([gate], ends), urdf)
    assert flight.time == pytest.approx(one.duration, rel=0.02)
    assert flight.excess[0] < 0.02
    assert flight.error < 0.05


def test_slower_drones_need_longer() -> None:
    """Time scales with the root of the mass at the same thrust to weight, without torques."""
    ends = np.array([[0.0, 0.0, 5.0], [4.0, 0.0, 5.0]])
    ball = Opening(np.array([2.0, 1.0, 5.0]), np.zeros((0, 3)), np.zeros(0), 0.3)
    weak = QuadrotorLimits(1.0, 0.0, 0.1, 0.0, 5.0, 50.0, 0.0, 9.8)
    strong = weak._replace(max_thrust=10.0)
    (slow,), (fast,) = (optimize_flight([ball], ends, one, (1,), 30) for one in (weak, strong))
    assert fast.duration < 0.9 * slow.duration
