"""Settings of the documentation's site: `python -m sphinx -W -b html docs build/site`.

The site needs the extra `docs`. It loads nothing from another host and works from a folder, without
a server. Theme: Furo (https://pradyunsg.me/furo), on Sphinx. MkDocs and its theme Material are in
maintenance only, and their successor Zensical does not run Python extensions yet. Sphinx generates
the reference from the code, its search works by `file://`, and both are maintained.
"""

import sys
from pathlib import Path

DOCS = Path(__file__).parent
sys.path[:0] = [str(DOCS / "_ext"), str(DOCS.parent)]

from bulletuav.version import __version__  # noqa: E402

project = "bulletuav"
author = "The bulletuav authors"
project_copyright = f"{author}, MIT license"
version = release = __version__
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_external_toc",
    "site_reference",
    "site_reproduced",
    "site_links",
    "site_replays",
    "site_tutorials",
]
exclude_patterns = ["_ext", "results/leaderboard/rows"]
external_toc_path = "_toc.yml"

myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 4
myst_html_meta = {
    "description": "bulletuav: a drone-swarm gym on PyBullet for multi-agent research",
}
autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented_params"
autodoc_class_signature = "separated"
napoleon_use_ivar = True
copybutton_exclude = ".linenos, .gp, .go"
suppress_warnings = ["myst.header"]

html_theme = "furo"
html_title = "bulletuav"
html_favicon = "favicon.svg"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_js_files = [("site.js", {"defer": "defer"})]
html_copy_source = False
html_show_search_summary = False  # excerpts are fetched, which a folder does not allow
html_show_sphinx = False
html_theme_options = {
    "light_css_variables": {
        "color-brand-primary": "#3949ab",
        "color-brand-content": "#3949ab",
    },
    "dark_css_variables": {
        "color-brand-primary": "#9fa8da",
        "color-brand-content": "#9fa8da",
    },
}
pygments_style = "a11y-high-contrast-light"
pygments_dark_style = "a11y-high-contrast-dark"
