"""Tutorials as notebooks: run the snippets of a page, and show their outputs below them.

Each ```python block and each ```bash block (commands of `bulletuav`) of a page is a cell. A Python
block whose first line is a comment with a file name (`# wedge.py`) is saved as that file. The block
that installs the package (```sh) becomes a cell that installs it where it is missing, such as in
Colab. A ```text block directly below a snippet is its output, for readers of the repository; pages
of the site and notebooks have the real output instead.

As a command, it runs the tutorials and writes their notebooks:

    python docs/_ext/notebooks.py --out DIR
"""

import argparse
import base64
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import nbformat
from nbclient import NotebookClient
from nbformat import NotebookNode
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

from bulletuav.version import REPOSITORY

TUTORIALS = Path(__file__).parents[1] / "tutorials"
"""Folder of the pages that are notebooks"""

BRANCH = "gh-pages"
"""Branch of the repository with the built site, which has the notebooks"""
PATIENCE = 1800
"""Maximum duration of a cell, s; the first cells compile functions"""

SNIPPET = re.compile(
    r"^```(python|bash|sh)\n(.*?)^```$(?:\n\n```text\n(.*?)^```$)?", re.MULTILINE | re.DOTALL
)
INSTALL = re.compile(r'^pip install "?(bulletuav(?:\[(\w+)\])?)"?$')
FILE = re.compile(r"# ([\w.-]+\.\w+)\n")
RELATIVE_LINK = re.compile(r"(?<!!)\[([^\]]*)\]\((?!\w+:)[^)]*\)")
MODULES = {"sb3": "stable_baselines3"}
"""A module of each extra that a tutorial needs"""

START = """\
%reset -f
%matplotlib inline
%cd -q FOLDER
def _run(line):
    import os, shlex, subprocess, sys
    plain = {name: text for name, text in os.environ.items() if name != "FORCE_COLOR"}
    plain.update(COLUMNS="80", NO_COLOR="1", TERM="dumb")
    done = subprocess.run(
        [sys.executable, "-m", *shlex.split(line)], env=plain, capture_output=True, text=True
    )
    if done.returncode:
        raise RuntimeError(done.stdout + done.stderr)
    print(done.stdout, end="")
"""
"""First cell of each page in the common kernel; `_run` runs a command and drops its messages"""


class Snippet(NamedTuple):
    """A program of a page.

    Attributes:
        kind: "python", "bash" or "install".
        code: Its lines, each of which ends with a newline.
        output: Output that the page states directly below it, None if there is none.
    """

    kind: str
    code: str
    output: str | None

    @property
    def file(self) -> str | None:
        """Name of the file that the code is saved as, None if the code is run."""
        match = FILE.match(self.code) if self.kind == "python" else None
        return match[1] if match else None


def split_page(text: str) -> Iterator[str | Snippet]:
    """Split a page into text and snippets, in order."""
    end = 0
    for match in SNIPPET.finditer(text):
        kind, code, output = match.groups()
        if kind == "sh" and not INSTALL.match(code.strip()):
            continue
        if between := text[end : match.start()].strip("\n"):
            yield between
        yield Snippet("install" if kind == "sh" else kind, code, output)
        end = match.end()
    if rest := text[end:].strip("\n"):
        yield rest


def execute(pages: dict[str, str]) -> dict[str, NotebookNode]:
    """Run the snippets of pages.

    One process runs all pages, since its start takes seconds. Each page starts with no variables
    and in an empty folder. Messages on stderr are dropped: they concern this run, such as the
    progress of the compilation.

    Args:
        pages: Text of each page by name.

    Returns:
        The notebook of each page, with outputs.

    Raises:
        nbclient.exceptions.CellExecutionError: If a snippet fails.
    """
    notebooks = {name: make_notebook(text) for name, text in pages.items()}
    with tempfile.TemporaryDirectory() as folder:
        # Cells of the kernel, which differ from those of the notebooks in how commands are run
        joined = new_notebook()
        shown: list[NotebookNode | None] = []
        for notebook in notebooks.values():
            start = START.replace("FOLDER", tempfile.mkdtemp(dir=folder))
            joined.cells.append(new_code_cell(start))
            shown.append(None)
            for cell in notebook.cells:
                if cell.cell_type == "code":
                    joined.cells.append(new_code_cell(_without_shell(cell.source)))
                    shown.append(cell)
        NotebookClient(joined, timeout=PATIENCE, coalesce_streams=True).execute()
    for ran, cell in zip(joined.cells, shown, strict=True):
        if cell is not None:
            cell.outputs = [one for one in ran.outputs if one.get("name") != "stderr"]
            cell.execution_count = None
    return notebooks


