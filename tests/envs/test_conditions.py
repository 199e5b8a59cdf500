"""Conditions in flight: weak rotors, added mass and inertia, batteries and wind."""

import dataclasses
import json

import numpy as np
import pytest

import bulletuav
from bulletuav import Airspace, SetpointLevel
from bulletuav.analysis.airspace_recorder import fly_calls
from bulletuav.cli import main
from bulletuav.envs.events import Event, as_events
from bulletuav.vehicle.airframe import STANDARD_GRAVITY as G
from bulletuav.vehicle.airframes import load_airframe

CF2X = load_airframe("cf2x")
HOVER = CF2X.hover_speed()
SIX = ("bullet", "rigid_body")
"""Dynamics of six degrees of freedom"""
ANGLES = np.arange(8) * np.pi / 4
OCTO = dataclasses.replace(
    CF2X,
    rotors=tuple(
        (0.04 * np.cos(a), 0.04 * np.sin(a), 1 if k % 2 else -1) for k, a in enumerate(ANGLES)
    ),
    thrust_coefficient=CF2X.thrust_coefficient / 2,
)
"""A drone of eight rotors"""
LOSS = {"time": (0.3, 0.9), "drone": "random", "rotor_effectiveness": (0.6, 1.0, 1.0, 1.0)}
PARCEL = {"time": 0.5, "drone": 0, "added_mass": 0.005, "added_inertia": (2e-6, 2e-6, 1e-6)}


def steps(airspace, count):
    for _ in range(count):
        airspace.step()
    return airspace


def hovering(dynamics, **options):
    """Return an airspace with a drone that holds its position."""
    given = {"decision_hz": 48, "rotor_speed": "hover", **options}
    airspace = Airspace([(0.0, 0.0, 5.0)], dynamics=dynamics, **given)
    airspace.command(0, SetpointLevel.POSITION, (0.0, 0.0, 5.0, 0.0))
    return airspace


@pytest.mark.parametrize("dynamics", SIX)
def test_a_weak_rotor_turns_the_drone_by_newton_and_euler(dynamics):
    airspace = Airspace([(0.0, 0.0, 5.0)], dynamics=dynamics, effects=(), rotor_speed="hover")
    airspace.command(0, SetpointLevel.ROTOR, np.full(4, HOVER))
    airspace.set_condition(0, rotor_effectiveness=(0.25, 1.0, 1.0, 1.0))
    airspace.step()
    # Without lag the rotor loses three quarters of its thrust in the first substep
    lost = 0.75 * CF2X.mass * G / 4
    x, y, turn = CF2X.rotors[0]
    torque = (-y * lost, x * lost, -turn * CF2X.torque_ratio * lost)
    rates = np.array(torque) / CF2X.inertia / 240
    assert airspace.swarm.rates[0] == pytest.approx(rates, rel=1e-3)
    # The drone tilts during the substep by less than 0.002 rad
    assert airspace.swarm.velocity[0, 2] == pytest.approx(-lost / CF2X.mass / 240, rel=1e-4)
    assert airspace.swarm.rotor_speed[0] == pytest.approx(HOVER * np.array([0.5, 1, 1, 1]))


@pytest.mark.parametrize("dynamics", SIX)
def test_a_failed_rotor_spins_down_with_the_lag_of_its_motor(dynamics):
    airspace = Airspace([(0.0, 0.0, 5.0)], dynamics=dynamics, rotor_speed="hover")
    airspace.command(0, SetpointLevel.ROTOR, np.full(4, HOVER))
    airspace.set_condition(0, rotor_effectiveness=(1.0, 0.0, 1.0, 1.0))
    steps(airspace, 6)
    left = np.exp(-6 / 240 / CF2X.lag_down)
    assert airspace.swarm.rotor_speed[0] == pytest.approx(HOVER * np.array([1, left, 1, 1]))


@pytest.mark.parametrize("dynamics", SIX)
def test_free_fall_does_not_depend_on_added_mass(dynamics):
    places = [(0.0, 0.0, 50.0), (20.0, 0.0, 50.0)]
    airspace = Airspace(places, dynamics=dynamics, effects=())
    airspace.set_condition(0, added_mass=0.02, added_inertia=(1e-5, 1e-5, 1e-5))
    steps(airspace, 48)
    assert airspace.swarm.velocity[:, 2] == pytest.approx(-G * 48 / 240, rel=1e-6)


