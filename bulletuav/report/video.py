"""Videos, written by FFmpeg, which the extra `video` brings."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from bulletuav.errors import missing_extra

FPS = 20
"""Pictures a second"""


def save_video(path: Path, pictures: Iterator[np.ndarray]) -> None:
    """Write pictures as a video, `FPS` a second.

    Args:
        path: A .mp4.
        pictures: At least one, (height, width, 3) uint8.

    Raises:
        ImportError: The extra `video` is missing; the message names it.
        OSError: The file cannot be written.
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
    # FFmpeg does not tell of a full disk.
    if imageio_ffmpeg.count_frames_and_secs(str(path))[0] < count:
        raise OSError("fewer pictures were written than there are; is the disk full?")
