"""Animated GIFs, and video files, written by FFmpeg from the extra `video`."""

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from PIL import Image

from bulletuav.errors import missing_extra

FPS = 20
"""Frames per second"""
GIF_COLOURS = 127
"""Maximum number of colours of a GIF: fewer colours make smaller files"""


def save_gif(path: Path, pictures: Iterable[np.ndarray]) -> None:
    """Write pictures as an animated GIF that repeats, with `FPS` frames per second.

    Args:
        path: A .gif.
        pictures: At least one picture, (height, width, 4) uint8 and opaque, all of one size. A
            picture may be overwritten when the next one is requested.

    Raises:
        OSError: If the file cannot be written.
    """
    # Few pixels change between pictures: only these are kept and quantised.
    places: list[np.ndarray] = []
    colours: list[np.ndarray] = []
    for picture in pictures:
        pixels = np.ascontiguousarray(picture).view(np.uint32).ravel()
        if not places:
            shape, last = picture.shape[:2], ~pixels  # all pixels of the first picture change
        changed = np.flatnonzero(pixels != last)
        places.append(changed)
        colours.append(pixels[changed])
        last[changed] = colours[-1]
    # All frames share one palette. The octree quantizer is the fastest.
    rgb = np.concatenate(colours).view(np.uint8).reshape(1, -1, 4)[..., :3]
    quantised = Image.fromarray(np.ascontiguousarray(rgb)).quantize(
        GIF_COLOURS, Image.Quantize.FASTOCTREE
    )
    indices = np.asarray(quantised)[0]
    transparent = int(indices.max()) + 1
    palette = quantised.getpalette()
    assert palette is not None
    palette = [*palette[: 3 * transparent], 0, 0, 0]
    frames = []
    ends = np.cumsum([len(changed) for changed in places])[:-1]
    for changed, index in zip(places, np.split(indices, ends), strict=True):
        # Transparent pixels keep their colour, and compress well.
        frame = np.full(shape, transparent, dtype=np.uint8)
        frame.ravel()[changed] = index
        frames.append(Image.fromarray(frame))
        frames[-1].putpalette(palette)
    frames[0].save(
        path,
        save_all=True,
        append_images=frames[1:],
        duration=1000 // FPS,
        loop=0,
        transparency=transparent,
        optimize=False,
    )


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