@pytest.mark.parametrize("dynamics", SIX)
def test_thrust_in_hover_grows_by_the_added_weight(dynamics):
    airspace = hovering(dynamics, effects=("lag",))
    airspace.set_condition(0, added_mass=0.006)
    steps(airspace, 48 * 6)
    thrust = CF2X.thrust_coefficient * (airspace.swarm.rotor_speed[0] ** 2).sum()
    assert thrust == pytest.approx((CF2X.mass + 0.006) * G, rel=1e-3)
    # After the parcel is dropped, the drone starts to climb at 6 / 27 g
    airspace.set_condition(None, added_mass=0.0)
    airspace.command(0, SetpointLevel.ROTOR, airspace.swarm.rotor_speed[0])
    before = airspace.swarm.velocity[0, 2]
    airspace.step()
    climb = airspace.swarm.velocity[0, 2] - before
    assert climb == pytest.approx(0.006 / CF2X.mass * G / 48, rel=2e-3)


@pytest.mark.parametrize("dynamics", SIX)
def test_added_inertia_slows_turns(dynamics):
    airspace = Airspace([(0.0, 0.0, 5.0)], dynamics=dynamics, effects=())
    airspace.set_condition(0, added_inertia=CF2X.inertia)
    airspace.apply(0, torque=(1e-5, 2e-5, 3e-5))
    airspace.step()
    expected = np.array([1e-5, 2e-5, 3e-5]) / (2 * np.array(CF2X.inertia)) / 240
    assert airspace.swarm.rates[0] == pytest.approx(expected, rel=1e-5)


def test_points_have_mass_only():
    places = [(0.0, 0.0, 5.0), (5.0, 0.0, 5.0)]
    airspace = Airspace(places, dynamics="point_mass", effects=())
    airspace.set_condition(0, added_mass=CF2X.mass)
    airspace.apply(None, force=(0.001, 0.0, 0.0))
    airspace.step()
    heavy, light = airspace.swarm.velocity[:, 0]
    assert heavy == pytest.approx(light / 2)
    with pytest.raises(ValueError, match="ignores it: use dynamics 'rigid_body' or 'bullet'"):
        airspace.set_condition(0, rotor_effectiveness=(1.0, 1.0, 1.0, 0.0))
    with pytest.raises(ValueError, match="has no rotors"):
        airspace.rotor_commands()


def test_both_dynamics_fly_the_same_with_conditions():
    after = []
    for dynamics in SIX:
        airspace = hovering(dynamics, physics_hz=960)
        weights = {"added_mass": 0.004, "added_inertia": (5e-6, 5e-6, 5e-6)}
        airspace.set_condition(0, rotor_effectiveness=(0.9, 1, 1, 1), **weights)
        steps(airspace, 96)
        after.append(airspace.swarm.position[0].copy())
    assert np.linalg.norm(after[0] - (0, 0, 5)) > 0.5
    assert after[0] == pytest.approx(after[1], abs=1e-6)


@pytest.mark.parametrize("dynamics", SIX)
def test_snapshots_keep_conditions_to_the_bit(dynamics):
    airspace, other = hovering(dynamics), hovering(dynamics)
    healthy, fresh = airspace.save_state(), airspace.state_hash()
    airspace.set_condition(0, rotor_effectiveness=(0.7, 1, 0.9, 1), added_mass=0.005)
    assert airspace.state_hash() != fresh
    steps(airspace, 5)
    weak = airspace.save_state()
    end = steps(airspace, 10).state_hash()
    other.load_state(weak)
    assert other.rotor_effectiveness[0] == pytest.approx([0.7, 1, 0.9, 1])
    assert steps(other, 10).state_hash() == end
    # Loading the healthy state removes the conditions
    other.load_state(healthy)
    assert other.state_hash() == fresh
    untouched = hovering(dynamics)
    untouched.load_state(healthy)
    assert steps(other, 10).state_hash() == steps(untouched, 10).state_hash()


