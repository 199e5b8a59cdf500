"""Hook of MkDocs for the documentation's site: tutorials are notebooks that the build runs.

The programs of a page are the cells of one notebook, run in order in a fresh folder. What a cell
prints and draws stands below it on the site, where the executed notebook can be downloaded, too.
The repository keeps the pages, without any output. An error in a cell is an error of the build.
"""

import base64
import functools
import re
import tempfile
from collections.abc import Iterator
from typing import Any

import nbformat
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from nbclient import NotebookClient
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

FOLDER = "tutorials/"
"""Where the tutorials are, below docs/"""
PROGRAM = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
RELATIVE = re.compile(r"(?<!!)\[([^\]]*)\]\((?!\w+:)[^)]*\)")
PATIENCE = 240
"""s that a cell may take; kernels are compiled in it"""


@functools.cache
def executed(texts: tuple[str, ...]) -> list[Any]:
    """Run the programs of pages, and give their notebooks with what they print and draw."""
    notebooks = [new_notebook(cells=list(cells_of(text))) for text in texts]
    with tempfile.TemporaryDirectory() as folder:
        joined = new_notebook()
        for notebook in notebooks:
            # One process runs all of them, as it takes seconds to begin. Each begins afresh.
            place = tempfile.mkdtemp(dir=folder)
            start = new_code_cell(f"%reset -f\n%matplotlib inline\n%cd -q {place}")
            joined.cells += [start, *notebook.cells]
        NotebookClient(joined, timeout=PATIENCE, coalesce_streams=True).execute()
    for cell in joined.cells:
        # What is said to the terminal, such as that something is compiled, is of this run alone.
        if cell.cell_type == "code":
            cell.outputs = [one for one in cell.outputs if one.get("name") != "stderr"]
    return notebooks


def cells_of(text: str) -> Iterator[Any]:
    """Split a page into the cells of a notebook: text and programs in turn."""
    for k, part in enumerate(PROGRAM.split(text)):
        # Links of the site lead nowhere from a file that was downloaded.
        make = new_code_cell if k % 2 else new_markdown_cell
        cell = make(part.rstrip() if k % 2 else RELATIVE.sub(r"\1", part))
        cell.id = f"cell-{k}"
        yield cell


def tutorials(files: Files) -> dict[str, Any]:
    """Give the executed notebooks, by the pages that they are of."""
    pages = [file for file in files.documentation_pages() if file.src_uri.startswith(FOLDER)]
    notebooks = executed(tuple(file.content_string for file in pages))
    return {file.src_uri: made for file, made in zip(pages, notebooks, strict=True)}


def drawn(notebook: Any) -> Iterator[tuple[int, bytes]]:
    """List the pictures of a notebook (PNG), each with the number of its cell."""
    for k, cell in enumerate(notebook.cells):
        for output in cell.get("outputs", ()):
            if picture := output.get("data", {}).get("image/png"):
                yield k, base64.b64decode(picture)


def printed(cell: Any) -> str:
    """Give what a cell printed, as a block of Markdown."""
    text = "".join(output.get("text", "") for output in cell.outputs).rstrip()
    return f'\n\n```text title="Output"\n{text}\n```\n' if text else ""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the notebook of each tutorial, and its pictures."""
    for uri, notebook in tutorials(files).items():
        name = uri.removesuffix(".md")
        content = nbformat.writes(notebook)
        files.append(File.generated(config, f"{name}.ipynb", content=content))
        for k, picture in drawn(notebook):
            files.append(File.generated(config, f"{name}_{k}.png", content=picture))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Write what each program printed and drew below it."""
    if not page.file.src_uri.startswith(FOLDER):
        return markdown
    notebook = tutorials(files)[page.file.src_uri]
    name = page.file.src_uri.removeprefix(FOLDER).removesuffix(".md")
    pictures = dict(drawn(notebook))
    texts = PROGRAM.split(markdown)
    for k, cell in enumerate(notebook.cells):
        if cell.cell_type == "code":
            texts[k] = f"```python\n{texts[k]}```" + printed(cell)
            if k in pictures:
                texts[k] += f"\n\n![What the program above draws]({name}_{k}.png)\n"
    texts.append(f"\n\n[This page as a notebook]({name}.ipynb){{download}}, with what it prints.\n")
    return "".join(texts)
