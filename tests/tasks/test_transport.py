"""Task `transport`: loads in tasks, their cables and snapshots; rewards and ends of the task."""

import numpy as np
import pytest

import bulletuav
from bulletuav.geometry.view import OBSTACLE
from bulletuav.policies import find_policy
from bulletuav.tasks.parts.loads import (
    ATTACHED,
    GRAVITY,
    POSITION,
    QUATERNION,
    RATES,
    TENSION,
    VELOCITY,
)
from bulletuav.tasks.transport import lay_out

IMAGES = ("depth", "segmentation", "flow")
WIND = {"wind": (1.0, 0.5, 0.0)}


def fly(aviary, policy, decisions, seen):
    """Fly a policy from observations; return the last step, and the sums of the rewards."""
    policy = find_policy(policy)(aviary)
    policy.reset(np.ones(aviary.num_worlds, dtype=bool))
    total, step = np.zeros(aviary.alive.shape), None
    for _ in range(decisions):
        step = aviary.step(policy.act(seen, aviary.swarm))
        seen, total = step.observations, total + step.rewards
        if not aviary.alive.any():
            break
    return step, total


def state_of(aviary):
    """Copy the state of drones, loads and cables of each world."""
    memory = aviary.scene.memory
    names = (POSITION, QUATERNION, VELOCITY, TENSION, "dragged", "max_swing")
    arrays = (*aviary.swarm, *(memory[name] for name in names))
    return [[array[w].copy() for array in arrays] for w in range(aviary.num_worlds)]


@pytest.mark.parametrize("drones", [1, 2, 4, 8])
def test_several_worlds_have_the_bits_of_one(drones):
    options = {"num_drones": drones, **WIND}
    several = bulletuav.Aviary("transport", 3, **options)
    seen = several.reset(seeds=[5, 6, 7])
    fly(several, "carrier", 60, seen)
    assert (several.scene.memory[POSITION][:, 0, 2] > 0.3).all()
    hashes = several.state_hash()
    for w, expected in enumerate(state_of(several)):
        one = bulletuav.Aviary("transport", 1, **options)
        seen = one.reset(seeds=5 + w)
        fly(one, "carrier", 60, seen)
        for found, wanted in zip(state_of(one)[0], expected, strict=True):
            np.testing.assert_array_equal(found, wanted)
        assert one.state_hash()[0] == hashes[w]
        one.close()
    several.close()


def test_a_hovering_load_has_its_weight_on_its_cables():
    aviary = bulletuav.Aviary("transport", 2, num_drones=4)
    seen = aviary.reset(seeds=0)
    fly(aviary, "transport_lift", 240, seen)
    memory = aviary.scene.memory
    assert np.abs(memory[VELOCITY]).max() < 0.02
    # 4 drones, each with 0.2 kg
    np.testing.assert_allclose(memory[TENSION], 0.2 * 9.80665, rtol=0.02)
    np.testing.assert_allclose(memory[TENSION].sum(axis=1), 0.8 * 9.80665, rtol=2e-3)
    ends = aviary.task.loads.find_ends(memory)
    gap = np.linalg.norm(ends - aviary.swarm.position, axis=-1)
    np.testing.assert_allclose(gap, 1.0, atol=1e-6)
    assert aviary.contacts.drone.size == 0  # the load has risen from the ground
    aviary.close()


def test_a_snapshot_continues_with_the_same_bits_in_another_world():
    aviary = bulletuav.Aviary("transport", 3, num_drones=2, **WIND)
    seen = aviary.reset(seeds=1)
    fly(aviary, "carrier", 40, seen)
    snapshot = aviary.save_state(1)
    fly(aviary, "carrier", 10, aviary.observations())
    expected, hashes = state_of(aviary)[1], aviary.state_hash()
    aviary.reset(seeds=50)
    seen = aviary.load_state(snapshot, 2)
    # Without the memory of the policy, which is zero far from the place
    fly(aviary, "carrier", 10, seen)
    for found, wanted in zip(state_of(aviary)[2], expected, strict=True):
        np.testing.assert_array_equal(found, wanted)
    assert aviary.state_hash()[2] == hashes[1]
    aviary.close()