def test_own_allocation_keeps_a_drone_with_a_failed_rotor_in_place():
    x, y, turn = np.array(OCTO.rotors).T
    mixer = np.array([np.ones(8), y, -x, OCTO.torque_ratio * turn])
    distances = []
    for own in (False, True):
        airspace = Airspace(
            [(0.0, 0.0, 5.0)], OCTO, dynamics="rigid_body", decision_hz=240, rotor_speed="hover"
        )
        airspace.set_condition(0, rotor_effectiveness=(0, 1, 1, 1, 1, 1, 1, 1))
        inverse = np.linalg.pinv(mixer * airspace.rotor_effectiveness[0])
        for _ in range(480):
            airspace.command(0, SetpointLevel.POSITION, (0.0, 0.0, 5.0, 0.0))
            if own:
                demand = mixer @ airspace.rotor_commands()[0] ** 2
                squares = np.clip(inverse @ demand, 0.0, OCTO.max_rotor_speed**2)
                airspace.command(0, SetpointLevel.ROTOR, np.sqrt(squares))
            airspace.step()
        distances.append(np.linalg.norm(airspace.swarm.position[0] - (0, 0, 5)))
    assert distances[0] > 0.1
    assert distances[1] < 0.02


@pytest.mark.parametrize("controller", ["lee", "pid"])
def test_commands_of_rotors_are_those_of_the_next_substep(controller):
    effects = ("drag",)
    airspace = Airspace(
        [(0.0, 0.0, 5.0), (3.0, 0.0, 5.0)],
        dynamics="rigid_body",
        effects=effects,
        controller=controller,
        rotor_speed="hover",
    )
    airspace.command(None, SetpointLevel.POSITION, (0.5, 0.2, 5.1, 0.0))
    for _ in range(5):
        commands = airspace.rotor_commands()
        # Without lag, rotors turn as commanded
        airspace.step()
        assert (airspace.swarm.rotor_speed == commands).all()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "no condition is given: set at least one of rotor_effectiveness"),
        ({"rotor_effectiveness": (1, 1, 1)}, r"has shape \(3,\): \(4,\) is needed"),
        ({"rotor_effectiveness": (1, 1, 1, 1.5)}, r"from 0 \(failed\) to 1"),
        ({"rotor_effectiveness": (1, 1, 1, np.nan)}, "rotor_effectiveness is"),
        ({"added_mass": -0.026}, "0.037 times that of its airframe: from 0.1 to 10 times"),
        ({"added_mass": np.inf}, "added_mass is"),
        ({"added_mass": (1.0, 2.0, 3.0)}, "added_mass has shape"),
        ({"added_inertia": (1.0, 1.0, 1.0)}, "times that of its airframe"),
        ({"added_inertia": 1e-6}, "added_inertia has shape"),
    ],
)
def test_conditions_that_cannot_be_are_refused_and_change_nothing(given, message):
    airspace = hovering("rigid_body")
    before = airspace.state_hash()
    with pytest.raises(ValueError, match=message):
        airspace.set_condition(0, **given)
    assert airspace.state_hash() == before


def test_a_recorded_airspace_with_conditions_flies_again_to_the_bit(tmp_path):
    airspace = Airspace([(0.0, 0.0, 5.0)], dynamics="rigid_body", decision_hz=48)
    with bulletuav.AirspaceRecorder(airspace) as recorder:
        airspace.command(0, "position", (0.0, 0.0, 5.0))
        airspace.set_condition(0, rotor_effectiveness=np.array([0.9, 1, 1, 1]), added_mass=0.003)
        steps(airspace, 10)
    recorder.save(tmp_path)
    again = fly_calls(tmp_path / "calls.json", 10**3, trust=False)
    assert (again.position == recorder.recording().position).all()


# Events of tasks


def aviary_of(events=(), num_worlds=1, **options):
    given = {"num_drones": 3, "airframe": "cf2x", "dynamics": "rigid_body", "decision_hz": 10}
    return bulletuav.Aviary(
        "crossing", num_worlds=num_worlds, events=events, **{**given, **options}
    )


def flown(aviary, count, seeds=0):
    """Return hashes after the reset and after each decision under zero actions."""
    aviary.reset(seeds=seeds)
    hashes = [aviary.state_hash()]
    for _ in range(count):
        aviary.step(np.zeros_like(aviary.action.low + np.zeros((aviary.num_worlds, 3, 1))))
        hashes.append(aviary.state_hash())
    return hashes