def make_notebook(text: str) -> NotebookNode:
    """Return the notebook of a page, without outputs."""
    notebook = new_notebook()
    notebook.metadata["kernelspec"] = {
        "display_name": "Python 3",
        "language": "python",
        "name": "python3",
    }
    notebook.metadata["language_info"] = {"name": "python"}
    for k, part in enumerate(split_page(text)):
        if isinstance(part, Snippet):
            cell = new_code_cell(_source(part).rstrip())
        else:
            # Links between pages lead nowhere from a downloaded file
            cell = new_markdown_cell(RELATIVE_LINK.sub(r"\1", part))
        cell.id = f"cell-{k}"
        notebook.cells.append(cell)
    return notebook


def page_with_outputs(text: str, notebook: NotebookNode, name: str) -> tuple[str, dict[str, bytes]]:
    """Write the outputs of each snippet below it, and links to the notebook below the title.

    Args:
        text: The page.
        notebook: Its notebook, from `execute`.
        name: Name of the page, from which the names of pictures and of the notebook are made.

    Returns:
        The page, with text outputs as ```output blocks, and the pictures (PNG) by file name.
    """
    parts: list[str] = []
    pictures: dict[str, bytes] = {}
    for k, (part, cell) in enumerate(zip(split_page(text), notebook.cells, strict=True)):
        if isinstance(part, str):
            parts.append(part)
            continue
        language = "sh" if part.kind == "install" else part.kind
        parts.append(f"```{language}\n{part.code}```")
        if part.file:
            continue  # its output says only that the file was written
        printed = "".join(output.get("text", "") for output in cell.outputs)
        if printed.strip():
            parts.append(f"```output\n{printed.rstrip()}\n```")
        for output in cell.outputs:
            if picture := output.get("data", {}).get("image/png"):
                file = f"{name}_{k}_{len(pictures)}.png"
                pictures[file] = base64.b64decode(picture)
                parts.append(f"![Picture drawn by the program above]({file})")
    title, _, rest = parts[0].partition("\n")
    parts[0] = f"{title}\n\n{links(name)}\n{rest}"
    return "\n\n".join(parts) + "\n", pictures


def links(name: str) -> str:
    """Return a line of Markdown with links to the notebook of a page."""
    place = REPOSITORY.removeprefix("https://github.com/")
    path = f"{place}/blob/{BRANCH}/tutorials/{name}.ipynb"
    colab = f"https://colab.research.google.com/github/{path}"
    return f"[Open in Colab]({colab}) | [Download the notebook]({name}.ipynb)"


def notebook_text(notebook: NotebookNode) -> str:
    """Return the content of the .ipynb file of a notebook."""
    nbformat.validate(notebook)
    content: str = nbformat.writes(notebook)
    return content + "\n"


def _source(snippet: Snippet) -> str:
    """Return the source of the cell of a snippet."""
    if snippet.kind == "install":
        return _install_source(snippet.code)
    if snippet.kind == "bash":
        return "".join(f"!{line}\n" for line in snippet.code.splitlines())
    if snippet.file:
        return f"%%writefile {snippet.file}\n{snippet.code}"
    return snippet.code


def _install_source(code: str) -> str:
    """Return the cell that installs the package where it is missing."""
    match = INSTALL.match(code.strip())
    assert match
    requirement, extra = match.groups()
    module = MODULES[extra] if extra else "bulletuav"
    # `%pip` takes no quotation marks
    return (
        "# In Colab, this installs the package in less than a minute\n"
        "import importlib.util\n\n"
        f'if not importlib.util.find_spec("{module}"):\n'
        f"    %pip install -q {requirement}\n"
    )


def _without_shell(source: str) -> str:
    """Return a cell with commands run by `_run`, which separates output from messages."""
    if source.startswith("%%"):
        return source
    return re.sub(r"^!(.*)$", lambda match: f"_run({match[1]!r})", source, flags=re.MULTILINE)


def main() -> None:
    """Run the tutorials and write their notebooks."""
    parser = argparse.ArgumentParser(description="Run the tutorials and write their notebooks.")
    parser.add_argument("--out", type=Path, default=Path("notebooks"), help="folder of the files")
    folder = parser.parse_args().out
    pages = {path.stem: path.read_text(encoding="utf-8") for path in sorted(TUTORIALS.glob("*.md"))}
    folder.mkdir(parents=True, exist_ok=True)
    for name, notebook in execute(pages).items():
        path = folder / f"{name}.ipynb"
        path.write_text(notebook_text(notebook), encoding="utf-8")
        print(f"wrote {path}")


if __name__ == "__main__":
    main()
