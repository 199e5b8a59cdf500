"""Cables between bodies: reference solutions, statics, conservation, contacts and snapshots."""

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bulletuav.analysis.airspace_recorder import AirspaceRecorder
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.envs.airspace import Airspace
from bulletuav.envs.aviary import Aviary
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.rotation import from_euler, to_world
from bulletuav.report.verification import Verifier
from bulletuav.vehicle.load import make_load

GRAVITY = 9.80665
HZ = 240
BOTH = ("rigid_body", "bullet")
ANCHOR = np.array((0.0, 0.0, 10.0))


def ball(mass, radius=0.01):
    """Return a small ball without drag."""
    return make_load(Obstacle("sphere", (radius,)), mass, drag_area=(0.0, 0.0))


def make(position, airframe, **options):
    """Make an airspace, by default in `rigid_body`."""
    return Airspace(position, airframe=airframe, **{"dynamics": "rigid_body", **options})


def swung(angle, length=1.0):
    """Return the vector from an anchor to the end of a pendulum in the plane y = 0."""
    return length * np.array((math.sin(angle), 0.0, -math.cos(angle)))


def solution(slope, start, seconds=10.0):
    """Solve a differential equation by scipy, to 1e-12."""
    solver = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-12, "dense_output": True}
    return solve_ivp(slope, (0.0, seconds), start, **solver).sol


def kinetic_energy(airspace):
    """Return the kinetic energy of all bodies, J."""
    swarm, total = airspace.swarm, 0.0
    for i, body in enumerate(airspace.airframes):
        total += 0.5 * body.mass * (swarm.velocity[i] ** 2).sum()
        total += 0.5 * (np.array(body.inertia) * swarm.rates[i] ** 2).sum()
    return total


def energy(airspace):
    """Return the kinetic and the potential energy of all bodies, J."""
    masses = [body.mass for body in airspace.airframes]
    return kinetic_energy(airspace) + GRAVITY * float(masses @ airspace.swarm.position[:, 2])


@pytest.mark.parametrize("angle", [0.05, 1.0, 1.5])
def test_pendulum_follows_the_reference_solution(angle):
    airspace = make([ANCHOR + swung(angle)], ball(0.5))
    airspace.attach_cable(0, None, 1.0, other_point=ANCHOR)
    exact = solution(lambda _, y: [y[1], -GRAVITY * math.sin(y[0])], [angle, 0.0])
    for k in range(1, 10 * HZ + 1):
        airspace.step()
        there = airspace.swarm.position[0] - ANCHOR
        assert there == pytest.approx(swung(exact(k / HZ)[0]), abs=2e-7)
        assert abs(np.linalg.norm(there) - 1.0) < 1e-9


@pytest.mark.parametrize("dynamics", BOTH)
def test_double_pendulum_follows_the_reference_solution(dynamics):
    (m1, m2), (l1, l2), start = (0.5, 0.3), (1.0, 0.7), (0.7, -0.4)

    def slope(_, y):
        t1, t2, w1, w2 = y
        total, d = m1 + m2, t1 - t2
        matrix = [[total * l1, m2 * l2 * math.cos(d)], [l1 * math.cos(d), l2]]
        right = [
            -m2 * l2 * w2**2 * math.sin(d) - total * GRAVITY * math.sin(t1),
            l1 * w1**2 * math.sin(d) - GRAVITY * math.sin(t2),
        ]
        return [w1, w2, *np.linalg.solve(matrix, right)]

    upper = ANCHOR + swung(start[0], l1)
    places = [upper, upper + swung(start[1], l2)]
    airspace = make(places, [ball(m1), ball(m2)], dynamics=dynamics)
    airspace.attach_cable(0, None, l1, other_point=ANCHOR)
    airspace.attach_cable(1, 0, l2)
    exact = solution(slope, [*start, 0.0, 0.0])
    for k in range(1, 10 * HZ + 1):
        airspace.step()
        t1, t2, *_ = exact(k / HZ)
        upper = ANCHOR + swung(t1, l1)
        expected = [upper, upper + swung(t2, l2)]
        assert airspace.swarm.position == pytest.approx(np.array(expected), abs=1e-6)