def test_a_reset_of_one_world_leaves_the_loads_of_others():
    aviary = bulletuav.Aviary("transport", 2, num_drones=2)
    seen = aviary.reset(seeds=3)
    fly(aviary, "carrier", 40, seen)
    before = state_of(aviary)[1]
    aviary.reset(np.array([True, False]))
    for found, wanted in zip(state_of(aviary)[1], before, strict=True):
        np.testing.assert_array_equal(found, wanted)
    memory = aviary.scene.memory
    assert memory[POSITION][0, 0, 2] == pytest.approx(0.05)
    assert not memory[TENSION][0].any()
    aviary.close()


def test_a_reset_of_one_world_leaves_the_cables_of_an_ended_one():
    aviary = bulletuav.Aviary("transport", 2, num_drones=2, battery_capacity=10.0)
    charge = np.array([[1.0, 1.0], [0.003, 0.003]])
    seen = aviary.reset(seeds=0, charge=charge)
    for _ in range(150):
        seen = fly(aviary, "transport_lift", 1, seen)[0].observations
        if not aviary.alive[1].any():
            break
    # Cables of drones whose episode has ended are dropped in the next decision
    assert aviary.alive.tolist() == [[True, True], [False, False]]
    before = aviary.state_hash()
    aviary.reset(np.array([True, False]))
    assert aviary.state_hash()[1] == before[1]
    aviary.close()


def test_the_load_is_delivered_and_released():
    aviary = bulletuav.Aviary("transport", 4, num_drones=2)
    seen = aviary.reset(seeds=0)
    step, total = fly(aviary, "carrier", 900, seen)
    memory = aviary.scene.memory
    assert not aviary.alive.any()
    assert memory["delivered"].all()
    assert (memory["load_distance"] <= 0.2).all()
    assert not memory[ATTACHED].any()
    assert (memory["max_swing"] < 0.6).all()
    assert (total > 30).all()
    aviary.close()
    assert step is not None


@pytest.mark.parametrize("load_mass", [0.5, 0.8])
def test_heavy_loads_are_delivered(load_mass):
    # 0.7 and 1.1 times the weight of the drone, whose thrust is 3.4 times its weight
    aviary = bulletuav.Aviary("transport", 1, load_mass=load_mass)
    fly(aviary, "carrier", 900, aviary.reset(seeds=1))
    assert aviary.scene.memory["delivered"].all()


@pytest.mark.parametrize("place_radius", [0.1, 0.15])
def test_small_places_are_reached(place_radius):
    aviary = bulletuav.Aviary("transport", 2, num_drones=2, place_radius=place_radius, **WIND)
    fly(aviary, "carrier", 900, aviary.reset(seeds=3))
    assert aviary.scene.memory["delivered"].all()
    assert (aviary.scene.memory["load_distance"] <= place_radius).all()
    aviary.close()


def test_the_oracle_flies_as_the_baseline_does_without_noise():
    positions = []
    for policy in ("carrier", "carrier_oracle"):
        aviary = bulletuav.Aviary("transport", 2, num_drones=4)
        fly(aviary, policy, 200, aviary.reset(seeds=4))
        positions.append(aviary.scene.memory[POSITION].copy())
        aviary.close()
    # Observations are rounded to single precision
    np.testing.assert_allclose(positions[0], positions[1], atol=1e-3)


def test_noise_of_positions_disturbs_the_baseline_but_not_the_oracle():
    delivered = {}
    for policy in ("carrier", "carrier_oracle"):
        aviary = bulletuav.Aviary("transport", 4, difficulty="extreme", dynamics="rigid_body")
        fly(aviary, policy, 900, aviary.reset(seeds=7000))
        delivered[policy] = aviary.scene.memory["delivered"].sum()
        aviary.close()
    assert delivered["carrier"] < delivered["carrier_oracle"] == 4


