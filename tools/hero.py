"""Draw the moving pictures of the README: the front page's replay, in light and dark.

    python tools/hero.py --out docs/images

It needs Chromium, and flies the flight that `benchmarks/gallery.py` calls that of the front page.
"""

import argparse
import base64
import io
import sys
import tempfile
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "benchmarks")]

import chromium  # noqa: E402
import gallery  # noqa: E402

from bulletuav.report import replay  # noqa: E402

SIZE = (720, 360)
"""Size that is filmed, pixels"""
KEPT_SIZE = (640, 320)
"""Size of the pictures, pixels; drawn smaller, edges are smooth and compress better"""
FRAMES = 48
INTERVAL = 0.25
"""Simulated time between frames, s"""
DURATION = 110
"""Duration of a frame, ms"""
TURN = 0.35
"""Angle by which the camera turns during the film, rad"""
PREPARE = f"""
document.body.classList.add("plain");
const parts = document.querySelectorAll("header, aside, footer, #tag");
for (const part of parts) part.style.opacity = 0;
replay.view.resize({SIZE[0]}, {SIZE[1]}, 0, 0);
replay.whole();
replay.view.zoom(0.55);
replay.set("reach", 4);
"""


def film(page: chromium.Page, theme: str, start: float) -> list[Image.Image]:
    """Return the frames of the replay in one theme."""
    page.tell(f"{PREPARE} replay.setTheme('{theme}'); replay.view.turn({-TURN / 2}, 0.06)")
    frames = []
    for k in range(FRAMES):
        page.tell(f"replay.seek({start + INTERVAL * k}); replay.view.turn({TURN / FRAMES}, 0)")
        page.tell("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        data = page.call("Page.captureScreenshot", format="png")["data"]
        frame = Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB")
        frames.append(frame.resize(KEPT_SIZE, Image.Resampling.LANCZOS))
    return frames


def main() -> None:
    """Fly, film and write both pictures."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="folder")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    recording, title = gallery.fly_front()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "replay.html")
        replay.write_replay(recording, title, path)
        for theme in ("light", "dark"):
            with chromium.Page(*SIZE) as page:
                page.open(path)
                first, *others = film(page, theme, start=1.0)
            first.save(
                out / f"hero_{theme}.webp",
                save_all=True,
                append_images=others,
                duration=DURATION,
                loop=0,
                quality=20,
                method=6,
            )
            print(f"wrote {out / f'hero_{theme}.webp'}")


if __name__ == "__main__":
    main()