def test_box_below_a_cable_follows_the_reference_solution():
    # The cable ends above the centre of mass: a double pendulum whose second body has an inertia
    length, arm, start = 0.8, 0.25, (0.5, -0.3)
    box = make_load(Obstacle("box", (0.3, 0.1, 0.4)), 0.7, drag_area=(0.0, 0.0))
    mass, inertia = box.mass, box.inertia[1]
    assert inertia == pytest.approx(0.7 * (0.3**2 + 0.4**2) / 12)

    def slope(_, y):
        t1, t2, w1, w2 = y
        d = t1 - t2
        matrix = [
            [mass * length, mass * arm * math.cos(d)],
            [mass * arm * length * math.cos(d), inertia + mass * arm**2],
        ]
        right = [
            -mass * arm * w2**2 * math.sin(d) - mass * GRAVITY * math.sin(t1),
            mass * arm * (length * w1**2 * math.sin(d) - GRAVITY * math.sin(t2)),
        ]
        return [w1, w2, *np.linalg.solve(matrix, right)]

    def place(t1, t2):
        return ANCHOR + swung(t1, length) + swung(t2, arm)

    # A turn about -y by the angle takes the axis -z to the direction of `swung`
    airspace = make([place(*start)], box)
    airspace.place(0, place(*start), from_euler(0.0, -start[1], 0.0))
    airspace.attach_cable(0, None, length, point=(0.0, 0.0, arm), other_point=ANCHOR)
    exact = solution(slope, [*start, 0.0, 0.0])
    for k in range(1, 10 * HZ + 1):
        airspace.step()
        t1, t2, *_ = exact(k / HZ)
        assert airspace.swarm.position[0] == pytest.approx(place(t1, t2), abs=1e-5)
        down = -np.array(to_world(airspace.swarm.quaternion[0], (0.0, 0.0, 1.0)))
        assert down == pytest.approx(swung(t2), abs=1e-4)


def test_tensions_at_rest_are_those_of_statics():
    # Four cables at an angle to the vertical share the weight: T = m g / (4 cos)
    airspace = make([ANCHOR], ball(2.0))
    corners = [(x, y, 1.2) for x in (-0.4, 0.4) for y in (-0.3, 0.3)]
    for corner in corners:
        airspace.attach_cable(0, None, 1.3, other_point=ANCHOR + corner)
    for _ in range(HZ):
        airspace.step()
    assert airspace.swarm.position[0] == pytest.approx(ANCHOR, abs=1e-9)
    assert airspace.cable_tension == pytest.approx(2.0 * GRAVITY / (4 * 1.2 / 1.3), rel=1e-6)


def test_tensions_of_unequal_cables_balance_the_weight():
    airspace = make([ANCHOR], ball(1.0))
    steep, flat = np.array((-0.3, 0.0, 0.4)), np.array((0.8, 0.0, 0.6))
    for end in (steep, flat):
        airspace.attach_cable(0, None, other_point=ANCHOR + end)
    for _ in range(HZ):
        airspace.step()
    directions = np.stack([steep / 0.5, flat], axis=1)[[0, 2]]
    expected = np.linalg.solve(directions, [0.0, GRAVITY])
    assert airspace.cable_tension == pytest.approx(expected, rel=1e-6)


def test_parallel_cables_share_a_load():
    airspace = make([ANCHOR - (0.0, 0.0, 1.0)], ball(1.0))
    for _ in range(3):
        airspace.attach_cable(0, None, other_point=ANCHOR)
    for _ in range(HZ):
        airspace.step()
    assert airspace.cable_tension.sum() == pytest.approx(GRAVITY, rel=1e-6)
    assert airspace.swarm.position[0] == pytest.approx(ANCHOR - (0.0, 0.0, 1.0), abs=1e-9)


@pytest.mark.parametrize("airframe", [ball(0.5), "cf2x"])
def test_tensions_follow_the_gravity_of_the_world(airframe):
    # Eight bodies, so that drones are in SIMD lanes
    places = np.array([(2.0 * i, 0.0, 9.0) for i in range(8)])
    airspace = make(places, airframe)
    for i, place in enumerate(places):
        airspace.attach_cable(i, None, other_point=place + (0.0, 0.0, 1.0))
    airspace.set_condition(gravity=3.71)
    for _ in range(HZ):
        airspace.step()
    weight = airspace.airframes[0].mass * 3.71
    assert airspace.cable_tension == pytest.approx(np.full(8, weight), rel=1e-6)


