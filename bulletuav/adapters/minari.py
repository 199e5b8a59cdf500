"""Flights of a drone as a dataset of Minari; needs the extra `dataset`."""

import shutil
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from gymnasium.spaces import Space

from bulletuav.errors import missing

try:
    import h5py  # noqa: F401  # that Minari needs to write its usual format
    from minari import __version__
    from minari.data_collector.episode_buffer import EpisodeBuffer
    from minari.dataset.minari_storage import MinariStorage
except ImportError:
    raise missing("writing a dataset of Minari", "dataset") from None


class Flight(NamedTuple):
    """What one drone did in one episode of T decisions.

    Attributes:
        seed: That of the episode.
        observations: (T + 1, D).
        actions: (T, A), or (T,) choices.
        rewards: (T,).
        terminations: (T,) bool.
        truncations: (T,) bool.
        about: More that is told of the episode.
    """

    seed: int
    observations: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    terminations: np.ndarray
    truncations: np.ndarray
    about: Mapping[str, Any]


def write_minari(
    flights: Iterable[Flight],
    spaces: tuple[Space[Any], Space[Any]],
    about: Mapping[str, Any],
    name: str,
    root: Path,
) -> Path:
    """Write a dataset that `minari.load_dataset(name)` finds below `root`; replace an older one.

    Args:
        flights: The episodes, in their order.
        spaces: Of observations and of actions.
        about: What Minari tells of the dataset, such as "algorithm_name".
        name: Such as "crossing/orca/drone_0-v0".
        root: What the variable MINARI_DATASETS_PATH names where it is read.

    Returns:
        Its folder.
    """
    folder = root / name / "data"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    # Minari 0.5.4 loses its way from a relative path
    storage = MinariStorage.new(folder.resolve(), *spaces, data_format="hdf5")
    told = []

    def buffers() -> Iterator[EpisodeBuffer]:
        for flight in flights:
            told.append(dict(flight.about))
            yield EpisodeBuffer(None, flight.seed, None, *flight[1:-1])

    storage.update_episodes(buffers())  # in one go: each call opens the file anew
    storage.update_episode_metadata(told, range(len(told)))
    storage.update_metadata({"dataset_id": name, "minari_version": __version__, **about})
    return folder