def test_drones_that_leave_drop_their_cables():
    aviary = bulletuav.Aviary("transport", 1, num_drones=2, battery_capacity=10.0)
    seen = aviary.reset(seeds=0, charge=[1.0, 0.01])
    for _ in range(150):
        seen = fly(aviary, "transport_lift", 1, seen)[0].observations
        if not aviary.alive.all():
            break
    fly(aviary, "transport_lift", 1, seen)
    assert aviary.alive.tolist() == [[True, False]]
    cables = aviary.worlds.dynamics.cables
    assert cables.body[0].tolist() == [[0, 2], [-2, -2]]
    tension = aviary.scene.memory[TENSION][0]
    assert tension[0] > 0.0
    assert tension[1] == 0.0
    aviary.close()


@pytest.mark.parametrize(
    ("policy", "reason"),
    [("transport_drag", "dragged"), ("transport_drop", ""), ("transport_ram", "")],
)
def test_loads_that_are_dragged_or_fall_and_collisions_end_the_episode(policy, reason):
    aviary = bulletuav.Aviary("transport", 1)
    seen = aviary.reset(seeds=0)
    step, total = fly(aviary, policy, 900, seen)
    memory = aviary.scene.memory
    assert memory["failed"][0] == 1.0
    assert step.terminated.all()
    assert not step.info["success"].any()
    assert total[0, 0] < -10
    if reason == "dragged":
        assert memory["dragged"][0] > 0.5
    aviary.close()


def test_observations_are_those_of_load_and_cable():
    aviary = bulletuav.Aviary("transport", 2, num_drones=2)
    seen = aviary.reset(seeds=2)
    step, _ = fly(aviary, "carrier", 30, seen)
    seen, memory = aviary.observer.split(step.observations), aviary.scene.memory
    position = aviary.swarm.position
    load = seen["load"]
    np.testing.assert_allclose(load[..., :3], memory[POSITION] - position, atol=1e-6)
    np.testing.assert_allclose(load[..., 3:6], np.repeat(memory[VELOCITY], 2, 1), atol=1e-6)
    ends = seen["cable"][..., :3]
    np.testing.assert_allclose(np.linalg.norm(ends, axis=-1), 1.0, atol=1e-5)
    assert (seen["cable"][..., 3] == 1.0).all()
    # Both ends of the beam are 1.2 m apart
    gap = (ends + position)[:, 0] - (ends + position)[:, 1]
    np.testing.assert_allclose(np.linalg.norm(gap, axis=-1), 1.2, atol=1e-5)
    offset = memory["place"] - memory[POSITION][:, 0]
    np.testing.assert_allclose(seen["load_goal_offset"][:, 0], offset, atol=1e-6)
    aviary.close()


def test_cables_are_apart_on_all_loads():
    for drones in range(1, 9):
        for shape in ("beam", "box"):
            size, points, beside = lay_out(shape, drones)
            assert (np.abs(points) <= np.array(size) / 2 + 1e-9).all()
            gap = np.linalg.norm(points[:, None] - points, axis=-1) + 9.0 * np.eye(drones)
            assert gap.min() > 0.8
            outside = np.abs(points + beside)[:, :2] - np.array(size)[:2] / 2
            assert (outside.max(axis=1) > 0.39).all()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"dynamics": "point_mass"}, "no cables"),
        ({"shape": "parcel", "num_drones": 2}, "use 'beam' or 'box'"),
        ({"shape": "ball"}, "shape"),
        ({"load_mass": 0.0}, "load_mass is 0 kg"),
        ({"load_mass": 1.4}, "load 0 has 1.4 kg, .* weight of 20.8 N: .* of 24 N has to be 1.2"),
        ({"airframe": "cf2x"}, "use a stronger airframe"),
        ({"distance": (5.0, 4.0)}, "distance is"),
        ({"distance": (0.5, 4.0)}, "distance is"),
        ({"cable_length": 0.3}, "cable_length is 0.3 m"),
        ({"d_safe": 0.9}, "d_safe is 0.9 m"),
    ],
)
def test_invalid_options_are_reported(options, words):
    with pytest.raises(ValueError, match=words):
        bulletuav.Aviary("transport", 1, **options)


