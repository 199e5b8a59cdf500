"""Pictures as observations: stacks of frames, images for convolutional networks, and copies."""

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import FrameStackObservation
from pettingzoo.test import parallel_api_test

import bulletuav
from bulletuav.sensors.base import Image
from bulletuav.tasks.observations.images import to_images

PICTURES = {
    "dynamics": "point_mass",
    "observation": ("velocity", "depth", "rgb"),
    "camera_size": (16, 8),
    "num_drones": 2,
}
ALONE = {**PICTURES, "num_drones": 1}
TASK = "lidar_navigation"


def act(step, worlds=3, drones=2):
    return np.random.default_rng(step).uniform(-1, 1, (worlds, drones, 3))


def test_frames_are_those_of_gymnasiums_wrapper():
    stacked = gymnasium.make(
        "bulletuav/LidarNavigation-v2", disable_env_checker=True, frame_stack=3, **ALONE
    )
    wrapped = FrameStackObservation(
        gymnasium.make("bulletuav/LidarNavigation-v2", disable_env_checker=True, **ALONE), 3
    )
    changed = False
    for seed in (3, 4):
        frames, expected = (env.reset(seed=seed)[0] for env in (stacked, wrapped))
        for step in range(6):
            assert frames["depth"].shape == (3, 8, 16)
            assert frames["rgb"].shape == (3, 8, 16, 3)
            for name in ("depth", "rgb"):
                np.testing.assert_array_equal(frames[name], expected[name])
                assert frames[name].dtype == expected[name].dtype
            assert stacked.observation_space.contains(frames)
            changed |= bool((frames["depth"][0] != frames["depth"][2]).any())
            frames, expected = (env.step(act(step, 1, 1)[0, 0])[0] for env in (stacked, wrapped))
    assert changed
    stacked.close()
    wrapped.close()


def test_a_new_episode_starts_with_its_first_picture_in_its_world_only():
    env = bulletuav.batch_env(TASK, 2, frame_stack=2, **PICTURES)
    env.reset(seed=0)
    for step in range(3):
        before, *_ = env.step(act(step, 2))
    after, _ = env.reset(options={"reset_mask": np.array([True, False])})
    depth = after["depth"]
    assert depth.shape == (2, 2, 2, 8, 16)
    np.testing.assert_array_equal(depth[0, :, 0], depth[0, :, 1])
    assert (depth[0, :, 0] != before["depth"][0, :, 1]).any()
    np.testing.assert_array_equal(depth[1], before["depth"][1])
    env.close()


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("options", [{}, {"frame_stack": 3, "camera_format": "image"}])
def test_processes_and_shared_memory_change_no_bit(mode, options):
    given = {**PICTURES, **options, "autoreset_mode": mode, "horizon": 4}
    copied = bulletuav.batch_env(TASK, 3, **given)
    views = [
        bulletuav.batch_env(TASK, 3, copy=False, workers=workers, **given) for workers in (1, 2)
    ]
    expected, _ = copied.reset(seed=5)
    seen = [env.reset(seed=5)[0] for env in views]
    for step in range(10):
        for one in seen:
            assert list(one) == list(expected)
            for name in expected:
                np.testing.assert_array_equal(one[name], expected[name])
        expected, *_, infos = copied.step(act(step))
        results = [env.step(act(step)) for env in views]
        seen = [one[0] for one in results]
        assert ("final_obs" in infos) == (mode == AutoresetMode.SAME_STEP and step % 4 == 3)
        for *_, own in results:
            if "final_obs" in infos:
                for name, final in infos["final_obs"].items():
                    np.testing.assert_array_equal(own["final_obs"][name], final)
    for env in (copied, *views):
        env.close()


@pytest.mark.parametrize("workers", [1, 2])
def test_observations_share_memory_only_without_copies(workers):
    for copy in (True, False):
        env = bulletuav.batch_env(TASK, 2, workers=workers, copy=copy, frame_stack=2, **PICTURES)
        env.reset(seed=0)
        first, second = (env.step(act(step, 2))[0] for step in range(2))
        assert first["depth"].shape == (2, 2, 2, 8, 16)
        assert first["rgb"].shape == (2, 2, 2, 8, 16, 3)
        for name in first:
            assert np.shares_memory(first[name], second[name]) == (not copy)
        env.close()


def test_frames_are_in_snapshots():
    env = bulletuav.batch_env(TASK, 2, frame_stack=3, **PICTURES)
    env.reset(seed=0)
    for step in range(4):
        env.step(act(step, 2))
    saved = env.save_state()
    expected = [env.step(act(step, 2))[0]["depth"] for step in range(4, 8)]
    other = bulletuav.batch_env(TASK, 2, frame_stack=3, **PICTURES)
    other.reset(seed=9)
    other.load_state(saved)
    for step, depth in zip(range(4, 8), expected, strict=True):
        np.testing.assert_array_equal(other.step(act(step, 2))[0]["depth"], depth)
    env.close()
    other.close()


# Images