def test_events_happen_at_their_time_and_end_with_the_episode():
    aviary = aviary_of([PARCEL])
    flown(aviary, 5)
    assert (aviary.parameters["mass"] == CF2X.mass).all()
    action = np.zeros((1, 3, aviary.action.low.shape[-1]))
    aviary.step(action)  # that begins at 0.5 s
    assert aviary.parameters["mass"][0] == pytest.approx(CF2X.mass + np.array([0.005, 0, 0]))
    assert aviary.parameters["inertia"][0, 0] == pytest.approx(
        np.array(CF2X.inertia) + (2e-6, 2e-6, 1e-6)
    )
    aviary.reset(seeds=1)
    assert (aviary.parameters["mass"] == CF2X.mass).all()
    assert (aviary.parameters["inertia"] == CF2X.inertia).all()


def test_events_draw_after_everything_else_and_the_same_for_the_same_seed():
    plain, eventful, again = aviary_of(), aviary_of([LOSS]), aviary_of([LOSS])
    for seed in (0, 1):
        plain.reset(seeds=seed)
        eventful.reset(seeds=seed)
        assert (plain.swarm.position == eventful.swarm.position).all()
    assert flown(eventful, 12, 5) == flown(again, 12, 5)
    schedules = set()
    for seed in range(8):
        eventful.reset(seeds=seed)
        schedule = eventful.worlds.schedule
        assert 0.3 <= schedule.time[0, 0] <= 0.9
        schedules.add((float(schedule.time[0, 0]), int(schedule.drone[0, 0])))
    assert len({time for time, _ in schedules}) == 8
    assert {drone for _, drone in schedules} == {0, 1, 2}


def test_worlds_of_a_batch_have_the_events_of_their_own_seeds():
    batch = aviary_of([LOSS, PARCEL], num_worlds=3)
    together = flown(batch, 12, [4, 5, 6])
    for w in range(3):
        alone = flown(aviary_of([LOSS, PARCEL]), 12, 4 + w)
        assert [one[w] for one in together] == [one[0] for one in alone]


@pytest.mark.parametrize("dynamics", SIX)
def test_a_snapshot_before_and_after_events_continues_to_the_bit(dynamics):
    events = [LOSS, PARCEL]
    aviary, other = aviary_of(events, dynamics=dynamics), aviary_of(events, dynamics=dynamics)
    action = np.zeros((1, 3, aviary.action.low.shape[-1]))
    flown(aviary, 3)
    saved = [aviary.save_state()]
    for _ in range(8):
        aviary.step(action)
    saved.append(aviary.save_state())
    middle = aviary.state_hash()
    for _ in range(4):
        aviary.step(action)
    end = aviary.state_hash()
    other.load_state(saved[1])
    assert other.state_hash() == middle
    for _ in range(4):
        other.step(action)
    assert other.state_hash() == end


def test_another_battery_and_another_wind():
    swap = Event(time=0.2, drone=1, charge=1.0)
    low = Event(time=0.0, charge=0.5)
    aviary = aviary_of([low, swap, Event(time=0.3, wind=(2, 0, 0))], battery_capacity=1.0)
    action = np.zeros((1, 3, aviary.action.low.shape[-1]))
    aviary.reset(seeds=0)
    charge = aviary.worlds.energy.readings()["charge"]
    aviary.step(action)
    assert charge[0] == pytest.approx([0.5] * 3, abs=0.01)
    aviary.step(action)
    aviary.step(action)
    assert charge[0] == pytest.approx([0.5, 1.0, 0.5], abs=0.01)
    assert (aviary.worlds.wind.steady == 0).all()
    aviary.step(action)
    assert aviary.worlds.wind.steady.tolist() == [[2.0, 0.0, 0.0]]
    assert (aviary.worlds.state.wind == (2.0, 0.0, 0.0)).all()
    aviary.reset(seeds=1)
    assert (charge == 1.0).all()
    assert (aviary.worlds.wind.steady == 0).all()


