"""The documentation's site builds without warnings, works from a folder, and all of it is there."""

import json
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import chromium
import pytest
from test_public_names import listed
from waiting import LONG

import bulletuav

for module in ("furo", "myst_parser", "sphinx_external_toc", "nbclient"):
    pytest.importorskip(module, reason="needs the extra docs")

ROOT = Path(__file__).parents[1]
LOADED = {"img": "src", "script": "src", "iframe": "src", "source": "src", "link": "href"}
"""Tags whose attribute a browser fetches without a click"""


class Reader(HTMLParser):
    """Collects the links of a page, the files that it loads, and the names of its anchors."""

    def __init__(self, page):
        super().__init__()
        self.links, self.loaded, self.anchors = [], [], set()
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        self.anchors |= {values[name] for name in ("id", "name") if values.get(name)}
        if tag == "a" and values.get("href"):
            self.links.append(values["href"])
        # Relations between pages are not fetched
        if values.get(LOADED.get(tag)) and values.get("rel") not in (
            "next",
            "prev",
            "search",
            "index",
        ):
            self.loaded.append(values[LOADED[tag]])


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Folder of the site, built with warnings as errors, with proxies that answer nothing."""
    folder = tmp_path_factory.mktemp("site")
    options = ["-W", "--keep-going", "-q", "-b", "html", "-d", folder / "doctrees"]
    command = [sys.executable, "-m", "sphinx", *options, "docs", folder / "site"]
    nowhere = dict.fromkeys(("http_proxy", "https_proxy", "all_proxy"), "http://127.0.0.1:9")
    built = subprocess.run(
        command, cwd=ROOT, env=os.environ | nowhere, capture_output=True, text=True, timeout=LONG
    )
    assert built.returncode == 0, built.stderr[-5000:]
    return folder / "site"


@pytest.fixture(scope="module")
def pages(site):
    """A reader of each page of the site, except replays, which are checked as such."""
    found = {page: Reader(page) for page in site.rglob("*.html") if page.parent.name != "replays"}
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
            assert path in files, f"{page.relative_to(site)}: {link}"
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
        text = sheet.read_text(encoding="utf-8").replace('"', "")
        assert "url(http" not in text, sheet
        assert "url(//" not in text, sheet


def test_lists_and_tables_are_shown_as_such(site, pages):
    """Markdown signs that are left in a page show a list or table that was not recognised."""
    for page in pages:
        article = page.read_text("utf-8").partition("<article")[2].partition("</article>")[0]
        prose = re.sub(r"<(pre|code)\b.*?</\1>", "", article, flags=re.DOTALL)
        text = re.sub(r"<[^>]+>", "", prose)
        assert not re.search(r"^ *(\|.*\||- \S|\d+\. \S|```)", text, re.MULTILINE), page.name


def test_each_public_name_has_an_entry(site, pages):
    entries = [page.read_text("utf-8") for page in (site / "reference" / "api").glob("*.html")]
    for module, name in listed():
        assert any(f"{module}.{name}" in text for text in entries), (module, name)


def test_each_task_has_a_page_with_a_replay(site, pages):
    for name in bulletuav.list_tasks():
        assert f"../../replays/{name}.html" in "".join(
            pages[site / f"reference/tasks/{name}.html"].loaded
        )
    replays = list((site / "replays").glob("*.html"))
    assert {path.stem for path in replays} == {*bulletuav.list_tasks(), "front"}
    assert max(path.stat().st_size for path in replays) < 1e6


@pytest.mark.parametrize(
    "page", sorted((ROOT / "docs" / "tutorials").glob("*.md")), ids=lambda page: page.stem
)
def test_tutorials_have_their_notebooks(page, site):
    notebook = json.loads((site / "tutorials" / f"{page.stem}.ipynb").read_text())
    assert any(cell.get("outputs") for cell in notebook["cells"])


@pytest.mark.skipif(not chromium.found(), reason="there is no Chromium")
def test_search_and_replays_work_from_a_folder(site):
    with chromium.Page() as page:
        page.call("Page.navigate", url=f"{(site / 'search.html').as_uri()}?q=lidar")
        page.wait("document.querySelectorAll('#search-results li').length > 3")
        page.open(site / "replays" / "front.html")
        assert page.messages == []


def test_the_navigation_has_each_page(site, pages):
    """The front page lists the sections; a page that `_toc.yml` does not reach is a warning."""
    links = {urlsplit(link).path for link in pages[site / "index.html"].links}
    for name in (
        "start/install.html",
        "howto/index.html",
        "reference/index.html",
        "lab/index.html",
    ):
        assert name in links
