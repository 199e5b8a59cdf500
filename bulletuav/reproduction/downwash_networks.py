"""Networks that predict downwash, by NDP-NMPC (J. Li et al., arXiv 2304.07794).

Their repository has the weights of networks that were trained on flights of two quadrotors; it does
not have the flights.
"""

import lzma
import zipfile
import zlib
from pathlib import Path

import numpy as np

from bulletuav.reproduction.flight_series import LogError

LAYER_SHAPES = ((128, 6), (128,), (64, 128), (64,), (128, 64), (128,), (3, 128), (3,))
"""Shapes of weights and biases, in the order of the file (nn_net.py of the repository)"""
UNREADABLE = (zipfile.BadZipFile, RuntimeError, OSError, EOFError, zlib.error, lzma.LZMAError)
"""Errors of `zipfile` for files that are damaged, encrypted, or compressed in unknown ways"""
NETWORK_FOLDER = "ndp_nmpc/scripts/dnwash_nn_est/nn_model"


def read_downwash_network(path: Path) -> list[np.ndarray]:
    """Read the weights of a network from a file of PyTorch, without its pickled part.

    Args:
        path: Zip file that has the numbers of each array, little-endian float32, in entries
            "data/0", "data/1", ...

    Returns:
        Arrays of the shapes `LAYER_SHAPES`.

    Raises:
        LogError: If the file is damaged or has other arrays.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            entries = {one.filename.rpartition("/data/")[2]: one for one in archive.infolist()}
            weights = []
            for k, shape in enumerate(LAYER_SHAPES):
                entry = entries.get(str(k))
                if entry is None or entry.file_size != 4 * int(np.prod(shape)):
                    raise LogError(
                        f"{path.name}: array {k} is not of shape {shape}; fetch the file again"
                    )
                numbers = np.frombuffer(archive.read(entry), "<f4").astype(float)
                weights.append(numbers.reshape(shape))
    except UNREADABLE as error:
        raise LogError(f"{path.name}: no file of PyTorch; fetch it again") from error
    if not all(np.isfinite(one).all() for one in weights):
        raise LogError(f"{path.name}: a weight is not finite; fetch the file again")
    return weights


def predict_downwash(weights: list[np.ndarray], relative: np.ndarray) -> np.ndarray:
    """Predict the force on a quadrotor next to another one.

    Args:
        weights: Result of `read_downwash_network`.
        relative: (N, 6) position (m) and velocity (m/s) of the other quadrotor, relative to it.

    Returns:
        Forces (N, 3), world axes, N.
    """
    values = relative
    for k in range(0, len(weights), 2):
        values = values @ weights[k].T + weights[k + 1]
        if k + 2 < len(weights):
            values = np.maximum(values, 0.0)
    return values
