"""List the tests that take long, which the README's test command leaves out.

    python -m pytest -m "not slow" --durations=0 -vv > suite.txt
    python tools/lengthy_tests.py suite.txt

It writes the names of test functions whose cases take longer than `SECONDS` together to
`tests/lengthy.txt`; `tests/conftest.py` marks them. Of several logs, the longest durations count.
"""

import argparse
import collections
import re
from collections.abc import Sequence
from pathlib import Path

OUT = Path(__file__).parents[1] / "tests" / "lengthy.txt"
HEAD = """\
# Tests that take longer than {seconds:g} s, all cases together, on an idle core.
# The README's command leaves them out; `pytest -m lengthy` and .ci/run run them.
# Written by tools/lengthy_tests.py
"""
SECONDS = 0.7
KEPT = ("tests/test_digests.py", "tests/test_golden.py", "tests/test_readme.py::test_the_main")
"""Beginnings of names of tests that stay: the README's flight, and the bits of all tasks"""
WHOLE = (
    "tests/identification/test_identify.py",
    "tests/test_site.py",
    "tests/test_without_bullet.py",
)
"""Files whose tests share one lengthy fixture"""
DURATION = re.compile(r"^([\d.]+)s (?:call|setup|teardown) +([^\[\n]+)", re.MULTILINE)


def find_lengthy(logs: Sequence[str]) -> list[str]:
    """Return the names of lengthy test functions, and of files in `WHOLE`, sorted."""
    lengthy = set(WHOLE)
    for log in logs:
        seconds: collections.Counter[str] = collections.Counter()
        for duration, name in DURATION.findall(log):
            seconds[name.strip()] += float(duration)
        lengthy |= {name for name, total in seconds.items() if total > SECONDS}
    return sorted(
        name for name in lengthy if not name.startswith((*KEPT, *(f"{one}::" for one in WHOLE)))
    )


def main() -> None:
    """Write the list."""
    parser = argparse.ArgumentParser(description="List the tests that take long.")
    parser.add_argument("logs", nargs="+", type=Path, help="outputs of pytest as above")
    names = find_lengthy([log.read_text() for log in parser.parse_args().logs])
    OUT.write_text(HEAD.format(seconds=SECONDS) + "".join(f"{name}\n" for name in names))


if __name__ == "__main__":
    main()
