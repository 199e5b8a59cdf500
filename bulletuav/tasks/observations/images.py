"""Pictures as observations: stacks of frames, and images as convolutional networks take them."""

import math

import numpy as np
from gymnasium.spaces import Box

from bulletuav.compiled.kernel import kernel
from bulletuav.sensors.base import Image

ARRAY, IMAGE = "array", "image"
CAMERA_FORMATS = (ARRAY, IMAGE)
"""Values of the option `camera_format`"""
MAX_FRAMES = 64
"""Maximum number of frames of a stack"""


def frames_name(name: str) -> str:
    """Return the name of the reading that has the last frames of a picture."""
    return f"{name} frames"


def image_space(image: Image, size: tuple[int, int], num_frames: int, form: str) -> Box:
    """Return the space of one drone's picture.

    Args:
        image: Bounds and type of the picture.
        size: Width and height, pixels.
        num_frames: Number of frames K.
        form: "array" for ([K,] [cameras,] height, width[, numbers of a pixel]) of the picture's own
            type, or "image" for (height, width, channels) uint8.
    """
    width, height = size
    if form == IMAGE:
        channels = num_frames * math.prod(image.stack) * math.prod(image.pixel)
        return Box(0, 255, (height, width, channels), np.uint8)
    frames = () if num_frames == 1 else (num_frames,)
    shape = (*frames, *image.stack, height, width, *image.pixel)
    return Box(image.low, image.high, shape, image.dtype)


def to_images(pictures: np.ndarray, image: Image) -> np.ndarray:
    """Convert pictures of all drones to images from 0 to 255, channels last.

    Args:
        pictures: (W, N, [K,] [cameras,] height, width, ...).
        image: Bounds and type of the pictures; the bounds become 0 and 255.

    Returns:
        (W, N, height, width, channels) uint8, a new array; the channels are those of the oldest
        frame first, and in a frame those of the first camera.
    """
    if (image.dtype, image.low, image.high) != (np.uint8, 0, 255):
        scale = np.float32(255 / (image.high - image.low))
        scaled = (pictures.astype(np.float32) - np.float32(image.low)) * scale
        pictures = np.rint(scaled).astype(np.uint8)
    # Frames and cameras precede the axes of a picture
    frames = pictures.reshape(*pictures.shape[:2], -1, *_frame_shape(pictures, image))
    channels_last = np.moveaxis(frames, 2, 4)
    return np.array(channels_last).reshape(*channels_last.shape[:4], -1)


def _frame_shape(pictures: np.ndarray, image: Image) -> tuple[int, ...]:
    """Return the shape (height, width, ...) of one frame."""
    return pictures.shape[pictures.ndim - 2 - len(image.pixel) :]


def push_frames(
    frames: np.ndarray, picture: np.ndarray, mask: np.ndarray, steps: np.ndarray
) -> None:
    """Append the present pictures of drones to their last frames; the oldest frame is dropped.

    The first picture of an episode becomes all frames, as in Gymnasium's `FrameStackObservation`.

    Args:
        frames: (W, N, K, ...) frames, the oldest first; written.
        picture: (W, N, ...) present pictures.
        mask: (W, N) bool, drones that made a decision or were reset; others keep their frames.
        steps: (W,) decisions since the reset of each world.
    """
    _push_bytes(_as_bytes(frames, 3), _as_bytes(picture, 2), mask, steps)


def _as_bytes(array: np.ndarray, kept: int) -> np.ndarray:
    """Return a view as bytes, whose first `kept` axes are those of the array."""
    return array.reshape(*array.shape[:kept], -1).view(np.uint8)


@kernel
def _push_bytes(
    frames: np.ndarray, picture: np.ndarray, mask: np.ndarray, steps: np.ndarray
) -> None:
    """Append bytes (W, N, B) to frames (W, N, K, B); see `push_frames`."""
    last = frames.shape[2] - 1
    for w in range(mask.shape[0]):
        for i in range(mask.shape[1]):
            if not mask[w, i]:
                continue
            for k in range(last):
                for b in range(frames.shape[3]):
                    fresh = steps[w] == 0
                    frames[w, i, k, b] = picture[w, i, b] if fresh else frames[w, i, k + 1, b]
            for b in range(frames.shape[3]):
                frames[w, i, last, b] = picture[w, i, b]
