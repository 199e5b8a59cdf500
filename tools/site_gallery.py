"""Hook of MkDocs for the documentation's site: replays beside the pictures of the gallery.

Flying and writing them takes a minute, and 20 MB of the site, so that it is done only where
`REPLAYS` is set: `REPLAYS=1 python -m mkdocs build --strict`.
"""

import os
import re
import sys
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[1]
FOLDER = "results/gallery/"
PICTURE = re.compile(r"!\[A flight of (\w+)\]\(\w+\.png\)")


def replay(task: str) -> str:
    """Fly a task as in its picture, and give the page that replays it."""
    sys.path.append(str(ROOT / "benchmarks"))
    from gallery import fly

    from bulletuav.report import replay as replays

    recording, title = fly(task)
    return replays.render_page(title, replays.make_payload(recording, title))


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add a replay for each picture."""
    page = files.get_file_from_path(f"{FOLDER}gallery.md")
    if page is not None and os.environ.get("REPLAYS"):
        for task in PICTURE.findall(page.content_string):
            files.append(File.generated(config, f"{FOLDER}{task}.html", content=replay(task)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Write a link to its replay below each picture that has one."""

    def linked(match: re.Match[str]) -> str:
        name = f"{match.group(1)}.html"
        known = files.get_file_from_path(FOLDER + name)
        return match.group() + (f"\n\n[Turn this flight about]({name})" if known else "")

    return PICTURE.sub(linked, markdown) if page.file.src_uri.startswith(FOLDER) else markdown
