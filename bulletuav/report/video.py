"""Video files, written by FFmpeg from the extra `video`."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from bulletuav.errors import missing_extra

FPS = 20
"""Frames per second"""


def save_video(path: Path, pictures: Iterator[np.ndarray]) -> None:
    """Write pictures as a video, with `FPS` frames per second.

    Args:
        path: A .mp4.
        pictures: At least one picture, (height, width, 3) uint8.

    Raises:
        ImportError: If the extra `video` is missing; the message names it.
        OSError: If the file cannot be written.
    """
    try:
        import imageio_ffmpeg
    except ImportError:
        raise missing_extra("writing a film (.mp4)", "video") from None
    first = next(pictures)
    count = 1
    writer = imageio_ffmpeg.write_frames(str(path), first.shape[1::-1], fps=FPS, macro_block_size=2)
    writer.send(None)
    writer.send(first)
    for picture in pictures:
        writer.send(picture)
        count += 1
    writer.close()
    # FFmpeg does not report a full disk.
    if imageio_ffmpeg.count_frames_and_secs(str(path))[0] < count:
        raise OSError("not all pictures were written; is the disk full?")
