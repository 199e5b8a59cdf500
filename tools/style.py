"""Measure the style of Python sources: `python tools/style.py [FOLDER ...]`, the package by default.

Prints for each folder: tokens a line of code, share of lines over 100 characters, share of lines that are comments,
share of annotated arguments, words a sentence in docstrings, and lines of functions (median, 90 %, most).
"""

import ast
import io
import re
import statistics
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "bulletuav"
WIDEST = 100
SKIPPED = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
    tokenize.ENCODING,
}
Function = ast.FunctionDef | ast.AsyncFunctionDef
SECTION = re.compile(
    r"^\s*(Args|Returns|Raises|Yields|Attributes|Example|Examples|Note|Source):\s*$", re.MULTILINE
)


def docstrings(tree: ast.AST) -> Iterator[ast.Constant]:
    """Yield the docstrings of a module, its classes and functions, and of attributes."""
    for node in ast.walk(tree):
        for one in (
            getattr(node, "body", None) if isinstance(getattr(node, "body", None), list) else ()
        ):
            if isinstance(one, ast.Expr) and isinstance(one.value, ast.Constant):
                if isinstance(one.value.value, str):
                    yield one.value


def sentences(text: str) -> list[str]:
    """Split a docstring into sentences, without the lines of tables and code."""
    prose = [line.strip() for line in SECTION.sub("", text).splitlines()]
    prose = [
        line for line in prose if "  " not in line and not line.startswith((">>>", "|", "..."))
    ]
    blocks = re.split(r"\n\s*\n", "\n".join(prose))
    found = [
        re.sub(r"\s+", " ", one).strip()
        for block in blocks
        for one in re.split(r"(?<=[.!?])\s+", block)
    ]
    return [one for one in found if len(one.split()) > 1]


def measure(folder: Path) -> dict[str, float]:
    """Measure all Python files below a folder."""
    tokens = code = lines = wide = comments = arguments = annotated = 0
    lengths: list[int] = []
    words: list[int] = []
    for path in sorted(folder.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        tree = ast.parse(text)
        texts = list(docstrings(tree))
        inside = {k for one in texts for k in range(one.lineno, (one.end_lineno or one.lineno) + 1)}
        found = list(tokenize.generate_tokens(io.StringIO(text).readline))
        kept = [one for one in found if one.type not in SKIPPED and one.start[0] not in inside]
        tokens += len(kept)
        code += len({one.start[0] for one in kept})
        rows = [row for row in text.splitlines() if row.strip()]
        lines += len(rows)
        wide += sum(len(row) > WIDEST for row in rows)
        comments += sum(row.lstrip().startswith("#") for row in rows)
        words += [len(one.split()) for text in texts for one in sentences(str(text.value))]
        for node in ast.walk(tree):
            if isinstance(node, Function):
                lengths.append((node.end_lineno or node.lineno) - node.lineno + 1)
                given = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
                given = [one for one in given if one.arg not in ("self", "cls")]
                arguments += len(given)
                annotated += sum(one.annotation is not None for one in given)
    lengths.sort()
    return {
        "tokens a line": tokens / code,
        "lines over 100, %": 100 * wide / lines,
        "comment lines, %": 100 * comments / lines,
        "annotated arguments, %": 100 * annotated / max(arguments, 1),
        "words a sentence": statistics.fmean(words) if words else float("nan"),
        "function lines p50": lengths[len(lengths) // 2],
        "function lines p90": lengths[int(0.9 * len(lengths))],
        "function lines most": lengths[-1],
    }


def main() -> None:
    """Print a table, one row a folder."""
    folders = [Path(name) for name in sys.argv[1:]] or [PACKAGE]
    for folder in folders:
        print(
            folder.name,
            *(f"  {name:24}{value:8.1f}" for name, value in measure(folder).items()),
            sep="\n",
        )


if __name__ == "__main__":
    main()
