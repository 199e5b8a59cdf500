"""Hook of MkDocs for the documentation's site: `mkdocs.yml` names it.

Pages link to files of the repository that are not below docs/, such as examples and sources. Each
of those becomes a page of the site below `source/`, so that links lead somewhere without a network:
Markdown as it is, a folder as a list of what is in it, anything else as a listing. A
link is followed from the pages that it leads to only where these are Markdown.

The reference is made of the table of public names in docs/project/releases.md: a page for each part of the
package, with an entry for each name, which mkdocstrings fills from the docstrings.
"""

import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[1]
LINK = re.compile(r"(?<=\]\()(?!\w+:|#)([^)#\s]+)(#[^)\s]*)?(?=\))")
CODE = re.compile(r"^```.*?^```$|`[^`\n]+`", re.MULTILINE | re.DOTALL)
ROW = re.compile(r"^\| `(bulletuav[\w.]*)` \| (.*) \|$", re.MULTILINE)
LANGUAGES = {".py": "python", ".toml": "toml", ".yaml": "yaml", ".urdf": "xml", ".c": "c"}
REFERENCE = "reference"
BUILT = "shipped"
"""Folder of machine code that `build_code.py` builds, which is no text"""


def public_names(text: str) -> dict[str, list[str]]:
    """Read the public names from the text of docs/project/releases.md, as "module.name" of each part."""
    parts: dict[str, list[str]] = {}
    for module, names in ROW.findall(text):
        part = (module + ".bulletuav").split(".")[1]
        parts.setdefault(part, []).extend(
            f"{module}.{name}" for name in re.findall(r"`(\w+)`", names)
        )
    return parts


def in_repository(uri: str) -> str:
    """Give the path in the repository of a page of the site."""
    if not uri.startswith("source/"):
        return f"docs/{uri}"
    path = uri.removeprefix("source/")
    # A listing is called by its file's name, with ".md" after it.
    return path if (ROOT / path).exists() else path.removesuffix(".md")


def in_site(path: str) -> str:
    """Give the page of the site that shows a file or a folder of the repository."""
    if path.startswith("docs/") and (ROOT / path).is_file():
        return path.removeprefix("docs/")
    return f"source/{path}" if path.endswith(".md") else f"source/{path}.md"


def targets(text: str, path: str) -> dict[str, str]:
    """Give the files of the repository that a page at `path` links to, by the link's text."""
    links = [link for link, _ in LINK.findall(CODE.sub("", text))]
    found = {
        link: posixpath.normpath(posixpath.join(posixpath.dirname(path), link)) for link in links
    }
    return {link: target for link, target in found.items() if (ROOT / target).exists()}


def show(path: str) -> str:
    """Write the page that shows a file or a folder of the repository."""
    place = ROOT / path
    if path.endswith(".md"):
        return place.read_text(encoding="utf-8")
    title = f"---\nsearch:\n  exclude: true\n---\n\n# `{path}`\n\n"
    if place.is_dir():
        shown = (one.name for one in place.iterdir() if not one.name.startswith((".", "_")))
        names = sorted(name for name in shown if name != BUILT)
        name = posixpath.basename(path)
        return title + "\n".join(f"- [{one}]({name}/{one})" for one in names)
    code = place.read_text(encoding="utf-8").rstrip()
    return f"{title}````{LANGUAGES.get(place.suffix, 'text')}\n{code}\n````\n"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the reference, and a page for each file outside docs/ that a page leads to."""
    releases = (ROOT / "docs" / "project" / "releases.md").read_text(encoding="utf-8")
    for part, names in public_names(releases).items():
        entries = "\n\n".join(f"::: {name}" for name in names)
        text = f"# {part}\n\n{entries}\n"
        files.append(File.generated(config, f"{REFERENCE}/{part}.md", content=text))
    waiting = [
        (f"docs/{file.src_uri}", file.content_string) for file in files.documentation_pages()
    ]
    while waiting:
        path, text = waiting.pop()
        for target in targets(text, path).values():
            uri = in_site(target)
            if files.get_file_from_path(uri) is None:
                content = show(target)
                files.append(File.generated(config, uri, content=content))
                waiting.append((target, content))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn links to files of the repository into links to their pages."""
    path = in_repository(page.file.src_uri)
    known = targets(markdown, path)
    start = posixpath.dirname(page.file.src_uri)

    def turned(match: re.Match[str]) -> str:
        link, anchor = match.groups()
        if link not in known:
            return match.group()
        return posixpath.relpath(in_site(known[link]), start) + (anchor or "")

    return LINK.sub(turned, markdown)
