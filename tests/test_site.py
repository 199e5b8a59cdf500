"""The documentation's site builds without warnings, and all of it is there."""

import json
import os
import re
import runpy
import subprocess
import sys
from html import unescape
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
from test_public_names import listed
from waiting import LONG

import bulletuav

pytest.importorskip("material", reason="needs the extra docs")
pytest.importorskip("mkdocstrings", reason="needs the extra docs")
pytest.importorskip("nbclient", reason="needs the extra docs")

ROOT = Path(__file__).parents[1]
LOADED = {"img": "src", "script": "src", "iframe": "src", "source": "src", "link": "href"}
"""Tags whose attribute a browser fetches without being asked"""


class Reader(HTMLParser):
    """Collects what a page links to, what it loads, and the names that anchors have."""

    def __init__(self, page):
        super().__init__()
        self.links, self.loaded, self.anchors = [], [], set()
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        told = dict(attrs)
        self.anchors |= {told[name] for name in ("id", "name") if told.get(name)}
        if tag == "a" and told.get("href"):
            self.links.append(told["href"])
        # Relations between pages, such as the next one, are told and not fetched.
        if told.get(LOADED.get(tag)) and told.get("rel") not in ("canonical", "next", "prev"):
            self.loaded.append(told[LOADED[tag]])


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Folder of the site, built strictly, with proxies that answer nothing."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", folder]
    nowhere = dict.fromkeys(("http_proxy", "https_proxy", "all_proxy"), "http://127.0.0.1:9")
    told = subprocess.run(
        command, cwd=ROOT, env=os.environ | nowhere, capture_output=True, text=True, timeout=LONG
    )
    assert told.returncode == 0, told.stderr
    assert "WARNING  -" not in told.stderr
    return folder


@pytest.fixture(scope="module")
def pages(site):
    """What each page of the site holds; the page of errors is served from any address."""
    found = {page: Reader(page) for page in site.rglob("*.html") if page.name != "404.html"}
    assert len(found) > 100
    return found


def test_links_and_anchors_lead_somewhere(site, pages):
    checked, files = 0, {path for path in site.rglob("*") if path.is_file()}
    for page, reader in pages.items():
        for link in (*reader.links, *reader.loaded):
            target = urlsplit(link)
            if target.scheme or target.netloc:
                continue
            path = page
            if target.path:
                path = Path(os.path.normpath(f"{page.parent}/{unquote(target.path)}"))
            path = path if path in files else path / "index.html"
            assert path in files, f"{page.relative_to(site)}: {link}"
            # The theme itself writes "#" for buttons, and "#__..." for what a script makes.
            if target.fragment and path in pages:
                assert unquote(target.fragment) in pages[path].anchors, (
                    f"{page.relative_to(site)}: {link}"
                )
            checked += 1
    assert checked > 5000


def test_no_page_loads_anything_from_another_host(site, pages):
    for page, reader in pages.items():
        assert reader.loaded
        for link in reader.loaded:
            assert not urlsplit(link).netloc, f"{page.relative_to(site)}: {link}"
    for sheet in site.rglob("*.css"):
        text = sheet.read_text(encoding="utf-8")
        assert "url(http" not in text.replace('"', ""), sheet
        assert "url(//" not in text.replace('"', ""), sheet


def test_scripts_that_could_load_from_another_host_find_nothing_to_do(pages):
    # The theme has one for diagrams by Mermaid, which it fetches when a page has one.
    for page in pages:
        assert 'class="mermaid"' not in page.read_text(encoding="utf-8"), page


def test_lists_and_tables_are_shown_as_such(site, pages):
    """What is left of their signs tells of an indentation that the site reads in another way."""
    for page in pages:
        if page.is_relative_to(site / "source"):
            continue
        article = (
            page.read_text(encoding="utf-8").partition("<article")[2].partition("</article>")[0]
        )
        prose = re.sub(r"<(pre|code)\b.*?</\1>", "", article, flags=re.DOTALL)
        text = re.sub(r"<[^>]+>", "", prose)
        assert not re.search(r"^ *(\|.*\||- \S|\d+\. \S|```)", text, re.MULTILINE), page.name


def test_each_public_name_has_an_entry(site, pages):
    entries = {
        anchor
        for page, reader in pages.items()
        if page.parent == site / "reference"
        for anchor in reader.anchors
    }
    assert {f"{module}.{name}" for module, name in listed()} <= entries


@pytest.mark.parametrize(
    "page", sorted((ROOT / "docs" / "tutorials").glob("*.md")), ids=lambda page: page.stem
)
def test_tutorials_are_notebooks_that_ran(page, site):
    programs = re.findall(r"```python\n(.*?)\n```", page.read_text(), re.DOTALL)
    notebook = json.loads((site / "tutorials" / f"{page.stem}.ipynb").read_text())
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert ["".join(cell["source"]) for cell in cells] == programs != []
    html = (site / "tutorials" / f"{page.stem}.html").read_text()
    pictures = sorted((site / "tutorials").glob(f"{page.stem}_*.png"))
    for cell in cells:
        # Each prints or draws something, and the page shows it.
        (output,) = cell["outputs"]
        if output["output_type"] == "stream":
            assert output["name"] == "stdout"
            for line in output["text"]:
                assert unescape(html).count(line.strip()) >= 1
        else:
            assert f'src="{pictures.pop(0).name}"' in html
    assert pictures == []


def test_the_gallery_can_have_replays():
    """All of them take a minute: one is flown here, as its picture was."""
    hook = runpy.run_path(str(ROOT / "tools" / "site_gallery.py"))
    assert "<title>hover, " in hook["replay"]("hover")
    gallery = (ROOT / "docs" / "results" / "gallery" / "gallery.md").read_text()
    assert hook["PICTURE"].findall(gallery) == bulletuav.list_tasks()


def test_the_navigation_has_each_page_that_people_write():
    written = [page for page in (ROOT / "docs").rglob("*.md") if "results" not in page.parts]
    navigation = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:")[2].split()
    for page in written:
        assert page.relative_to(ROOT / "docs").as_posix() in navigation
