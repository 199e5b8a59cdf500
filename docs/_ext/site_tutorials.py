"""Sphinx extension: tutorials are notebooks that the build runs.

Pages show the outputs of their programs, and lead to the executed notebook. The environment
variable SKIP_TUTORIALS leaves this out, for a quick look at other pages.
"""

import os
from pathlib import Path
from typing import Any

import notebooks

IMAGES = "tutorial_outputs"
"""Folder of the pictures that programs draw, below docs/tutorials; not kept in the repository"""


def execute(app: Any, environment: Any, docnames: list[str]) -> None:
    """Run the tutorials once, before pages are read, and keep their pages with outputs."""
    app.tutorials = {}
    if os.environ.get("SKIP_TUTORIALS"):
        return
    pages = {
        path.stem: path.read_text("utf-8") for path in sorted(notebooks.TUTORIALS.glob("*.md"))
    }
    folder = notebooks.TUTORIALS / IMAGES
    folder.mkdir(exist_ok=True)
    for name, notebook in notebooks.execute(pages).items():
        text, pictures = notebooks.page_with_outputs(pages[name], notebook, name)
        for file, content in pictures.items():
            (folder / file).write_bytes(content)
            text = text.replace(f"]({file})", f"]({IMAGES}/{file})")
        # Notebooks are written after the pages: Markdown links to them would be unknown
        link = f'<a href="{name}.ipynb" download>Download the notebook</a>'
        text = text.replace(f"[Download the notebook]({name}.ipynb)", link)
        app.tutorials[name] = (text, notebook)


def show_outputs(app: Any, docname: str, source: list[str]) -> None:
    """Replace the text of a tutorial by that with outputs."""
    folder, _, name = docname.rpartition("/")
    if folder == "tutorials" and name in app.tutorials:
        source[0] = app.tutorials[name][0].replace("```output\n", "```text\n")


def write_notebooks(app: Any, error: Exception | None) -> None:
    """Write the executed notebooks next to their pages."""
    if error is None:
        for name, (_, notebook) in app.tutorials.items():
            path = Path(app.outdir, "tutorials", f"{name}.ipynb")
            path.write_text(notebooks.notebook_text(notebook), encoding="utf-8")


def setup(app: Any) -> dict[str, bool]:
    """Connect the extension."""
    app.connect("env-before-read-docs", execute)
    app.connect("source-read", show_outputs, priority=400)  # before links are replaced
    app.connect("build-finished", write_notebooks)
    return {"parallel_read_safe": False}
