"""The global state: drones, charges, cities, users and servers, each number named."""

import gymnasium
import numpy as np
import pytest
from placing import SMALL

import bulletuav

OWN = 17  # numbers of a drone


@pytest.fixture
def mec():
    env = bulletuav.parallel_env("mec", num_users=4, **SMALL)
    env.reset(seed=0)
    env.step({agent: np.zeros(3) for agent in env.agents})
    yield env
    env.close()


def test_the_state_tells_drones_charges_city_users_and_servers_in_this_order(mec):
    aviary, state = mec.aviary, mec.state()
    assert list(aviary.global_state.parts) == [
        "drones",
        "charge",
        "city",
        "users",
        "utilisation",
        "queue",
    ]
    assert state.shape == mec.state_space.shape == (3 * OWN + 3 + 3 + 4 * 3 + 3 + 3,)
    assert mec.state_space.contains(state)
    told = aviary.global_state.split(state)
    memory = aviary.scene.memory
    np.testing.assert_allclose(told["position"], aviary.swarm.position[0], rtol=1e-6)
    np.testing.assert_allclose(told["charge"], aviary.worlds.frame.readings["charge"][0], rtol=1e-6)
    np.testing.assert_allclose(told["users"].reshape(4, 3), memory["users"][0], rtol=1e-6)
    np.testing.assert_allclose(told["utilisation"], memory["utilisation"][0], rtol=1e-6)
    np.testing.assert_allclose(told["queue"], memory["queue"][0], rtol=1e-6)
    info = mec.aviary.first_info()
    city = [info[name][0, 0] for name in ("city_alpha", "city_beta", "city_gamma")]
    np.testing.assert_allclose(told["city"], city, rtol=1e-6)


def test_each_number_is_named_once_with_its_unit(mec):
    labels = mec.aviary.global_state.labels
    names = [label.name for label in labels]
    assert len(set(names)) == len(names)
    assert names[0] == "position x of drone_0"
    assert names[OWN] == "position x of drone_1"
    assert {"charge of drone_2", "user 4 z", "queue of drone_0", "city_gamma"} <= set(names)
    assert dict(zip(names, labels, strict=True))["city_gamma"].unit == "m"


def test_cities_differ_by_layout_in_state_and_infos():
    aviary = bulletuav.Aviary("navigation", 8, area=300.0, num_layouts=2)
    aviary.reset(seeds=0)
    told = aviary.global_state.split(aviary.state())["city"]
    layout = aviary.scene.layout
    assert set(layout) == {0, 1}
    for w in range(8):
        city = aviary.task.city_layouts.cities[layout[w]]
        gamma = np.sqrt((city.heights**2).mean() / 2)
        expected = (city.coverage, len(city.heights) / 0.09, gamma)
        np.testing.assert_allclose(told[w], expected, rtol=1e-6)
        assert aviary.first_info()["city_gamma"][w] == pytest.approx(np.full(3, gamma))
    aviary.close()


def test_tasks_without_these_have_the_drones_alone():
    aviary = bulletuav.Aviary("converge", 2, num_drones=3, dynamics="single_integrator")
    aviary.reset(seeds=0)
    assert aviary.state().shape == (2, 3 * OWN)
    assert list(aviary.global_state.parts) == ["drones"]
    aviary.close()


def test_a_state_of_another_size_is_refused(mec):
    with pytest.raises(ValueError, match="78 numbers|numbers are needed"):
        mec.aviary.global_state.split(np.zeros(5))


@pytest.mark.parametrize("form", ["vector", "dict"])
def test_one_agent_for_all_drones_observes_the_state(form):
    env = gymnasium.make("bulletuav/Los-v2", num_users=4, observation_format=form, **SMALL)
    seen, _ = env.reset(seed=0)
    assert env.observation_space.contains(seen)
    by_name = env.unwrapped.split(seen)
    assert by_name["position"].shape == (3, 3)
    assert by_name["users"].shape == (12,)
    env.close()


def test_stages_of_a_curriculum_share_the_places_of_their_parts():
    stages = [{"num_drones": 1, "num_users": 2}, {"num_drones": 3, "num_users": 4}]
    env = bulletuav.curriculum_env("los", stages, observation="position", **SMALL)
    env.reset(seed=0)
    state = env.state()
    assert state.shape == (3 * OWN + 3 + 3 + 4 * 3,)
    assert state[3 * OWN] == 1  # charge of the only drone
    assert (state[3 * OWN + 1 : 3 * OWN + 3] == 0).all()
    users = env.env.aviary.scene.memory["users"][0].ravel()
    np.testing.assert_allclose(state[3 * OWN + 6 :][:6], users, rtol=1e-6)
    assert (state[3 * OWN + 12 :] == 0).all()
    env.close()