def test_slack_cable_exerts_nothing():
    free, tied = make([ANCHOR], ball(0.5)), make([ANCHOR], ball(0.5))
    tied.attach_cable(0, None, 2.0, other_point=ANCHOR)
    for airspace in (free, tied):
        airspace.place(0, ANCHOR, velocity=(1.0, 0.5, 1.0))
    for _ in range(HZ // 4):
        free.step()
        tied.step()
        assert np.array_equal(free.swarm.position, tied.swarm.position)
        assert tied.cable_tension[0] == 0.0


def test_energy_never_grows_as_cables_become_taut_and_slack():
    airspace = make([ANCHOR + (0.3, 0.1, 0.0)], ball(0.5))
    airspace.attach_cable(0, None, 1.0, other_point=ANCHOR)
    airspace.place(0, ANCHOR + (0.3, 0.1, 0.0), velocity=(2.0, 0.5, 3.0))
    before, pulls = energy(airspace), []
    first = before
    for _ in range(10 * HZ):
        airspace.step()
        now = energy(airspace)
        assert now <= before + 1e-8
        assert np.linalg.norm(airspace.swarm.position[0] - ANCHOR) <= 1.0 + 1e-9
        pulls.append(airspace.cable_tension[0] > 0.0)
        before = now
    assert np.count_nonzero(np.diff(pulls)) >= 3
    assert before < first - 1.0


def test_jerk_of_a_falling_load_is_inelastic():
    # Two balls: the lower one falls by 0.5 m, then both move at m v / (m + M)
    airspace = make([ANCHOR, ANCHOR - (0.0, 0.0, 0.5)], [ball(0.5), ball(0.3)], gravity=0.0)
    airspace.attach_cable(0, 1, 1.0)
    airspace.place(1, ANCHOR - (0.0, 0.0, 0.5), velocity=(0.0, 0.0, -2.0))
    for _ in range(HZ // 2):
        airspace.step()
    assert airspace.swarm.velocity[:, 2] == pytest.approx(-2.0 * 0.3 / 0.8, abs=1e-9)


def test_momentum_is_conserved_without_gravity():
    box = make_load(Obstacle("box", (0.3, 0.2, 0.1)), 0.4, drag_area=(0.0, 0.0))
    places = [(0.0, 0.0, 10.0), (0.9, 0.0, 10.0), (0.9, 0.8, 10.2)]
    airspace = make(places, [ball(0.5), box, ball(0.3)], gravity=0.0)
    airspace.attach_cable(0, 1, 1.0, other_point=(-0.15, 0.1, 0.05))
    airspace.attach_cable(1, 2, 1.0, point=(0.15, -0.1, 0.0))
    velocities = [(-1.0, 0.5, 0.0), (1.0, 0.2, 0.1), (0.0, 1.0, 0.3)]
    spins = [(0.0, 0.0, 0.0), (1.0, 2.0, 0.3), (0.0, 0.0, 0.0)]
    airspace.place(None, places, velocity=velocities, rates=spins)

    def momenta():
        total = np.zeros(6)
        for i, body in enumerate(airspace.airframes):
            here, moving = airspace.swarm.position[i], airspace.swarm.velocity[i]
            turning = np.array(body.inertia) * airspace.swarm.rates[i]
            total[:3] += body.mass * moving
            total[3:] += np.cross(here - ANCHOR, body.mass * moving)
            total[3:] += to_world(airspace.swarm.quaternion[i], turning)
        return total

    first, before = momenta(), kinetic_energy(airspace)
    for _ in range(5 * HZ):
        airspace.step()
        now = kinetic_energy(airspace)
        assert now <= before + 5e-8
        before = now
    assert momenta() == pytest.approx(first, abs=2e-8)


@pytest.fixture
def team():
    """Eight hovering drones above a beam of 1 kg on the ground, with cables of 1 m."""
    beam = make_load(Obstacle("box", (2.0, 0.1, 0.1)), 1.0)
    ends = [(x, y, 0.05) for x in (-0.9, -0.3, 0.3, 0.9) for y in (-0.05, 0.05)]
    # Neighbours are 0.9 m apart
    above = [(1.5 * x, 9.0 * y, 0.85) for x, y, _ in ends]
    airspace = make([*above, (0.0, 0.0, 0.05)], ["hummingbird"] * 8 + [beam], integral=True)
    hover = airspace.hover_speed
    airspace.place(None, [*above, (0.0, 0.0, 0.05)], rotor_speed=hover)
    for i, end in enumerate(ends):
        airspace.attach_cable(i, 8, 1.0, other_point=end)
        airspace.command(i, SetpointLevel.POSITION, above[i])
    return airspace, np.array(above), np.array(ends)


def longest(airspace, ends):
    """Return the largest excess of the team's cables over their length, m."""
    swarm = airspace.swarm
    places = [swarm.position[8] + to_world(swarm.quaternion[8], end) for end in ends]
    return max(np.linalg.norm(swarm.position[:8] - places, axis=1)) - 1.0


def test_team_lifts_a_beam_carries_it_and_sets_it_down(team):
    airspace, above, ends = team
    for _ in range(HZ):
        airspace.step()
    # The beam rests on the ground until the drones pull
    assert airspace.swarm.position[8, 2] == pytest.approx(0.05, abs=1e-3)
    excess = []

    def fly(shift, seconds):
        for i in range(8):
            airspace.command(i, SetpointLevel.POSITION, above[i] + shift)
        for _ in range(int(seconds * HZ)):
            airspace.step()
            excess.append(longest(airspace, ends))

    fly((0.0, 0.0, 1.0), 6.0)
    beam = airspace.swarm.position[8].copy()
    assert beam[2] > 0.7
    # Vertical components of the tensions balance the weight
    swarm = airspace.swarm
    places = [swarm.position[8] + to_world(swarm.quaternion[8], end) for end in ends]
    steep = (swarm.position[:8] - places)[:, 2]
    assert airspace.cable_tension @ steep == pytest.approx(GRAVITY, rel=0.02)
    fly((1.0, 0.0, 1.0), 6.0)
    assert airspace.swarm.position[8, 0] - beam[0] == pytest.approx(1.0, abs=0.1)
    fly((1.0, 0.0, 0.0), 6.0)
    assert airspace.swarm.position[8] == pytest.approx((1.0, 0.0, 0.05), abs=0.2)
    assert airspace.swarm.velocity[8] == pytest.approx(0.0, abs=0.02)
    assert max(excess) < 1e-3


def test_detached_load_falls_and_rests_on_the_ground():
    parcel = make_load(Obstacle("box", (0.2, 0.2, 0.1), friction=0.5), 0.2)
    airspace = make([(0.0, 0.0, 3.0), (0.0, 0.0, 2.0)], ["hummingbird", parcel], integral=True)
    airspace.place(None, airspace.swarm.position.copy(), rotor_speed=airspace.hover_speed)
    cable = airspace.attach_cable(0, 1, other_point=(0.0, 0.0, 0.05))
    airspace.command(0, SetpointLevel.POSITION, (0.0, 0.0, 3.0))
    for _ in range(2 * HZ):
        airspace.step()
    assert airspace.cable_tension[cable] == pytest.approx(0.2 * GRAVITY, rel=0.05)
    airspace.detach_cable(cable)
    for _ in range(2 * HZ):
        airspace.step()
    assert airspace.swarm.position[1, 2] == pytest.approx(0.05, abs=1e-3)
    assert not airspace.swarm.velocity[1].any()
    assert airspace.swarm.position[0, 2] == pytest.approx(3.0, abs=0.3)
    with pytest.raises(ValueError, match="no cables: attach one"):
        airspace.detach_cable(cable)


@pytest.mark.parametrize("dynamics", BOTH)
def test_load_swings_against_a_building_and_stays_outside(dynamics):
    wall = Obstacle("box", (0.2, 4.0, 4.0))
    start = [ANCHOR + swung(1.0)]
    airspace = make(start, ball(0.5, 0.05), obstacles=[wall], dynamics=dynamics)
    airspace.place_obstacle(0, ANCHOR + (-0.2, 0.0, -1.0))
    airspace.attach_cable(0, None, 1.0, other_point=ANCHOR)
    touched = False
    for _ in range(2 * HZ):
        airspace.step()
        there = airspace.swarm.position[0] - ANCHOR
        assert there[0] >= -0.1 + 0.05 - 1e-4
        assert np.linalg.norm(there) <= 1.0 + 1e-3
        touched = touched or len(airspace.contacts.drone) > 0
    assert touched


def test_compiled_flight_equals_plain_python():
    flown = []
    for debug in (False, True):
        parcel = make_load(Obstacle("box", (0.1, 0.1, 0.1)), 0.1)
        airspace = make([(0.0, 0.0, 2.0), (0.3, 0.0, 1.3)], ["hummingbird", parcel], debug=debug)
        airspace.attach_cable(0, 1, 0.8, point=(0.0, 0.0, -0.05), other_point=(0.0, 0.0, 0.05))
        for _ in range(40):
            airspace.step()
        flown.append([array.copy() for array in (*airspace.swarm, airspace.cable_tension)])
    for compiled, plain in zip(*flown, strict=True):
        assert np.array_equal(compiled, plain)


@pytest.mark.parametrize("dynamics", BOTH)
def test_snapshot_resumes_a_flight_with_cables(dynamics):
    bodies = [ANCHOR, ANCHOR + swung(1.0)], ["hummingbird", ball(0.1)]

    def start():
        airspace = make(*bodies, dynamics=dynamics)
        airspace.attach_cable(0, 1, 1.2)
        return airspace

    airspace, another = start(), start()
    for _ in range(60):
        airspace.step()
    saved, digest = airspace.save_state(), airspace.state_hash()
    for _ in range(60):
        airspace.step()
    later = airspace.state_hash()
    assert later != digest
    for copy in (airspace, another):
        copy.load_state(saved)
        assert copy.state_hash() == digest
        for _ in range(60):
            copy.step()
        assert copy.state_hash() == later
    # A snapshot also restores which cables are attached
    airspace.detach_cable(0)
    assert airspace.state_hash() != later
    airspace.load_state(saved)
    for _ in range(60):
        airspace.step()
    assert airspace.state_hash() == later
    with pytest.raises(ValueError, match="cable"):
        make(*bodies, dynamics=dynamics).load_state(saved)


def test_groups_fly_alone_as_together():
    # Two pairs far from each other, in one airspace and in one of their own
    def pairs(centres):
        places = list(itertools.chain(*[(c + ANCHOR, c + ANCHOR + swung(0.5)) for c in centres]))
        airspace = make(places, [ball(0.4), ball(0.2)] * len(centres))
        for k, centre in enumerate(centres):
            airspace.attach_cable(2 * k, None, 1.0, other_point=centre + ANCHOR + (0.0, 0.0, 1.0))
            airspace.attach_cable(2 * k + 1, 2 * k, 1.0)
        for _ in range(HZ // 2):
            airspace.step()
        return airspace.swarm.position

    near, far = np.zeros(3), np.array((50.0, 0.0, 0.0))
    together = pairs([near, far])
    assert np.array_equal(together[:2], pairs([near]))
    assert np.array_equal(together[2:], pairs([far]))


def test_placing_bodies_respects_cables():
    airspace = make([ANCHOR, ANCHOR - (0.0, 0.0, 1.0)], [ball(0.4), ball(0.2)])
    airspace.attach_cable(0, 1, 1.0)
    with pytest.raises(ValueError, match="place the bodies"):
        airspace.place(0, ANCHOR + (0.0, 0.0, 0.5))
    assert airspace.swarm.position[0] == pytest.approx(ANCHOR)
    airspace.place([0, 1], [ANCHOR + (5.0, 0.0, 0.0), ANCHOR + (5.0, 0.0, -0.5)])
    airspace.step()
    assert airspace.cable_tension[0] == 0.0


def test_entries_of_detached_cables_are_used_again():
    airspace = make([ANCHOR, ANCHOR - (0.0, 0.0, 1.0)], [ball(0.4), ball(0.2)])
    cables = [airspace.attach_cable(0, 1, length) for length in (1.0, 1.5)]
    assert cables == [0, 1]
    airspace.detach_cable(0)
    with pytest.raises(ValueError, match="cable 0 is detached"):
        airspace.detach_cable(0)
    assert airspace.attach_cable(1, None, 3.0, other_point=ANCHOR) == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0, 0, 1.0), "both ends of a cable"),
        ((5, 1, 1.0), "body of a cable"),
        ((0, 1, 0.5), "1 m apart"),
        ((0, 1, -1.0), "length is -1 m"),
        ((0, 1, math.nan), "length"),
    ],
)
def test_invalid_cables_raise_errors(arguments, message):
    airspace = make([ANCHOR, ANCHOR - (0.0, 0.0, 1.0)], [ball(0.4), ball(0.2)])
    before = airspace.state_hash()
    with pytest.raises(ValueError, match=message):
        airspace.attach_cable(*arguments)
    assert airspace.state_hash() == before


