"""Animated GIFs: what a viewer shows is what was drawn."""

import numpy as np
import pytest
from PIL import Image

from bulletuav.report.video import FPS, save_gif

SHADES = (0, 70, 140, 255)


def shown(path):
    """Pictures of a GIF, and their durations, ms."""
    pictures, durations = [], []
    with Image.open(path) as image:
        for k in range(image.n_frames):
            image.seek(k)
            durations.append(image.info["duration"])
            pictures.append(np.asarray(image.convert("RGB")))
    return pictures, durations


def opaque(colours):
    return np.concatenate([colours, np.full((*colours.shape[:2], 1), 255)], axis=-1).astype(
        np.uint8
    )


@pytest.mark.parametrize("changes", [0, 1, 40, 1200])
def test_a_gif_shows_its_pictures(tmp_path, changes):
    """However many pixels change between them."""
    rng = np.random.default_rng(changes)
    buffer = opaque(rng.choice(SHADES, (30, 40, 3)))
    drawn = []

    def pictures():
        for _ in range(6):
            drawn.append(buffer[..., :3].copy())
            yield buffer
            some = rng.choice(1200, changes, replace=False)
            buffer.reshape(-1, 4)[some, :3] = rng.choice(SHADES, (changes, 3))

    path = tmp_path / "some.gif"
    save_gif(path, pictures())
    found, durations = shown(path)
    assert sum(durations) == 6 * 1000 // FPS
    # Equal pictures are one frame
    kept = [0, *range(len(found) - 1)] if changes == 0 else range(6)
    np.testing.assert_array_equal(found, [drawn[k] for k in kept])


def test_a_colour_that_appears_late_is_shown(tmp_path):
    """The palette, which all frames share, has the colours of all of them."""
    white, red = (np.full((20, 20, 3), colour) for colour in ((255, 255, 255), (219, 20, 61)))
    mixed = np.where(np.arange(20)[:, None] < 1, red, white)
    path = tmp_path / "late.gif"
    save_gif(path, map(opaque, [white] * 5 + [mixed]))
    found, _ = shown(path)
    np.testing.assert_array_equal(found[-1], mixed)


def test_small_changes_make_small_files(tmp_path):
    noise = np.random.default_rng(0).choice(SHADES, (200, 200, 3))
    dots = [noise.copy() for _ in range(20)]
    for k, one in enumerate(dots):
        one[::50, ::50] = SHADES[k % 4]
    sizes = []
    for pictures in (dots[:1], dots):
        path = tmp_path / f"{len(pictures)}.gif"
        save_gif(path, map(opaque, pictures))
        sizes.append(path.stat().st_size)
    assert sizes[1] < 1.5 * sizes[0]
