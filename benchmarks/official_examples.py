"""Run the official examples of another project, unmodified, against servers of this package.

    python benchmarks/official_examples.py benchmarks/official/airsim.yaml --examples FOLDER \
        --python CLIENT/bin/python --out docs/results/bridges/examples_airsim.md

FOLDER has the examples of the other project; nothing is fetched, and the folder is not changed:
each example runs in a copy. CLIENT is an environment with the project's client. Each example meets
a server of its own and has a time limit. The table (a YAML file) lists what examples need, and the
known reasons why some do not run; `Example` describes its entries. Files that it does not list run
with the defaults. The page lists all examples: runs, by design not, or the example's own fault.

The command fails if an example fails without a known reason, or runs in spite of one.
"""

import argparse
import contextlib
import itertools
import json
import os
import pty
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from datetime import date
from pathlib import Path
from typing import Any

import bulletuav
from bulletuav.files import replace_file
from bulletuav.parsing import read_yaml

KEY_INTERVAL = 1.0
"""Time between two texts that are typed, s"""
START_LIMIT = 900.0
"""Time that a server may take to start, which includes compilation, s"""
PROGRAMS = {"bulletuav": [sys.executable, "-m", "bulletuav"], "python": [sys.executable]}
"""Commands of servers by the first word"""
TIMED_OUT = "it did not end in"
"""Start of the problem of an example that was stopped at its time limit"""
RUNS, BY_DESIGN, OWN_FAULT, FAILS = "runs", "by design not", "its own fault", "fails"
LAUNCHER = "import runpy, sys\n{}\nrunpy.run_path(sys.argv[0], run_name='__main__')"
"""Program that executes statements before an example"""


@dataclass(frozen=True)
class Example:
    """Entry of a table: what an example needs, and what it is expected to do.

    Attributes:
        arguments: Arguments of the example. These, and values of `environment`, may contain
            `{name}` for the named groups of `Table.ready`.
        environment: Environment variables of the example.
        keys: Texts that are typed in turn, one each second, in a loop.
        before: Python statements that run in its process before it, such as the replacement of a
            window on a computer without a display. The page shows them. The folder of this
            package's bridges is in the environment variable BULLETUAV_BRIDGES.
        files: Files that are written next to it by their names: a text, or values to write as JSON.
        serve: More words of the server's command.
        limit: Time limit, s.
        endless: Whether the example never ends: it then runs if it still does at the time limit.
        expect: Text that the example prints if it succeeds.
        shows: Text that the example or its server prints if it fails for the known reason. An entry
            with a known reason has this text, `hangs`, or both.
        hangs: Whether it does not end in its time limit for the known reason.
        by_design: Why it cannot run with this package.
        own_fault: Why it cannot run anywhere.
        note: Remark for the page.
    """

    arguments: Sequence[str] = ()
    environment: Mapping[str, str] = field(default_factory=dict)
    keys: Sequence[str] = ("\n",)
    before: str = ""
    files: Mapping[str, Any] = field(default_factory=dict)
    serve: Sequence[str] = ()
    limit: float = 60.0
    endless: bool = False
    expect: str = ""
    shows: str = ""
    hangs: bool = False
    by_design: str = ""
    own_fault: str = ""
    note: str = ""

    def __post_init__(self) -> None:
        """Raise ValueError if any failure, or none, would be the known reason."""
        if self.reason and not self.shows and not self.hangs:
            raise ValueError("by_design and own_fault need shows, or hangs for the time limit")
        if not self.reason and (self.shows or self.hangs):
            raise ValueError("shows and hangs have no effect without by_design or own_fault")
        if self.hangs and self.endless:
            raise ValueError("hangs and endless are given: leave one out")

    @property
    def reason(self) -> str:
        """Known reason why it does not run; empty if it runs."""
        return self.by_design or self.own_fault


