"""Bodies that turn: what they hit gets the velocity of their surface; rays see where they are."""

import math

import numpy as np
import pytest

from bulletuav import Airspace
from bulletuav.contact.manifold import TARGET_SEPARATION
from bulletuav.contact.moving_bodies import bound_body_motion, start_bodies
from bulletuav.contact.time_of_impact import CONTACT_DISTANCE
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.scenery import NOWHERE

BAR = Obstacle("box", (4.0, 0.1, 0.4), friction=0.0)
RADIUS = 0.0691
"""Radius of the collision shape of cf2x, m"""


def about_z(angle):
    return (0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2))


def hit_by_bar(dynamics, **options):
    """The bar starts half a radian before the drone, and turns at 2 rad/s."""
    airspace = Airspace([(1.5, 0.0, 5.0)], dynamics=dynamics, decision_hz=240, **options)
    bar = airspace.add_body(BAR, (0, 0, 5), about_z(-0.5), angular_velocity=(0, 0, 2))
    while not len(airspace.contacts.world):
        airspace.step()
        assert airspace.time < 1.0
    assert airspace.contacts.other[0] == bar
    # The face of the bar, 0.05 m beside its axis, meets the rim of the drone
    angle = math.asin((RADIUS + 0.05) / 1.5)
    assert airspace.time == pytest.approx((0.5 - angle) / 2 + 0.5 / 240, abs=0.5 / 240)
    return airspace


@pytest.mark.parametrize("dynamics", ["rigid_body", "bullet"])
def test_a_drone_at_rest_gets_the_velocity_of_the_point_of_the_bar(dynamics):
    airspace = hit_by_bar(dynamics, gravity=0.0, effects=())
    (x, y, _), normal = airspace.contacts.point[0], airspace.contacts.normal[0]
    surface = np.array((-2.0 * y, 2.0 * x, 0.0))
    np.testing.assert_allclose(airspace.contacts.velocity[0], -surface, atol=1e-6)
    # Along the normal the drone's surface moves with the bar, except for the gap that may close
    arm = airspace.contacts.point[0] - airspace.swarm.position[0]
    spin = airspace.swarm.rates[0]  # level drones: world axes
    moved = airspace.swarm.velocity[0] + np.cross(spin, arm)
    closing = (CONTACT_DISTANCE - TARGET_SEPARATION) * 240
    assert moved @ normal == pytest.approx(surface @ normal - closing, abs=1e-4)
    # At 2 rad/s; the axis of the drone is 1.5 m from that of the bar
    along = math.sqrt(1.5**2 - (RADIUS + 0.05) ** 2)
    assert surface @ normal == pytest.approx(2 * along, abs=1e-3)


def test_a_drone_that_stops_at_contacts_stays_there():
    airspace = hit_by_bar("single_integrator")
    airspace.step()
    np.testing.assert_allclose(airspace.swarm.position[0], (1.5, 0, 5), atol=1e-12)


@pytest.mark.parametrize(("spin", "seconds"), [(0.5, 2), (-1.0, 1)])
def test_a_turntable_carries_a_drone_after_it_slipped(spin, seconds):
    airspace = Airspace([(1.0, 0.0, 2.0)], dynamics="rigid_body", decision_hz=240)
    airspace.place(0, (1.0, 0.0, 1.0 + airspace.airframes[0].standing_height))
    airspace.add_body(Obstacle("cylinder", (2.0, 0.2)), (0, 0, 0.9), angular_velocity=(0, 0, spin))
    for _ in range(240 * seconds):
        airspace.step()
    x, y, _ = airspace.swarm.position[0]
    # Friction 0.5 takes the time v / (0.5 g) to reach its speed; half that time is lost
    lost = 0.5 * abs(spin) / (0.5 * 9.80665) * abs(spin)
    carried = math.copysign(abs(spin) * seconds - lost, spin)
    assert math.atan2(y, x) == pytest.approx(carried, abs=2e-3)
    assert math.hypot(x, y) == pytest.approx(1.0, abs=6e-3)
    assert airspace.swarm.rates[0, 2] == pytest.approx(spin, abs=1e-6)


def test_a_drone_that_sleeps_wakes_when_the_bar_comes():
    airspace = Airspace([(1.5, 0.0, 1.0)], dynamics="rigid_body", decision_hz=48)
    airspace.place(0, (1.5, 0.0, airspace.airframes[0].standing_height))
    bar = airspace.add_body(BAR, (0, 0, 0.21), about_z(-1.5), angular_velocity=(0, 0, 1))
    for _ in range(48):
        airspace.step()
    assert airspace.world.dynamics.contact.asleep.all()
    while bar not in airspace.contacts.other:
        airspace.step()
        assert airspace.time < 2.0
    expected = 1.5 - math.asin((RADIUS + 0.05) / 1.5)
    assert airspace.time == pytest.approx(expected + 0.5 / 48, abs=0.5 / 48 + 1e-3)