def test_sensors_see_the_load_where_it_is():
    aviary = bulletuav.Aviary(
        "transport",
        1,
        observation=("load", "cable", "load_goal_offset", "lidar", "clearance", *IMAGES),
        num_beams=1,
        lidar_elevations=(-90.0, 45.0),
        camera_mounts=[{"pitch": -90.0, "offset": (0.0, 0.0, 0.0), "stabilized": True}],
        camera_size=(33, 33),
    )
    seen = aviary.reset(seeds=0)
    for decisions in (0, 60):
        # Lifted straight up, the load stays below the drone
        if decisions:
            fly(aviary, "transport_lift", decisions, seen)
        load, drone = aviary.scene.memory[POSITION][0, 0], aviary.swarm.position[0, 0]
        down, readings = drone[2] - load[2] - 0.125, aviary.readings
        assert readings["lidar"][0, 0] == pytest.approx([down, 60.0], abs=0.003)
        assert readings["depth"][0, 0, 0, 16, 16] == pytest.approx(down, abs=0.003)
        assert readings["segmentation"][0, 0, 0, 16, 16] == OBSTACLE
        assert down - 0.1 < readings["clearance"][0, 0] < down
        start = load + [(0.5, 0.0, 0.0), (0.5, 0.0, 0.3)]
        end = load + [(-0.5, 0.0, 0.0), (-0.5, 0.0, 0.3)]
        np.testing.assert_array_equal(aviary.line_of_sight(start, end, 0), [False, True])
    assert load[2] > 0.5
    # In the picture the load does not move, as it follows the drone
    assert np.abs(readings["flow"][0, 0, 0, 16, 16]).max() < 0.1


def test_bullet_carries_as_rigid_body_and_resumes_from_snapshots():
    ends = []
    for dynamics in ("rigid_body", "bullet"):
        aviary = bulletuav.Aviary("transport", 2, dynamics=dynamics, num_drones=3)
        seen = aviary.reset(seeds=0)
        for _ in range(2):  # with bodies of an earlier episode
            seen = aviary.reset(seeds=1)
            seen = fly(aviary, "carrier", 30, seen)[0].observations
        saved = aviary.save_state()
        fly(aviary, "carrier", 30, seen)
        later = [aviary.swarm.position.copy(), aviary.scene.memory[POSITION].copy()]
        seen = aviary.load_state(saved)
        fly(aviary, "carrier", 30, seen)
        np.testing.assert_array_equal(aviary.swarm.position, later[0])
        np.testing.assert_array_equal(aviary.scene.memory[POSITION], later[1])
        ends.append(later)
        aviary.close()
    assert ends[0][1][..., 2].min() > 0.3  # lifted
    for one, other in zip(*ends, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-5)


def test_the_slack_at_which_a_load_is_released_follows_gravity():
    """Cables that carry a tenth of the weight of the load on the Moon, not on the Earth."""
    aviary = bulletuav.Aviary("transport", 1, gravity=9.81)
    aviary.reset(seeds=0)
    aviary.step(np.zeros((1, 1, 3)))
    np.testing.assert_array_equal(aviary.scene.memory[GRAVITY], 9.81)
    aviary.set_condition(gravity=1.62)
    aviary.step(np.zeros((1, 1, 3)))
    memory, task = aviary.scene.memory, aviary.task
    np.testing.assert_array_equal(memory[GRAVITY], 1.62)
    memory["place"][:] = memory[POSITION][:, 0]
    for share, stands in ((0.11, False), (0.09, True)):
        memory[TENSION][:] = share * 0.2 * 1.62
        memory[VELOCITY][:] = memory[RATES][:] = 0.0
        task.update_memory(aviary.current_frame(), aviary.rng)
        assert (memory["standing"][0] > 0.0) == stands
    aviary.close()


def test_pictures_show_the_load_and_its_cables():
    aviary = bulletuav.Aviary("transport", 1, render_mode="rgb_array", render_size=(320, 240))
    seen = aviary.reset(seeds=0)
    fly(aviary, "transport_lift", 60, seen)
    colours = aviary.render(marks=False).reshape(-1, 3).astype(int)
    # The colour of loads is brown: red above green above blue
    brown = (colours[:, 0] > colours[:, 1] + 15) & (colours[:, 1] > colours[:, 2] + 15)
    assert brown.sum() > 20
    aviary.close()