@dataclass(frozen=True)
class Table:
    """Table of the examples of a project.

    Attributes:
        title: Heading of the page.
        source: Address of the examples, for the page.
        server: Command of the server; "bulletuav" and "python" mean those of this environment.
        ready: Regular expression for the line that the server prints when it is ready.
        packages: Packages of the client whose versions the page lists.
        pattern: Files that are examples, such as "**/*.py".
        skip: Files that are no examples, by their names, with the reason.
        forbid: Regular expressions of lines that neither an example that runs nor its server
            prints.
        defaults: Entries of `Example` for all examples.
        examples: Entries of `Example` by file.
    """

    title: str
    source: str
    server: Sequence[str]
    ready: str
    packages: Sequence[str] = ()
    pattern: str = "*.py"
    skip: Mapping[str, str] = field(default_factory=dict)
    forbid: Sequence[str] = ("^Traceback ",)
    defaults: Mapping[str, Any] = field(default_factory=dict)
    examples: Mapping[str, Any] = field(default_factory=dict)

    def find(self, folder: Path) -> dict[str, Example]:
        """Return the examples of a folder by their names.

        Raises:
            ValueError: If the table lists a file that the folder does not have.
        """
        paths = (path.relative_to(folder).as_posix() for path in folder.glob(self.pattern))
        names = sorted(set(paths) - set(self.skip))
        if missing := sorted(set(self.examples) - set(names)):
            raise ValueError(f"{folder} does not have {', '.join(missing)}, which the table lists")
        return {
            name: make(Example, {**self.defaults, **self.examples.get(name, {})}, name)
            for name in names
        }


@dataclass(frozen=True)
class Outcome:
    """Result of an example.

    Attributes:
        name: File of the example.
        result: One of the four results.
        seconds: Duration, s.
        remark: Reason of a failure, or how the example ran.
        is_expected: Whether the table expects the result.
    """

    name: str
    result: str
    seconds: float
    remark: str
    is_expected: bool


def make(kind: type, values: Any, where: str) -> Any:
    """Create an entry of a table; raise ValueError with its place if its values are invalid."""
    known = {one.name for one in fields(kind)}
    if unknown := sorted(set(values) - known):
        raise ValueError(
            f"{where} has {', '.join(unknown)}: choose from {', '.join(sorted(known))}"
        )
    try:
        return kind(**values)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None


def read_table(path: Path) -> Table:
    """Read a table; one with a `base` adds to the table of another file, or changes it."""
    values = read_yaml(path)
    if base := values.pop("base", None):
        before = read_yaml(path.parent / base)
        examples = {**before["examples"], **values.get("examples", {})}
        values = {**before, **values, "examples": examples}
    return make(Table, values, str(path))


def run_example(
    table: Table, name: str, example: Example, folder: Path, python: str, logs: Path | None = None
) -> Outcome:
    """Run an example against a new server, and judge it.

    Args:
        table: Table of the project.
        name: File of the example, relative to the folder.
        example: Its entry.
        folder: Folder of the examples.
        python: Python of the client's environment.
        logs: Folder that what the example and the server print is copied to.
    """
    with tempfile.TemporaryDirectory() as place:
        work = Path(place, "examples")
        shutil.copytree(folder, work)
        home = (work / name).parent
        for file, content in example.files.items():
            (home / file).write_text(content if isinstance(content, str) else json.dumps(content))
        printed, log = Path(place, "printed.txt"), Path(place, "server.txt")
        with serve([*table.server, *example.serve], table.ready, home, log) as (server, groups):
            started = time.monotonic()
            code = fly(Path(name).name, example, home, python, printed, groups)
            seconds = time.monotonic() - started
            problem = "" if server.poll() is None else "the server ended"
        text = printed.read_text(errors="replace")
        everything = text + log.read_text(errors="replace")
        if logs is not None:
            logs.mkdir(parents=True, exist_ok=True)
            (logs / f"{name.replace('/', '_')}.txt").write_text(everything)
    problem = problem or find_problem(table, example, code, text, everything)
    return judge(name, example, seconds, problem, everything)