def test_rays_and_pictures_see_the_bar_where_it_turned_to():
    airspace = Airspace([(0.0, 9.0, 5.0)], dynamics="point_mass", decision_hz=48)
    airspace.add_body(BAR, (0, 0, 5), angular_velocity=(0, 0, math.pi / 2))
    for _ in range(24):
        airspace.step()
    # At 45 degrees a ray along x meets the face at 0.05 / sin(45 degrees) before the centre
    before = 0.05 * math.sqrt(2)
    engine = airspace.world.engine
    start, end = np.array([(-5.0, 0, 5)]), np.array([(5.0, 0, 5)])
    (share,) = engine.cast_rays(start, end, np.zeros(1, dtype=int))
    assert share == pytest.approx((5 - before) / 10, abs=1e-12)
    picture = airspace.picture(position=(-5, 0, 5), target=(0, 0, 5), size=(64, 64))
    assert picture.depth[32, 32] == pytest.approx(5 - before, abs=0.1)
    hidden = airspace.picture(position=(-5, 1, 5), target=(0, 1, 5), size=(64, 64))
    assert hidden.depth[32, 32] == pytest.approx(5 + 1 - before, abs=0.1)


def test_pieces_move_on_circles_about_the_origin_of_their_body(tmp_path):
    corners = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    text = ""
    for name, shift in (("near", 0), ("far", 3)):
        text += f"o {name}\n" + "".join(f"v {x + shift} {y} {z}\n" for x, y, z in corners)
        # Corners count from the last: 4 x + 2 y + z - 8
        text += "f -8 -7 -5 -6\nf -4 -2 -1 -3\nf -8 -4 -3 -7\n"
        text += "f -6 -5 -1 -2\nf -8 -6 -2 -4\nf -7 -3 -1 -5\n"
    (tmp_path / "two.obj").write_text(text)
    airspace = Airspace([(0.0, 0.0, 20.0)], dynamics="point_mass", decision_hz=48)
    airspace.add_body(
        tmp_path / "two.obj", (0, 0, 5), velocity=(0, 0, 1), angular_velocity=(0, 0, math.pi / 2)
    )
    for _ in range(48):
        airspace.step()
    scenery = airspace.world.engine.scenery
    np.testing.assert_allclose(scenery.place[0], [(-0.5, 0.5, 6.5), (-0.5, 3.5, 6.5)], atol=1e-9)
    np.testing.assert_allclose(scenery.bodies.quaternion[0], [about_z(math.pi / 2)], atol=1e-12)
    # The farthest corner is at (4, 1, 1), and its bounding sphere at (3.5, .5, .5) farther out
    reach = math.sqrt(3.5**2 + 0.5) + math.sqrt(0.75)
    assert scenery.bodies.reach == pytest.approx([reach])
    start_bodies(scenery.bodies, np.ones(1, dtype=bool), 0.5)
    assert bound_body_motion(scenery.bodies, 0) == pytest.approx(0.5 + math.pi / 4 * reach)


def test_a_body_can_be_moved_removed_and_returned():
    airspace = Airspace([(0.0, 0.0, 5.0)], dynamics="point_mass", decision_hz=48)
    ball = Obstacle("sphere", (0.5,))
    first = airspace.add_body(ball, (3, 0, 5))
    second = airspace.add_body(ball, (6, 0, 5), velocity=(0, 0.48, 0))

    def place():
        return airspace.world.engine.scenery.place[0]

    def bodies():
        return airspace.world.engine.scenery.bodies

    airspace.step()
    np.testing.assert_allclose(place(), [(3, 0, 5), (6, 0.01, 5)], atol=1e-12)
    airspace.move_body(first, (3, 1, 5), velocity=(4.8, 0, 0))
    airspace.remove_body(second)
    airspace.step()
    np.testing.assert_allclose(place(), [(3.1, 1, 5), (NOWHERE,) * 3], atol=1e-12)
    airspace.move_body(second, (0, -3, 5))
    airspace.step()
    np.testing.assert_allclose(place(), [(3.2, 1, 5), (0, -3, 5)], atol=1e-12)
    assert bodies().velocity[0].tolist() == [[4.8, 0, 0], [0, 0, 0]]
    with pytest.raises(ValueError, match="would overlap a body by"):
        airspace.move_body(second, (0.1, 0, 5), velocity=(1, 0, 0))
    np.testing.assert_allclose(bodies().position[0, 1], (0, -3, 5))
    assert not bodies().velocity[0, 1].any()


