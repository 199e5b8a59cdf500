"""Changes of drones and wind in flight by callers of tasks: `set_condition`."""

import json

import numpy as np
import pytest

import bulletuav
from bulletuav.adapters.self_play import team_env
from bulletuav.analysis.recorder import Recorder
from bulletuav.analysis.recording import save
from bulletuav.cli import main
from bulletuav.envs.curriculum import curriculum_env
from bulletuav.envs.events import MAX_EVENTS, Event
from bulletuav.envs.gymnasium import CentralAviary, CentralVectorAviary
from bulletuav.envs.parallel import aec_env
from bulletuav.envs.workers import batch_env
from bulletuav.policies import find_policy
from bulletuav.vehicle.airframes import load_airframe

CF2X = load_airframe("cf2x")
OPTIONS = {"num_drones": 3, "airframe": "cf2x", "dynamics": "rigid_body", "decision_hz": 10}
WEAK = (0.6, 1.0, 1.0, 1.0)


def aviary_of(num_worlds=1, **options):
    return bulletuav.Aviary("crossing", num_worlds, **{**OPTIONS, **options})


def fly(aviary, count):
    for _ in range(count):
        aviary.step(np.zeros(aviary.given.shape))
    return aviary.state_hash()


@pytest.mark.parametrize("dynamics", ["rigid_body", "bullet"])
def test_a_change_equals_the_event_of_that_time_to_the_bit(dynamics):
    events = [
        Event(time=0.3, drone=1, added_mass=0.004, added_inertia=(1e-6, 2e-6, 3e-6)),
        Event(time=0.5, drone=2, rotor_effectiveness=WEAK),
        Event(time=0.5, wind=(1.0, 2.0, 0.0), charge=0.5),
    ]
    given = {"dynamics": dynamics, "battery_capacity": 1.0, "energy": "actuator"}
    scheduled, called = aviary_of(events=events, **given), aviary_of(**given)
    scheduled.reset(seeds=3)
    called.reset(seeds=3)
    fly(scheduled, 9)
    fly(called, 3)
    called.set_condition(1, **events[0].values())
    fly(called, 2)
    called.set_condition(2, rotor_effectiveness=WEAK)
    called.set_condition(wind=(1.0, 2.0, 0.0), charge=0.5)
    fly(called, 4)
    for one, other in zip(scheduled.swarm, called.swarm, strict=True):
        assert (one == other).all()
    assert (scheduled.readings["charge"] == called.readings["charge"]).all()


def test_changes_end_with_the_episode_and_draw_no_random_numbers():
    changed, plain = aviary_of(2, seed=5), aviary_of(2, seed=5)
    for aviary in (changed, plain):
        aviary.reset()
    changed.set_condition(None, 1, added_mass=0.005, rotor_effectiveness=WEAK, wind=(3, 0, 0))
    assert (changed.parameters["mass"][0] == CF2X.mass).all()
    assert changed.parameters["mass"][1] == pytest.approx(CF2X.mass + 0.005)
    assert changed.worlds.wind.steady.tolist() == [[0, 0, 0], [3, 0, 0]]
    after = fly(changed, 4)
    assert after[0] == fly(plain, 4)[0]
    assert after[1] != plain.state_hash()[1]
    for aviary in (changed, plain):
        aviary.reset(np.array([False, True]))
    assert changed.state_hash() == plain.state_hash()
    assert fly(changed, 4) == fly(plain, 4)


def test_snapshots_keep_changes_and_a_reset_undoes_them():
    aviary, other = aviary_of(), aviary_of()
    aviary.reset(seeds=1)
    aviary.set_condition([0, 2], added_mass=0.003, rotor_effectiveness=WEAK, wind=(1, 0, 0))
    fly(aviary, 2)
    saved = aviary.save_state()
    end = fly(aviary, 3)
    other.load_state(saved)
    assert other.parameters["mass"][0] == pytest.approx(CF2X.mass + np.array([0.003, 0, 0.003]))
    assert fly(other, 3) == end
    other.reset(seeds=1)
    fresh = aviary_of()
    fresh.reset(seeds=1)
    assert fly(other, 3) == fly(fresh, 3)


def test_all_environments_change_the_same_drone():
    def mass_of(aviary):
        return aviary.parameters["mass"][-1] - CF2X.mass

    change = {"added_mass": 0.004}
    expected = pytest.approx([0.0, 0.004, 0.0])
    by_name = [
        bulletuav.parallel_env("crossing", **OPTIONS),
        aec_env("crossing", **OPTIONS),
        curriculum_env("crossing", **OPTIONS),
    ]
    for env in by_name:
        env.reset(seed=0)
        env.set_condition("drone_1", **change)
        inner = env.unwrapped if hasattr(env, "env") else env
        aviary = getattr(env, "_parallel", getattr(inner, "env", inner)).aviary
        assert mass_of(aviary) == expected
        with pytest.raises(ValueError, match="unknown agent 'drone_7'"):
            env.set_condition("drone_7", **change)
        env.set_condition(["drone_1", "drone_2"], added_mass=0.0)
        env.set_condition(**change)
        assert mass_of(aviary) == pytest.approx([0.004] * 3)
        env.close()
    central = CentralAviary("crossing", **OPTIONS)
    central.reset(seed=0)
    central.set_condition(1, **change)
    assert mass_of(central.aviary) == expected
    for env in (batch_env("crossing", 2, **OPTIONS), CentralVectorAviary("crossing", 2, **OPTIONS)):
        env.reset(seed=0)
        env.set_condition(1, 1, **change)
        assert mass_of(env.aviary) == expected
        assert (env.aviary.parameters["mass"][0] == CF2X.mass).all()
        env.close()