def fly(
    name: str, example: Example, home: Path, python: str, printed: Path, groups: Mapping[str, str]
) -> int | None:
    """Run an example in a folder, and type its keys.

    Returns:
        Exit code; None if the example was stopped at the time limit.
    """
    arguments = [word.format(**groups) for word in example.arguments]
    launcher = ["-c", f"import sys\nsys.argv = sys.argv[1:]\n{LAUNCHER.format(example.before)}"]
    # Temporary files of examples are removed with the copy, and its client is not to find ours
    changes = {"TMPDIR": str(home), "PYTHONUNBUFFERED": "1", "MPLBACKEND": "Agg"}
    changes["BULLETUAV_BRIDGES"] = str(Path(bulletuav.__file__).parent / "bridges")
    kept = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    own = {key: str(value).format(**groups) for key, value in example.environment.items()}
    # Examples that wait for a key need a terminal
    keyboard, terminal = pty.openpty()
    with printed.open("wb") as file, contextlib.ExitStack() as stack:
        stack.callback(os.close, keyboard)
        process = subprocess.Popen(
            [python, *(launcher if example.before else ()), name, *arguments],
            cwd=home, stdin=terminal, stdout=file, stderr=file, start_new_session=True,
            env={**kept, **changes, **own},
        )  # fmt: skip
        os.close(terminal)
        end = time.monotonic() + example.limit
        try:
            for key in itertools.cycle(example.keys or ("",)):
                left = end - time.monotonic()
                with contextlib.suppress(subprocess.TimeoutExpired):
                    return process.wait(min(KEY_INTERVAL, max(left, 0.0)))
                if left <= KEY_INTERVAL:
                    return None
                os.write(keyboard, key.encode())
        finally:
            # Some examples start processes of their own
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    raise AssertionError("a cycle does not end")


@contextlib.contextmanager
def serve(
    words: Sequence[str], ready: str, folder: Path, log: Path
) -> Iterator[tuple[subprocess.Popen, dict[str, str]]]:
    """Run a server within a `with` block.

    Args:
        words: Command.
        ready: Regular expression of the line that is printed when the server is ready.
        folder: Folder that the server runs in.
        log: File for what it prints.

    Yields:
        The process, and the named groups of the regular expression.

    Raises:
        RuntimeError: If the server does not start.
    """
    command = [*PROGRAMS.get(words[0], [words[0]]), *words[1:]]
    with log.open("wb") as file:
        process = subprocess.Popen(command, cwd=folder, stdout=file, stderr=file)
    try:
        end = time.monotonic() + START_LIMIT
        while (found := re.search(ready, log.read_text(errors="replace"))) is None:
            if process.poll() is not None or time.monotonic() > end:
                text = log.read_text(errors="replace")
                raise RuntimeError(f"{shlex.join(words)} did not start:\n{text}")
            time.sleep(0.1)
        yield process, found.groupdict()
    finally:
        process.terminate()
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def find_problem(
    table: Table, example: Example, code: int | None, text: str, everything: str
) -> str:
    """Return why an example did not succeed; empty if it did.

    Args:
        table: Table of the project.
        example: Entry of the example.
        code: Its exit code, or None.
        text: What it printed.
        everything: What it and the server printed.
    """
    if code is None and not example.endless:
        return f"{TIMED_OUT} {example.limit:g} s"
    for line in everything.splitlines():
        if any(re.search(pattern, line) for pattern in table.forbid):
            is_traceback = line.startswith("Traceback")
            return text.strip().splitlines()[-1] if is_traceback and text.strip() else line
    if code:
        return f"exit code {code}: {(text.strip().splitlines() or ['it printed nothing'])[-1]}"
    if code is not None and example.endless:
        return "it ended"
    return "" if example.expect in text else f"it did not print {example.expect!r}"


