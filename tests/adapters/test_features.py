import numpy as np
import pytest
import torch
from gymnasium.spaces import Box, Dict

from bulletuav.adapters.features import (
    PictureFeatures,
    SymlogFeatures,
    UserSum,
    log_path_gain_tensor,
)
from bulletuav.network.pathloss import log_distance

DRONES, USERS = 2, 4


def space(size):
    return Box(-np.inf, np.inf, (size,), np.float32)


def observed(rng, users=USERS):
    """Numbers as of position, all_neighbours, targets, sight_matrix, sight_ahead, in this order."""
    own, others = rng.uniform(-100, 100, (1, 3)), rng.uniform(-50, 50, (1, 6 * (DRONES - 1)))
    targets = rng.uniform(-200, 200, (1, users, 4))
    flags = rng.integers(0, 2, (1, DRONES + 4, users))
    return own, others, targets, flags


def row(own, others, targets, flags):
    parts = [own, others, targets.reshape(1, -1), flags.reshape(1, -1)]
    return torch.tensor(np.concatenate(parts, axis=1), dtype=torch.float32)


def made(size=None):
    torch.manual_seed(0)
    return UserSum(
        space(3 + 6 * (DRONES - 1) + USERS * (4 + DRONES + 4) if size is None else size), DRONES, 8
    )


def test_symlog_is_odd_and_nearly_the_identity_at_zero():
    layer = SymlogFeatures(Box(-10, 10, (3,)))
    given = torch.tensor([[-9.0, 0.001, np.e - 1]])
    np.testing.assert_allclose(layer(given), [[-np.log(10), 0.0009995, 1.0]], rtol=1e-6)
    assert torch.equal(layer(-given), -layer(given))
    assert layer.features_dim == 3
    torch.testing.assert_close(SymlogFeatures(Box(-10, 10, (3,)), 50.0)(given), layer(50 * given))


def test_the_order_of_users_does_not_matter_and_who_they_are_does():
    layer, numbers = made(), observed(np.random.default_rng(0))
    order = np.random.default_rng(1).permutation(USERS)
    own, others, targets, flags = numbers
    features = layer(row(*numbers))
    assert features.shape == (1, layer.features_dim) == (1, 3 * DRONES + 8)
    torch.testing.assert_close(
        layer(row(own, others, targets[:, order], flags[:, :, order])), features
    )
    seen = flags.copy()
    seen[0, 2] = 1 - seen[0, 2]  # from the east
    assert not torch.allclose(layer(row(own, others, targets, seen)), features)
    np.testing.assert_allclose(
        features[0, :6].detach() * 100, np.concatenate([own[0], others[0, :3]]), rtol=1e-5
    )


def test_gain_is_that_of_log_distance():
    """Beyond 1 m: 20 and 31.9 dB a decade."""
    offset = torch.tensor([[30.0, 40.0, 0.0], [300.0, 400.0, 0.0]])
    decibel = 10 / np.log(10) * log_path_gain_tensor(offset, torch.tensor([1.0, 0.0]))
    loss = [
        log_distance(distance + 1, 2.4e9, n) - log_distance(1.0, 2.4e9, n)
        for distance, n in ((50, 2.0), (500, 3.19))
    ]
    np.testing.assert_allclose(-decibel.numpy(), loss, rtol=1e-5)


def test_numbers_that_do_not_fit_are_refused():
    with pytest.raises(
        ValueError, match=r"features of 2 drones and their users do not fit \(50,\)"
    ):
        made(50)


def pictures(**boxes):
    torch.manual_seed(0)
    return PictureFeatures(Dict(boxes), size=5)


def test_the_nearest_of_each_patch_of_depths_remains():
    depth = Box(0, 2000, (32, 64), np.float32)
    features = pictures(vector=Box(-10, 10, (2,)), depth=depth)
    metres = torch.full((1, 32, 64), 2000.0)
    metres[0, 5, 9] = 10.0  # a pole of a pixel
    vector = torch.tensor([[0.0, np.e - 1]])
    prepared = features.prepare({"vector": vector, "depth": metres})
    near = np.full((1, 1, 16, 32), 1 / 201)  # 1 / (1 + 2000 / 10)
    near[0, 0, 2, 4] = 0.5
    np.testing.assert_allclose(prepared["depth"], near, rtol=1e-6)
    np.testing.assert_allclose(prepared["vector"], [[0, 1]], rtol=1e-6)
    seen = features({"vector": vector, "depth": metres})
    assert seen.shape == (1, 7) == (1, features.features_dim)
    assert torch.equal(seen[:, :2], prepared["vector"])


def test_normalised_depths_stay_unchanged():
    features = pictures(depth=Box(0, 1, (8, 8), np.float32))
    given = torch.rand(3, 8, 8)
    assert torch.equal(features.prepare({"depth": given})["depth"], given[:, None])


def test_colours_are_averaged_and_frames_are_channels():
    colours = Box(0, 255, (2, 32, 48, 3), np.uint8)
    features = pictures(rgb=colours, labels=Box(0, 4, (8, 12), np.uint8))
    given = torch.from_numpy(np.random.default_rng(0).integers(0, 256, (1, 2, 32, 48, 3)))
    labels = torch.full((1, 8, 12), 3)
    prepared = features.prepare({"rgb": given, "labels": labels})
    patches = given[0].numpy().reshape(2, 16, 2, 24, 2, 3).mean(axis=(2, 4)) / 255
    np.testing.assert_allclose(
        prepared["rgb"][0], patches.transpose(0, 3, 1, 2).reshape(6, 16, 24), rtol=1e-6
    )
    assert (prepared["labels"] == 0.75).all()
    assert features({"rgb": given, "labels": labels}).shape == (1, 10)


def test_images_of_stable_baselines_are_already_divided():
    features = pictures(rgb=Box(0, 255, (3, 8, 8), np.uint8))
    given = torch.rand(1, 3, 8, 8)
    assert torch.equal(features.prepare({"rgb": given})["rgb"], given)
