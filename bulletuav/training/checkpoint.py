"""Checkpoints: the complete training state of a model of stable-baselines3.

A checkpoint contains only arrays and numbers, and no pickled objects.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from safetensors import SafetensorError, safe_open
from safetensors.numpy import load_file

from bulletuav.errors import missing_extra
from bulletuav.parsing import parse_json
from bulletuav.policies.neural_network import HIGH, LOW, read_weights, write_weights
from bulletuav.policies.run import POLICY
from bulletuav.training.store import REPLAY, TRAINING

try:
    import torch
    from stable_baselines3.common.save_util import (
        recursive_getattr,
        recursive_setattr,
    )
except ImportError:
    raise missing_extra("training", "sb3") from None

COUNTERS = (
    "num_timesteps",
    "_n_updates",
    "_n_calls",
    "_episode_num",
    "_current_progress_remaining",
    "exploration_rate",
)
"""Counters of a model on which training depends, for the algorithms that have them"""


def save_checkpoint(model: Any, folder: Path) -> None:
    """Write a checkpoint of a model.

    Args:
        model: Model of any algorithm of stable-baselines3.
        folder: Folder for policy.safetensors (the policy), training.safetensors (optimizers,
            further variables, counters) and, if the algorithm has a replay buffer,
            replay.safetensors.

    Raises:
        OSError: If a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    # The policy file includes action bounds, so that inference does not need PyTorch
    space = model.action_space
    bounds = {LOW: space.low, HIGH: space.high} if isinstance(space, Box) else {}
    write_weights({**_arrays(model.policy.state_dict()), **bounds}, folder / POLICY)
    # Names of arrays: optimizer/index of the parameter/key of its state
    rest: dict[str, np.ndarray] = {}
    for name in _optimizers(model):
        for index, state in recursive_getattr(model, name).state_dict()["state"].items():
            rest |= {f"{name}/{index}/{key}": array for key, array in _arrays(state).items()}
    rest |= _arrays({name: recursive_getattr(model, name) for name in _variables(model)})
    counters = {name: getattr(model, name) for name in COUNTERS if hasattr(model, name)}
    write_weights(rest, folder / TRAINING, {"counters": json.dumps(counters)})
    buffer = getattr(model, "replay_buffer", None)
    if buffer is not None:
        write_weights(_rows(buffer), folder / REPLAY)


def restore_checkpoint(model: Any, folder: Path) -> None:
    """Restore a checkpoint into a new model of the same settings.

    Args:
        model: The new model.
        folder: Folder of the checkpoint.

    Raises:
        ValueError: If the files are damaged, or belong to a model of other settings.
    """
    try:
        _restore(model, folder)
    except (
        LookupError,
        TypeError,
        AttributeError,
        OSError,
        RuntimeError,
        ValueError,
        SafetensorError,
    ) as error:
        raise ValueError(
            f"{folder} holds no checkpoint of this run ({error}): choose another folder"
        ) from None


def _restore(model: Any, folder: Path) -> None:
    weights = read_weights(folder / POLICY)
    model.policy.load_state_dict(
        {name: torch.as_tensor(weights[name]) for name in model.policy.state_dict()}
    )
    rest = read_weights(folder / TRAINING)
    for name in _optimizers(model):
        optimizer = recursive_getattr(model, name)
        state = _states(rest, f"{name}/")
        optimizer.load_state_dict({**optimizer.state_dict(), "state": state})
    for name in _variables(model):
        recursive_setattr(model, f"{name}.data", torch.as_tensor(rest[name]))
    # Counters keep their types
    with safe_open(folder / TRAINING, "numpy") as file:
        counters = parse_json(file.metadata()["counters"], "its metadata")
    for name in COUNTERS:
        if hasattr(model, name):
            kind = type(getattr(model, name))
            setattr(model, name, kind(counters[name]))
    if getattr(model, "replay_buffer", None) is not None:
        _fill(model.replay_buffer, load_file(folder / REPLAY))


def _optimizers(model: Any) -> list[str]:
    """Return the names of the optimizers of a model."""
    return [name for name in model._get_torch_save_params()[0] if name != "policy"]


def _variables(model: Any) -> list[str]:
    """Return the names of the variables of a model outside its policy and optimizers."""
    names = model._get_torch_save_params()[1]
    return [name for name in names if recursive_getattr(model, name) is not None]


def _arrays(values: dict[str, Any]) -> dict[str, np.ndarray]:
    """Copy tensors and numbers to arrays: some tensors share memory."""
    return {
        name: np.array(torch.as_tensor(value).detach().cpu().numpy())
        for name, value in values.items()
    }


def _states(arrays: dict[str, np.ndarray], begin: str) -> dict[int, dict[str, Any]]:
    """Return optimizer state by parameter, from the arrays whose names start with `begin`.

    Integer scalars, the step counters of some optimizers, stay Python integers.
    """
    states: dict[int, dict[str, Any]] = {}
    for name, array in arrays.items():
        if name.startswith(begin):
            index, key = name.removeprefix(begin).split("/")
            is_step = array.ndim == 0 and array.dtype.kind == "i"
            value = int(array) if is_step else torch.as_tensor(array)
            states.setdefault(int(index), {})[key] = value
    return states


def _parts(buffer: Any) -> dict[str, np.ndarray]:
    """Return the arrays of a replay buffer by name, with one row for each transition.

    Image observations are stored in dicts of arrays.
    """
    parts: dict[str, np.ndarray] = {}
    for name, value in vars(buffer).items():
        inner = value if isinstance(value, dict) else {"": value}
        arrays = {key: array for key, array in inner.items() if isinstance(array, np.ndarray)}
        parts |= {f"{name}/{key}" if key else name: array for key, array in arrays.items()}
    return parts


def _rows(buffer: Any) -> dict[str, np.ndarray]:
    """Return the stored transitions of a replay buffer by name, and its write position."""
    place = {"position": np.array(buffer.pos), "full": np.array(buffer.full)}
    return place | {name: array[: buffer.size()] for name, array in _parts(buffer).items()}


def _fill(buffer: Any, kept: dict[str, np.ndarray]) -> None:
    """Fill an empty replay buffer with the transitions of `_rows`."""
    buffer.pos = int(kept["position"])
    buffer.full = bool(kept["full"])
    for name, array in _parts(buffer).items():
        array[: buffer.size()] = kept[name]