def judge(name: str, example: Example, seconds: float, problem: str, text: str) -> Outcome:
    """Compare the problem of an example, or an empty text, with its entry."""
    reason = example.reason
    if not problem:
        stopped = "it has no end; stopped" if example.endless else ""
        before = (
            f"`{'; '.join(example.before.strip().splitlines())}` before" if example.before else ""
        )
        words = "; ".join(filter(None, (example.note, stopped, before)))
        remark = f"the table says: {reason}" if reason else words
        return Outcome(name, RUNS, seconds, remark, not reason)
    is_known = example.shows in text and (not example.hangs or problem.startswith(TIMED_OUT))
    if reason and is_known:
        kind = BY_DESIGN if example.by_design else OWN_FAULT
        return Outcome(name, kind, seconds, reason, True)
    return Outcome(name, FAILS, seconds, problem, False)


def write_page(
    table: Table, outcomes: Sequence[Outcome], versions: str, command: str, day: date
) -> str:
    """Return the page of the results."""
    counts = ", ".join(
        f"{sum(one.result == kind for one in outcomes)} {kind}"
        for kind in (RUNS, BY_DESIGN, OWN_FAULT, FAILS)
    )
    lines = [
        f"# {table.title}",
        "",
        f"[These examples]({table.source}) ran unmodified, each against a server of its own:",
        f"{counts}.",
        "",
        f"`{command}`, {day:%B} {day.day}, {day.year}, {versions}.",
        "",
        "| example | result | s | remarks |",
        "| --- | --- | ---: | --- |",
    ]
    lines += [
        f"| `{one.name}` | {one.result} | {one.seconds:.0f} | {escape(one.remark)} |"
        for one in outcomes
    ]
    if table.skip:
        lines += ["", "Files that are no examples: "]
        lines[-1] += "; ".join(f"`{name}` ({reason})" for name, reason in table.skip.items()) + "."
    return "\n".join([*lines, ""])


def escape(text: str) -> str:
    """Return a text for a cell of a table."""
    return text.replace("|", "\\|").replace("\n", " ")


def read_versions(python: str, packages: Sequence[str]) -> str:
    """Return the versions of Python and of packages in an environment."""
    program = (
        "import sys, platform; from importlib.metadata import version as v\n"
        "print(', '.join(['Python ' + platform.python_version(), "
        "*(f'{name} {v(name)}' for name in sys.argv[1:])]))"
    )
    done = subprocess.run(
        [python, "-c", program, *packages], check=True, capture_output=True, text=True
    )
    return done.stdout.strip()


def main(words: Sequence[str] | None = None) -> int:
    """Run the examples of a table and write the page; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("table", type=Path, help="YAML file with the known reasons")
    parser.add_argument("--examples", type=Path, required=True, help="folder of the examples")
    parser.add_argument("--python", required=True, help="Python with the client installed")
    parser.add_argument("--only", nargs="+", metavar="FILE", help="some examples; writes no page")
    parser.add_argument("--out", type=Path, help="page to write")
    parser.add_argument("--logs", type=Path, help="folder for what examples and servers print")
    given = parser.parse_args(words)
    # So that servers end, too
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    table = read_table(given.table)
    examples = table.find(given.examples)
    # A relative path would be one of the example's folder; links stay, as in an environment
    python = os.path.abspath(given.python)
    versions = read_versions(python, table.packages)
    outcomes = []
    for name in given.only or examples:
        if name not in examples:
            parser.error(f"no example {name}: choose from {', '.join(examples)}")
        one = run_example(table, name, examples[name], given.examples, python, given.logs)
        outcomes.append(one)
        print(f"{one.name}: {one.result}, {one.seconds:.0f} s. {one.remark}", flush=True)
    if given.out is not None and not given.only:
        command = f"python benchmarks/official_examples.py benchmarks/official/{given.table.name}"
        replace_file(given.out, write_page(table, outcomes, versions, command, date.today()))
    surprises = [one.name for one in outcomes if not one.is_expected]
    if surprises:
        print(f"not as the table says: {', '.join(surprises)}")
    return int(bool(surprises))


if __name__ == "__main__":
    sys.exit(main())