def test_recording_of_a_carried_load_can_be_verified(tmp_path):
    parcel = make_load(Obstacle("box", (0.1, 0.1, 0.1), friction=0.3), 0.1)
    airspace = make([(0.0, 0.0, 2.0), (0.3, 0.0, 1.3)], ["hummingbird", parcel])
    recorder = AirspaceRecorder(airspace)
    airspace.attach_cable(0, 1, 0.8, other_point=(0.0, 0.0, 0.05))
    for _ in range(20):
        airspace.step()
    recorder.save(tmp_path)
    assert all(check.same for check in Verifier().verify(tmp_path))


def test_pictures_show_loads_and_cables():
    airspace = make([(0.0, 0.0, 2.0), (0.0, 0.0, 1.0)], ["hummingbird", ball(0.1, 0.3)])
    without = airspace.render()
    airspace.attach_cable(0, 1, other_point=(0.0, 0.0, 0.3))
    drawn = (airspace.render() != without).any(axis=-1)
    assert drawn.any()
    shot = airspace.picture(position=(3.0, 0.0, 1.0), target=(0.0, 0.0, 1.0))
    red, _, blue = shot.pixels[240, 320].tolist()
    assert red > blue + 30  # brown


def test_loads_have_the_inertia_and_drag_of_their_shape():
    # Homogeneous solids: box m (b^2 + c^2) / 12, sphere 2 m r^2 / 5, cylinder m r^2 / 2 about z
    box = make_load(Obstacle("box", (2.0, 0.5, 0.2)), 1.2)
    assert box.inertia == pytest.approx((0.029, 0.404, 0.425))
    assert box.body_drag == pytest.approx((1.05 * 0.25, 1.05))
    assert ball(0.5, 0.1).inertia == pytest.approx((0.002,) * 3)
    barrel = make_load(Obstacle("cylinder", (0.2, 0.6)), 3.0)
    assert barrel.inertia == pytest.approx((0.12, 0.12, 0.06))
    assert barrel.body_drag == pytest.approx((1.1 * 0.24, 0.82 * math.pi * 0.04))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"mass": 0.0}, "mass of a load is 0"),
        ({"mass": 1.0, "inertia": (1.0, 0.0, 1.0)}, "inertia of a load"),
        ({"mass": 1.0, "inertia": (1.0, 1.0, 5.0)}, "above the sum of the others"),
        ({"mass": 1.0, "drag_area": (1.0,)}, "drag_area"),
    ],
)
def test_invalid_loads_raise_errors(arguments, message):
    with pytest.raises(ValueError, match=message):
        make_load(Obstacle("sphere", (0.1,)), **arguments)


