"""Sphinx extension: links of pages to files of the repository outside docs/.

A page links to a source or an example by a relative path, which works in a checkout. On the site
the link leads to the repository.
"""

import posixpath
import re
from pathlib import Path

from sphinx.application import Sphinx

from bulletuav.version import REPOSITORY

ROOT = Path(__file__).parents[2]
CHANGELOG = "project/changelog"
"""Page that shows the whole changelog on the site"""
LINK = re.compile(r"(?<=\]\()(?!\w+:|#)([^)#\s]+)(#[^)\s]*)?(?=\))")


def replace_links(app: Sphinx, name: str, source: list[str]) -> None:
    """Replace links to files outside docs/ by links to the repository."""
    folder = posixpath.dirname(f"docs/{name}")
    if name == CHANGELOG:
        source[0] = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
        source[0] = LINK.sub(lambda match: posixpath.relpath(match[0], folder), source[0])

    def replaced(match: re.Match[str]) -> str:
        path = posixpath.normpath(posixpath.join(folder, match[1]))
        target = ROOT / path
        is_page = path.startswith("docs/") and not target.is_dir()
        if is_page or not target.exists():
            return match[0]
        kind = "tree" if target.is_dir() else "blob"
        return f"{REPOSITORY}/{kind}/main/{path}{match[2] or ''}"

    source[0] = LINK.sub(replaced, source[0])


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect the extension."""
    app.connect("source-read", replace_links)
    return {"parallel_read_safe": True}
