"""Tests of the table `gym-pybullet-drones`."""

from pathlib import Path

import numpy as np
import pytest

from bulletuav.reproduction.gym_pybullet_drones import (
    compute_peer_wakes,
    damped,
    fly_peer_examples,
)
from bulletuav.reproduction.gym_pybullet_drones_child import ACTIONS, fixed_actions
from bulletuav.reproduction.tables.gym_pybullet_drones import REPRODUCTION, distances


def test_wake_has_the_published_form() -> None:
    """Only the lower drone is pushed; straight below by 2267.18 (R / 4 z)^2."""
    wakes = compute_peer_wakes(np.array([[0.0, 0.0, 1.5], [0.0, 0.0, 1.0]]))
    assert wakes[0] == 0.0
    assert wakes[1] == pytest.approx(2267.18 * (2.31348e-2 / (4 * 0.5)) ** 2)
    # At one width to the side it has exp(-1/2) of this
    aside = 0.16 * 0.5 - 0.11
    moved = compute_peer_wakes(np.array([[aside, 0.0, 1.5], [0.0, 0.0, 1.0]]))
    assert moved[1] == pytest.approx(wakes[1] * np.exp(-0.5))
    assert not compute_peer_wakes(np.array([[11.0, 0, 1.5], [0, 0, 1.0]])).any()


def test_damping_grows_with_speed() -> None:
    """Bullet takes 4 % a second, and 4 % more for each m/s."""
    assert damped(np.array([[3.0, 0.0, 4.0]]))[0] == pytest.approx([0.72, 0.0, 0.96])


@pytest.mark.parametrize("kind", ACTIONS)
def test_actions_are_within_bounds(kind: str) -> None:
    """One row a control step, within -1 and 1."""
    actions = fixed_actions(kind, 150)
    assert len(actions) == 150
    assert np.abs(actions).max() <= 1.0
    assert np.ptp(actions, axis=0).max() > 0.1


def test_distance_is_that_of_the_farthest_drone() -> None:
    """Two drones, one of which is 0.5 m away."""
    one = {"a": np.zeros((3, 2, 20))}
    other = {"a": np.zeros((3, 2, 3))}
    other["a"][1, 1] = (0.3, 0.0, 0.4)
    assert distances(one, other)["a"] == pytest.approx([0.0, 0.5, 0.0])


def test_folder_that_is_no_clone_raises_an_error(tmp_path: Path) -> None:
    """The message has the reason of the subprocess; the process goes on."""
    with pytest.raises(ValueError, match="No module named 'gym_pybullet_drones'"):
        fly_peer_examples(tmp_path, 1)
    assert REPRODUCTION.data is not None
    with pytest.raises(FileNotFoundError, match="git clone"):
        REPRODUCTION.data.find(tmp_path, "gym-pybullet-drones")