def test_a_body_follows_a_function_of_time():
    """A door that swings by 0.5 rad at 1 Hz, and slides along x."""

    def swing(time):
        return (0.5 * time, 0, 5), about_z(0.5 * math.sin(2 * math.pi * time))

    airspace = Airspace([(0.0, 3.0, 5.0)], dynamics="point_mass", decision_hz=48)
    door = airspace.add_body(BAR, motion=swing)
    for _ in range(60):
        airspace.step()
    bodies = airspace.world.engine.scenery.bodies
    np.testing.assert_allclose(bodies.position[0, 0], (0.625, 0, 5), atol=1e-12)
    np.testing.assert_allclose(bodies.quaternion[0, 0], about_z(0.5), atol=1e-12)
    np.testing.assert_allclose(bodies.velocity[0, 0], (0.5, 0, 0), atol=1e-9)
    with pytest.raises(ValueError, match="follows its function of time"):
        airspace.move_body(door, (0, 0, 5))
    airspace.remove_body(door)
    airspace.move_body(door, (0, 0, 5))


def test_a_snapshot_restores_poses_and_motion_of_bodies():
    def make():
        airspace = Airspace([(1.5, 0.0, 5.0)], dynamics="rigid_body", decision_hz=48)
        bar = airspace.add_body(BAR, (0, 0, 5), about_z(-0.5), angular_velocity=(0, 0, 2))
        return airspace, bar

    airspace, bar = make()
    airspace.step()
    saved = airspace.save_state()
    for _ in range(20):
        airspace.step()
    flown = airspace.state_hash()
    airspace.move_body(bar, (9, 9, 9))
    airspace.load_state(saved)
    for _ in range(20):
        airspace.step()
    assert airspace.state_hash() == flown
    other, _ = make()
    other.load_state(saved)
    for _ in range(20):
        other.step()
    assert other.state_hash() == flown


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda a: a.add_body(BAR), "a body has no position: give position, or motion"),
        (lambda a: a.add_body(BAR, (0, 0, 9), velocity=(0, 200, 0)), "velocity is 200: at most"),
        (
            lambda a: a.add_body(BAR, (0, 0, 9), angular_velocity=(0, 0, -101)),
            "angular_velocity is -101: at least -100",
        ),
        (lambda a: a.add_body(BAR, (0, 0, 9), motion=abs), "motion of a body gives its poses"),
        (lambda a: a.add_body(BAR, motion=3), "motion of a body is 3: a function"),
        (lambda a: a.add_body(BAR, motion=abs), "motion of a body returned 0.0 at 0 s: a position"),
        (
            lambda a: a.add_body(BAR, motion=lambda t: ((0, 0, 0), (0, 0, 0, 2))),
            "motion of a body at 0 s: quaternion",
        ),
        (lambda a: a.move_body(-3, (0, 0, 0)), "there are no bodies: add one by add_body"),
    ],
)
def test_bodies_that_cannot_move_so(call, message):
    airspace = Airspace([(0.0, 0.0, 5.0)], dynamics="point_mass")
    with pytest.raises(ValueError, match=message):
        call(airspace)
    airspace.step()


def test_a_motion_that_jumps_is_an_error():
    airspace = Airspace([(0.0, 0.0, 5.0)], dynamics="point_mass", decision_hz=48)
    airspace.add_body(BAR, motion=lambda t: ((0 if t < 0.1 else 50, 9, 5), (0, 0, 0, 1)))
    for _ in range(4):
        airspace.step()
    with pytest.raises(ValueError, match=r"motion of a body up to 0.104\d* s: velocity is 2400"):
        airspace.step()


def test_what_bullet_knows_of_a_body_moves_too():
    """Rays that Bullet casts, and contacts that it resolves."""
    airspace = Airspace([(0.0, 9.0, 5.0)], dynamics="point_mass", decision_hz=48, rays="bullet")
    bar = airspace.add_body(
        Obstacle("cylinder", (0.5, 4.0)), (0, 0, 5), angular_velocity=(math.pi / 2, 0, 0)
    )
    engine = airspace.world.engine

    def share():
        ends = np.array([(-5.0, 1.5, 5)]), np.array([(5.0, 1.5, 5)])
        return engine.cast_rays(*ends, np.zeros(1, dtype=int))[0]

    assert share() == 1
    for _ in range(48):
        airspace.step()
    assert share() == pytest.approx(0.45, abs=1e-3)
    airspace.remove_body(bar)
    assert share() == 1