def test_added_mass_adds_to_a_drawn_one():
    aviary = aviary_of([PARCEL], randomization={"mass": (1.1, 1.3)})
    flown(aviary, 1)
    drawn = aviary.parameters["mass"][0].copy()
    action = np.zeros((1, 3, aviary.action.low.shape[-1]))
    for _ in range(5):
        aviary.step(action)
    assert aviary.parameters["mass"][0] == pytest.approx(drawn + (0.005, 0, 0))


def test_a_run_with_events_is_recorded_and_verified(tmp_path):
    events = json.dumps([PARCEL, LOSS])
    flight = ["fly", "crossing", "--drones", "2", "--dynamics", "rigid_body", "--horizon", "12"]
    own = ["--policy", "straight", "--animation", "none", "--set", f"events={events}"]
    main([*flight, *own, "--out", str(tmp_path)])
    run = json.loads((tmp_path / "run.json").read_text())
    assert run["options"]["events"][0] == {**PARCEL, "added_inertia": [2e-6, 2e-6, 1e-6]}
    main(["verify", str(tmp_path)])


@pytest.mark.parametrize(
    ("events", "message"),
    [
        ([{"time": 1.0}], "changes nothing: give one of rotor_effectiveness"),
        ([{"added_mass": 0.01}], "lacks a time"),
        ([{"time": -1.0, "added_mass": 0.01}], "seconds since the start"),
        ([{"time": (3.0, 2.0), "added_mass": 0.01}], "seconds since the start"),
        ([{"time": 1.0, "mas": 0.01}], "added_mass"),
        ([{"time": 1.0, "drone": 3, "added_mass": 0.01}], "drone of an event is 3: from 0 to 2"),
        ([{"time": 1.0, "drone": "any", "added_mass": 0.01}], "random"),
        ([{"time": 1.0, "drone": 0, "wind": (1, 0, 0)}], "leave out drone"),
        ([{"time": 1e4, "added_mass": 0.01}], "time of an event is 10000.* lower it, or raise hor"),
        ([{"time": 1.0, "wind": (1, 0, 1000)}], "from -100 to 100 m/s"),
        ([{"time": 1.0, "charge": 0.5}], "set battery_capacity"),
        ([{"time": 1.0, "charge": 1.5}], "charge of an event is"),
        ([{"time": 1.0, "added_mass": 1.0}], "from 0.1 to 10 times"),
        ([{"time": 1.0, "rotor_effectiveness": (1, 1, 1)}], r"\(4,\) is needed"),
        ([{"time": 1.0, "added_inertia": (1.0, 1.0)}], r"has shape \(2,\): \(3,\) is needed"),
        (5, "a list or tuple is needed"),
        ([5], "one of events is 5: Event, or a dict of time, drone"),
    ],
)
def test_events_that_cannot_be_are_refused(events, message):
    with pytest.raises(ValueError, match=message):
        aviary_of(events)


def test_dynamics_that_ignore_an_event_refuse_it():
    for event, dynamics in (
        ({"time": 1.0, "rotor_effectiveness": (1, 1, 1, 0)}, "point_mass"),
        ({"time": 1.0, "added_inertia": (0, 0, 0)}, "point_mass"),
        ({"time": 1.0, "added_mass": 0.0}, "double_integrator"),
        ({"time": 1.0, "wind": (1, 0, 0)}, "single_integrator"),
    ):
        with pytest.raises(ValueError, match="ignores"):
            aviary_of([event], dynamics=dynamics)


def test_one_event_needs_no_list():
    assert as_events(PARCEL) == as_events([Event(**PARCEL)])
    assert as_events(Event(time=(2.0, 2.0), added_mass=0.01)) == (Event(2.0, added_mass=0.01),)


def test_random_drones_of_events_are_among_those_that_take_part():
    event = {"time": 0.0, "drone": "random", "added_mass": 0.01}
    aviary = bulletuav.Aviary(
        "crossing", 32, num_drones=(2, 8), dynamics="rigid_body", events=[event]
    )
    aviary.reset(seeds=0)
    drawn = aviary.worlds.schedule.drone[:, 0]
    assert aviary.worlds.members[np.arange(32), drawn].all()
    assert len(set(drawn.tolist())) > 3
    aviary.close()
