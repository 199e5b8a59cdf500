"""Measure the style of Python sources: `python tools/style.py [FOLDER ...]`.

Prints for each folder, by default the package: tokens a line of code, share of lines over 100
characters, share of lines that are comments, share of annotated arguments, words a sentence in
docstrings, and lines of functions (median, 90 %, most).
"""

import ast
import io
import re
import statistics
import sys
import tokenize
from collections import Counter
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
"""Kinds of tokens that are no code"""
Function = ast.FunctionDef | ast.AsyncFunctionDef
SECTION = re.compile(
    r"^\s*(Args|Returns|Raises|Yields|Attributes|Example|Examples|Note|Source):\s*$", re.MULTILINE
)


def docstrings(tree: ast.AST) -> Iterator[ast.Constant]:
    """Yield the docstrings of a module, its classes and functions, and of attributes."""
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        for statement in body if isinstance(body, list) else ():
            match statement:
                case ast.Expr(value=ast.Constant(value=str()) as text):
                    yield text


def sentences(text: str) -> list[str]:
    """Split a docstring into sentences, without the lines of tables and code."""
    lines = [line.strip() for line in SECTION.sub("", text).splitlines()]
    prose = [
        line for line in lines if "  " not in line and not line.startswith((">>>", "|", "..."))
    ]
    blocks = re.split(r"\n\s*\n", "\n".join(prose))
    found = [
        re.sub(r"\s+", " ", sentence).strip()
        for block in blocks
        for sentence in re.split(r"(?<=[.!?])\s+", block)
    ]
    return [sentence for sentence in found if len(sentence.split()) > 1]


def count_lines(text: str, documentation: list[ast.Constant]) -> Counter[str]:
    """Count tokens and lines of code, and lines that are not empty, too wide, or comments.

    Args:
        text: Source of a file.
        documentation: Its docstrings, which are no code.

    Returns:
        Numbers of "tokens", "code", "lines", "wide" and "comments".
    """
    documented = {
        line
        for node in documentation
        for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }
    tokens = [
        token
        for token in tokenize.generate_tokens(io.StringIO(text).readline)
        if token.type not in SKIPPED and token.start[0] not in documented
    ]
    lines = [line for line in text.splitlines() if line.strip()]
    return Counter(
        tokens=len(tokens),
        code=len({token.start[0] for token in tokens}),
        lines=len(lines),
        wide=sum(len(line) > WIDEST for line in lines),
        comments=sum(line.lstrip().startswith("#") for line in lines),
    )


def count_arguments(function: Function) -> Counter[str]:
    """Count the "arguments" of a function, and those that are "annotated"; not self and cls."""
    arguments = [
        argument
        for argument in (
            *function.args.posonlyargs,
            *function.args.args,
            *function.args.kwonlyargs,
        )
        if argument.arg not in ("self", "cls")
    ]
    annotated = [argument for argument in arguments if argument.annotation is not None]
    return Counter(arguments=len(arguments), annotated=len(annotated))


def measure(folder: Path) -> dict[str, float]:
    """Measure all Python files below a folder."""
    counts: Counter[str] = Counter()
    lengths: list[int] = []  # lines of each function
    words: list[int] = []  # words of each sentence
    for path in sorted(folder.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        tree = ast.parse(text)
        documentation = list(docstrings(tree))
        counts += count_lines(text, documentation)
        for docstring in documentation:
            words += [len(sentence.split()) for sentence in sentences(str(docstring.value))]
        for node in ast.walk(tree):
            if isinstance(node, Function):
                lengths.append((node.end_lineno or node.lineno) - node.lineno + 1)
                counts += count_arguments(node)
    lengths.sort()
    return {
        "tokens a line": counts["tokens"] / counts["code"],
        "lines over 100, %": 100 * counts["wide"] / counts["lines"],
        "comment lines, %": 100 * counts["comments"] / counts["lines"],
        "annotated arguments, %": 100 * counts["annotated"] / max(counts["arguments"], 1),
        "words a sentence": statistics.fmean(words) if words else float("nan"),
        "function lines p50": lengths[len(lengths) // 2],
        "function lines p90": lengths[int(0.9 * len(lengths))],
        "function lines most": lengths[-1],
    }


def main() -> None:
    """Print the measures of each folder."""
    folders = [Path(name) for name in sys.argv[1:]] or [PACKAGE]
    for folder in folders:
        print(folder.name)
        for name, value in measure(folder).items():
            print(f"  {name:24}{value:8.1f}")


if __name__ == "__main__":
    main()
