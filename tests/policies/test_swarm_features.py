"""Features of drones among others, whatever their number and order."""

import numpy as np
import pytest
from gymnasium.spaces import Box
from scipy.optimize import minimize_scalar

import bulletuav
from bulletuav.policies.neural_network import Network
from bulletuav.policies.swarm_features import EntityKind, NumpySwarmFeatures, find_layout
from bulletuav.sensors.base import Label, vector_labels

SIZE = 4


def labels(count, obstacles=1):
    """A velocity, others with distance, position and velocity, and targets that do not move."""
    told = [*vector_labels("velocity", "m/s", [-1] * 3, [1] * 3)]
    for k in range(1, count + 1):
        told += [Label(f"neighbour {k} distance", "m", 0, 1)]
        told += vector_labels(f"neighbour {k} position", "m", [-1] * 3, [1] * 3)
        told += vector_labels(f"neighbour {k} velocity", "m/s", [-1] * 3, [1] * 3)
    for k in range(1, obstacles + 1):
        told += vector_labels(f"target {k}", "m", [-1] * 3, [1] * 3)
    return told


def learned(count, seed=0):
    import torch

    from bulletuav.adapters.swarm_features import SwarmFeatures

    torch.manual_seed(seed)
    told = labels(count)
    space = Box(-np.inf, np.inf, (len(told),), np.float32)
    return SwarmFeatures(space, find_layout(told), SIZE, 2.0).double()


def flown(layer, count):
    """The same layers by NumPy, for that many neighbours."""
    layers = {
        word: [
            (one.weight.detach().numpy(), one.bias.detach().numpy()) for one in (each[0], each[2])
        ]
        for word, each in layer.each.items()
    }
    return NumpySwarmFeatures(find_layout(labels(count)), layers, 2.0)


def rows(count, neighbours=None, seed=0):
    rng = np.random.default_rng(seed)
    others = rng.normal(0, 20, (5, count, 7)) if neighbours is None else neighbours
    return np.concatenate(
        [rng.normal(0, 5, (5, 3)), others.reshape(5, -1), np.ones((5, 3))], axis=1
    )


def test_labels_tell_which_numbers_belong_together():
    layout = find_layout(labels(2))
    assert layout.own == (0, 1, 2)
    assert layout.kinds == {
        "neighbour": EntityKind(
            ((3, 4, 5, 6, 7, 8, 9), (10, 11, 12, 13, 14, 15, 16)), (1, 2, 3, 4, 5, 6)
        ),
        "target": EntityKind(((17, 18, 19),), ()),
    }
    # What two blocks tell of the same neighbour is of the same neighbour.
    both = find_layout(
        [*labels(1, 0), Label("neighbour 1 team", "1", -1, 1), Label("gate 1", "m", 0, 1)]
    )
    assert both.kinds["neighbour"].columns == ((3, 4, 5, 6, 7, 8, 9, 10),)
    assert both.own == (0, 1, 2, 11)


def test_labels_of_a_task_are_found():
    env = bulletuav.batch_env("crossing", 1, num_drones=3, num_neighbours=2)
    layout = find_layout(env.observation_labels)
    assert {word: len(kind.columns) for word, kind in layout.kinds.items()} == {
        "neighbour": 2,
        "obstacle": 2,
    }
    assert len(layout.own) == 10
    assert layout.inputs("obstacle") == 8 + 5 + 10
    env.close()


@pytest.mark.parametrize("count", [1, 3, 6])
def test_numpy_computes_what_pytorch_learned_for_any_number_of_others(count):
    import torch

    layer = learned(count)
    given = rows(count)
    given[1, 3:10] = 0  # nobody there
    with torch.no_grad():
        expected = layer(torch.as_tensor(given)).numpy()
    np.testing.assert_allclose(flown(layer, count)(given), expected, atol=1e-12)
    assert expected.shape == (5, layer.features_dim) == (5, 3 + 2 * 2 * SIZE)


def test_neither_order_nor_empty_places_matter_and_those_who_are_there_do():
    features = flown(learned(3), 3)
    others = np.random.default_rng(1).normal(0, 20, (5, 3, 7))
    known = features(rows(3, others))
    np.testing.assert_allclose(features(rows(3, others[:, [2, 0, 1]])), known, atol=1e-12)
    more = np.concatenate([others, np.zeros((5, 4, 7))], axis=1)
    np.testing.assert_allclose(flown(learned(3), 7)(rows(7, more)), known, atol=1e-12)
    one_less = others.copy()
    one_less[:, 1] = 0
    assert np.abs(features(rows(3, one_less)) - known).max() > 0.1


def test_the_closest_approach_is_the_least_distance_on_the_way():
    """Compared to a search for it; one that flies away is closest now, one far off after 10 s."""
    of_one = labels(1, 0)
    # A layer that passes on where the other comes closest, how far that is, and when.
    weight = np.zeros((3, 7 + 5 + 3))
    weight[0, 10], weight[1, 11], weight[2, 7] = 1, 1, 1
    features = NumpySwarmFeatures(find_layout(of_one), {"neighbour": [(weight, np.zeros(3))]})
    place = np.array([[30.0, 4.0, 1.0], [30.0, 4.0, 1.0], [900.0, 4.0, 1.0]])
    speed = np.array([[-10.0, 1.0, 0.5], [10.0, 1.0, 0.5], [-10.0, 1.0, 0.5]])
    given = np.concatenate([np.zeros((3, 4)), place, speed], axis=1)
    told = features(given)
    for k in range(3):
        found = minimize_scalar(
            lambda t: np.linalg.norm(place[k] + t * speed[k]),  # noqa: B023 - called at once
            bounds=(0, 10),
            method="bounded",
        )
        assert np.expm1(told[k, 6]) == pytest.approx(found.fun, abs=2e-2)
        assert 5 * told[k, 7] == pytest.approx(found.x, abs=2e-3)


def test_layers_for_other_numbers_are_refused():
    layer = learned(2)
    layers = {"neighbour": flown(layer, 2)._layers["neighbour"]}
    with pytest.raises(ValueError, match="features of each target expect 0 numbers, not 6"):
        NumpySwarmFeatures(find_layout(labels(2)), layers)
    with pytest.raises(ValueError, match="features of each neighbour expect 15 numbers, not"):
        Network(
            {
                "action_net.weight": np.ones((1, 3)),
                "action_net.bias": np.ones(1),
                "features_extractor.each.neighbour.0.weight": np.ones((4, 15)),
                "features_extractor.each.neighbour.0.bias": np.ones(4),
            },
            "ppo",
            {"features": "swarm"},
            labels(0),
        )
