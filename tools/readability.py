"""Measure the sentences of pages: `python tools/readability.py [PAGE ...]`.

Prints for each page, by default the README, CONTRIBUTING.md and all below docs/ but results: words
a sentence in the mean, words of the longest sentence, and sentences; the worst page first. Code,
tables, pictures and headings are left out. `--long` also prints the sentences over the goal.
"""

import re
import statistics
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
GOAL = 20
"""Words a sentence that the mean of a page stays below"""
LEFT_OUT = re.compile(
    r"^(```|~~~).*?^\1[^\n]*$"  # programs
    r"|^ *\|[^\n]*"  # tables
    r"|^#[^\n]*"  # headings
    r"|^---\n.*?^---$"  # metadata
    r"|<[^>\n]*>"  # tags
    r"|!\[[^\]]*\]\([^)]*\)",  # pictures
    re.MULTILINE | re.DOTALL,
)
LINK = re.compile(r"\[([^\]]*)\]\([^)]*\)")
ITEM = re.compile(r"^\s*(?:[-*+]|\d+\.)\s+(?:\[.\] )?", re.MULTILINE)
SENTENCE_END = re.compile(r"(?<=[.!?:])[\"')*_]*\s+(?=[\W_]*[A-Z0-9`])")


def sentences(text: str) -> list[str]:
    """Split a page into sentences; a colon before a capital ends one, and so does a list's item."""
    prose = LINK.sub(r"\1", LEFT_OUT.sub("\n", text))
    blocks = re.split(r"\n\s*\n", ITEM.sub("\n\n", prose))
    blocks = [block for block in blocks if not re.match(r"\n*( {4}|\t)", block)]  # no code
    # A name or a command in code is one word, whatever stands in it.
    blocks = [re.sub(r"`[^`]*`", "`code`", re.sub(r"\s+", " ", block)) for block in blocks]
    found = [piece.strip() for block in blocks for piece in SENTENCE_END.split(block)]
    return [piece for piece in found if count_words(piece) > 1]


def count_words(sentence: str) -> int:
    """Count what holds a letter or a digit between spaces."""
    return sum(any(map(str.isalnum, word)) for word in sentence.split())


def default_pages() -> list[Path]:
    """Give the pages that people write; those of results are written by commands."""
    pages = [page for page in (ROOT / "docs").rglob("*.md") if "results" not in page.parts]
    return [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(pages)]


def measure(page: Path) -> list[int]:
    """Count the words of each sentence of a page."""
    return [count_words(sentence) for sentence in sentences(page.read_text(encoding="utf-8"))]


def main() -> None:
    """Print a line a page, the worst first."""
    names = [Path(name) for name in sys.argv[1:] if name != "--long"]
    rows = [(page, counts) for page in names or default_pages() if (counts := measure(page))]
    rows.sort(key=lambda row: -statistics.fmean(row[1]))
    print("  mean longest sentences  page")
    for page, counts in rows:
        name = page.resolve().relative_to(ROOT) if page.is_absolute() else page
        print(f"{statistics.fmean(counts):6.1f} {max(counts):7d} {len(counts):9d}  {name}")
        if "--long" in sys.argv:
            for sentence in sentences(page.read_text(encoding="utf-8")):
                if count_words(sentence) >= GOAL:
                    print(f"{count_words(sentence):10d}  {sentence}")


if __name__ == "__main__":
    main()
