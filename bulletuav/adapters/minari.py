"""Export of episodes of a drone as a Minari dataset; needs the extra `dataset`."""

import shutil
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from gymnasium.spaces import Space

from bulletuav.errors import missing_extra

try:
    import h5py  # noqa: F401  # which Minari needs for its default format
    from minari import __version__
    from minari.data_collector.episode_buffer import EpisodeBuffer
    from minari.dataset.minari_storage import MinariStorage
except ImportError:
    raise missing_extra("writing a dataset of Minari", "dataset") from None


class MinariEpisode(NamedTuple):
    """One episode of T decisions of one drone.

    Attributes:
        seed: Seed of the episode.
        observations: (T + 1, D) observations.
        actions: (T, A) actions, or (T,) discrete choices.
        rewards: (T,) rewards.
        terminations: (T,) bool.
        truncations: (T,) bool.
        about: Further metadata of the episode.
    """

    seed: int
    observations: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    terminations: np.ndarray
    truncations: np.ndarray
    about: Mapping[str, Any]


def write_minari(
    flights: Iterable[MinariEpisode],
    spaces: tuple[Space[Any], Space[Any]],
    about: Mapping[str, Any],
    name: str,
    root: Path,
) -> Path:
    """Write a dataset that `minari.load_dataset(name)` finds below `root`.

        An existing dataset of that name is replaced.

    Args:
        flights: The episodes in order.
        spaces: Observation space and action space.
        about: Metadata of the dataset, such as "algorithm_name".
        name: Name of the dataset, such as "crossing/orca/drone_0-v0".
        root: Root folder, the value of MINARI_DATASETS_PATH when the dataset is loaded.

    Returns:
        The folder of the dataset.
    """
    folder = root / name / "data"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    # Minari 0.5.4 fails with relative paths
    storage = MinariStorage.new(folder.resolve(), *spaces, data_format="hdf5")
    metadata = []

    def buffers() -> Iterator[EpisodeBuffer]:
        for flight in flights:
            metadata.append(dict(flight.about))
            yield EpisodeBuffer(None, flight.seed, None, *flight[1:-1])

    storage.update_episodes(buffers())  # one call for all: each call opens the file again
    storage.update_episode_metadata(metadata, range(len(metadata)))
    storage.update_metadata({"dataset_id": name, "minari_version": __version__, **about})
    return folder