def test_images_have_channels_last_and_bounds_from_0_to_255():
    depth = np.array([[[[[0.0, 10.0]], [[20.0, 4.0]]]]], dtype=np.float32)  # two frames of 1 x 2
    image = to_images(depth, Image(0.0, 20.0, np.float32, ()))
    assert image.dtype == np.uint8
    assert image.tolist() == [[[[[0, 255], [128, 51]]]]]  # 127.5 is rounded to even
    colours = np.arange(24, dtype=np.uint8).reshape(1, 1, 2, 2, 2, 3)
    image = to_images(colours, Image(0, 255, np.uint8, (3,)))
    assert image.shape == (1, 1, 2, 2, 6)
    assert image[0, 0, 1, 0].tolist() == [6, 7, 8, 18, 19, 20]
    assert not np.shares_memory(image, colours)


def test_images_are_pictures_in_another_format():
    plain, image = (
        bulletuav.parallel_env(TASK, camera_format=form, **PICTURES) for form in ("array", "image")
    )
    one, other = (env.reset(seed=2)[0]["drone_1"] for env in (plain, image))
    np.testing.assert_array_equal(other["rgb"], one["rgb"])
    assert other["depth"].shape == (8, 16, 1)
    most = plain.observation_space("drone_1")["depth"].high.max()
    np.testing.assert_allclose(other["depth"][..., 0], one["depth"] / most * 255, atol=0.5001)
    np.testing.assert_array_equal(other["vector"], one["vector"])
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*(seed|Observation).*")
        parallel_api_test(image, 20)
    plain.close()
    image.close()


def test_a_picture_alone_is_an_array():
    options = {**ALONE, "observation": ("depth",), "camera_format": "image", "frame_stack": 4}
    env = gymnasium.make("bulletuav/LidarNavigation-v2", **options)
    assert env.observation_space == gymnasium.spaces.Box(0, 255, (8, 16, 4), np.uint8)
    seen, _ = env.reset(seed=0)
    assert env.observation_space.contains(seen)
    assert env.unwrapped.split(seen)["depth"] is seen
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*(render|spec).*")
        check_env(env.unwrapped, skip_render_check=True)
    env.close()
    many = bulletuav.batch_env(TASK, 3, workers=2, **{**options, "num_drones": 2})
    assert many.reset(seed=0)[0].shape == (3, 2, 8, 16, 4)
    many.close()
    kept = bulletuav.batch_env(TASK, 1, observation_format="dict", **options)
    assert set(kept.reset(seed=0)[0]) == {"depth"}
    kept.close()


@pytest.mark.parametrize(
    ("policy", "observation"),
    [("CnnPolicy", ("rgb",)), ("CnnPolicy", ("depth",)), ("MultiInputPolicy", ("goal", "depth"))],
)
def test_stable_baselines_learns_from_images_without_wrappers(policy, observation):
    sb3 = pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.env_checker import check_env as check_sb3
    from stable_baselines3.common.preprocessing import is_image_space

    env = gymnasium.make(
        "bulletuav/LidarNavigation-v2",
        dynamics="point_mass",
        num_drones=1,
        observation=observation,
        camera_size=(36, 36),
        camera_format="image",
        frame_stack=2,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_sb3(env)
    model = sb3.PPO(policy, env, n_steps=16, batch_size=8, n_epochs=1, seed=0, device="cpu")
    before = [one.clone() for one in model.policy.parameters()]
    model.learn(32)
    assert any((a != b).any() for a, b in zip(before, model.policy.parameters(), strict=True))
    # Images are recognised, and pass through convolutions
    spaces = model.observation_space
    images = [spaces] if policy == "CnnPolicy" else [spaces["depth"]]
    assert all(is_image_space(space) for space in images)
    assert any(type(module).__name__ == "Conv2d" for module in model.policy.modules())
    env.close()


def test_torchrl_convolves_images():
    pytest.importorskip("torchrl")
    from torchrl.envs import ToTensorImage, TransformedEnv
    from torchrl.modules import ConvNet

    from bulletuav.adapters.torchrl import DroneTensorEnv

    base = DroneTensorEnv(TASK, 2, camera_format="image", frame_stack=2, **PICTURES)
    data = TransformedEnv(base, ToTensorImage(in_keys=[("drones", "observation", "depth")])).reset()
    picture = data["drones", "observation", "depth"]
    assert picture.shape == (2, 2, 2, 8, 16)
    assert 0 <= picture.min() <= picture.max() <= 1
    net = ConvNet(in_features=2, num_cells=[4], kernel_sizes=3)
    assert net(picture).shape[:2] == (2, 2)
    base.close()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"frame_stack": 0}, "frame_stack is 0: a whole number, at least 1"),
        ({"frame_stack": 65}, "frame_stack is 65: a whole number from 1 to 64"),
        ({"frame_stack": 2, "observation": ("goal",)}, "frame_stack is 2, and no picture"),
        ({"camera_format": "image", "observation": ("goal",)}, "'image', and no picture"),
        ({"camera_format": "images"}, "did you mean 'image'"),
        ({"copy": 1}, "copy is 1: True or False"),
    ],
)
def test_impossible_pictures(options, message):
    for workers in (1, 2):
        with pytest.raises(ValueError, match=message):
            bulletuav.batch_env(TASK, 2, workers=workers, **{**PICTURES, **options})