def test_loads_need_a_shape():
    with pytest.raises(ValueError, match=r"shape of a load is 'box': an Obstacle is needed"):
        make_load("box", mass=1.0)


def test_tasks_refuse_loads():
    with pytest.raises(ValueError, match="only an Airspace has loads"):
        Aviary("hover", airframe=ball(0.1))


def test_other_dynamics_refuse_cables_and_loads():
    places = [ANCHOR, (2.0, 0.0, 5.0)]
    airspace = Airspace(places, dynamics="point_mass")
    with pytest.raises(ValueError, match="use dynamics 'rigid_body' or 'bullet'"):
        airspace.attach_cable(0, 1)
    with pytest.raises(ValueError, match="there is a load: use dynamics 'rigid_body'"):
        Airspace(places, ["cf2x", ball(0.1)], dynamics="point_mass")
    with pytest.raises(ValueError, match="there is a load: use contacts 'impulse'"):
        Airspace(places, ["cf2x", ball(0.1)], dynamics="bullet", contacts="bullet")


def test_loads_cannot_be_commanded(team):
    airspace, above, _ = team
    held = airspace.setpoint[8].copy()
    for drones in (8, [0, 8], np.arange(9) == 8):
        with pytest.raises(ValueError, match=r"\[8\] are loads, .* command drones only"):
            airspace.command(drones, SetpointLevel.POSITION, (0.0, 0.0, 1.0))
    airspace.command(None, SetpointLevel.POSITION, above)
    np.testing.assert_array_equal(airspace.setpoint[:8, :3], above)
    airspace.stop()
    assert not airspace.setpoint[:8].any()
    np.testing.assert_array_equal(airspace.setpoint[8], held)