@pytest.mark.parametrize("central", [False, True])
def test_a_team_changes_drones_of_all_teams(central):
    options = {"dynamics": "rigid_body", "airframe": "cf2x", "central": central}
    env = team_env("pursuit_evasion", "chasers", "straight", **options)
    env.reset(seed=0)
    parallel = env.env if not central else env.env.env
    env.set_condition(parallel.possible_agents[-1], added_mass=0.004)
    assert parallel.aviary.parameters["mass"][0, -1] == pytest.approx(CF2X.mass + 0.004)
    env.close()


def test_several_processes_have_the_same_bits():
    one, several = (batch_env("crossing", 3, workers=w, seed=4, **OPTIONS) for w in (1, 2))
    for env in (one, several):
        env.reset()
        env.set_condition(1, [0, 2], added_mass=0.004)
        env.set_condition(worlds=2, wind=(2.0, 0.0, 0.0))
        for _ in range(3):
            env.step(np.zeros(env.aviary.given.shape if env is one else (3, 3, 3)))
    assert one.state_hash() == several.state_hash()
    with pytest.raises(ValueError, match="unknown condition 'mass'"):
        several.set_condition(1, mass=0.004)
    with pytest.raises(ValueError, match="drones is 3"):
        several.set_condition(3, added_mass=0.004)
    one.set_condition(1, 0, added_mass=0.0)
    several.set_condition(1, 0, added_mass=0.0)
    assert one.state_hash() == several.state_hash()
    one.close()
    several.close()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "changes nothing: give one of"),
        ({"mass": 0.1}, "unknown condition 'mass'"),
        ({"drones": 3, "added_mass": 0.001}, "drones is 3"),
        ({"worlds": 2, "added_mass": 0.001}, "2"),
        ({"added_mass": -0.03}, "from 0.1 to 10 times"),
        ({"added_mass": "1 g"}, "added_mass of an event"),
        ({"charge": 0.5}, "set battery_capacity"),
        ({"drones": 0, "wind": (1, 0, 0)}, "leave out drone"),
        ({"rotor_effectiveness": (1, 1, 1)}, r"\(4,\) is needed"),
    ],
)
def test_invalid_changes_are_refused_and_change_nothing(given, message):
    aviary = aviary_of(2)
    with pytest.raises(RuntimeError, match="reset"):
        aviary.set_condition(added_mass=0.001)
    aviary.reset(seeds=0)
    before = aviary.state_hash()
    with pytest.raises(ValueError, match=message):
        aviary.set_condition(**given)
    assert aviary.state_hash() == before
    assert aviary.worlds.schedule.log == [[], []]


def recorded(aviary, change):
    """Fly and record an episode of the policy "straight", with changes by decision."""
    policy = find_policy("straight", "crossing")(aviary)
    observations = aviary.reset(seeds=7)
    policy.reset(np.ones(1, dtype=bool))
    recorder = Recorder(aviary)
    for k in range(aviary.options.horizon):
        change(k)
        actions = policy.act(observations, aviary.swarm)
        step = aviary.step(actions)
        observations = step.observations
        recorder.record(actions, step.rewards, step.info)
        if not aviary.alive.any():
            break
    return recorder.recording()


def test_a_recording_with_changes_is_verified(tmp_path):
    events = [Event(time=0.45, drone=1, added_mass=0.005), Event(time=0.8, drone=0, added_mass=0.0)]
    aviary = aviary_of(horizon=12, events=events)

    def change(k):
        # After the event that is due at the same decision
        if k == 5:
            aviary.set_condition([1, 2], added_mass=0.002, rotor_effectiveness=WEAK)
        if k == 8:
            aviary.set_condition(wind=(2.0, 0.0, 0.0), added_mass=0.001)

    recording = recorded(aviary, change)
    save(recording, aviary, "straight", 7, tmp_path)
    run = json.loads((tmp_path / "run.json").read_text())
    assert [one["time"] for one in run["options"]["events"]] == [0.45, 0.8, 0.5, 0.5, 0.8]
    main(["verify", str(tmp_path)])
    # Without the changes the flight is another one
    plain = recorded(aviary_of(horizon=12, events=events), lambda k: None)
    assert plain.hash() != recording.hash()


def test_a_change_after_the_last_decision_is_not_recorded(tmp_path):
    aviary = aviary_of(horizon=12)
    recording = recorded(aviary, lambda k: None)
    aviary.set_condition(added_mass=0.002)
    save(recording, aviary, "straight", 7, tmp_path)
    assert not json.loads((tmp_path / "run.json").read_text())["options"]["events"]
    main(["verify", str(tmp_path)])


def test_a_recording_with_too_many_changes_says_so(tmp_path):
    aviary = aviary_of(horizon=2)

    def change(k):
        for _ in range(MAX_EVENTS // 2 + 1):
            aviary.set_condition(added_mass=0.001)

    save(recorded(aviary, change), aviary, "straight", 7, tmp_path)
    with pytest.raises(SystemExit):
        main(["verify", str(tmp_path)])
    aviary.reset(seeds=7)
    assert aviary.worlds.schedule.log == [[]]
