"""The suite that runs official examples of other projects: verdicts, keys, limits and the page."""

import importlib
import json
import os
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
TABLES = sorted((ROOT / "benchmarks" / "official").glob("*.yaml"))
SERVER = """
import pathlib, sys, time
print("ready at 127.0.0.1:4567", *sys.argv[1:], flush=True)
if pathlib.Path("complain").exists():
    print("call refused", flush=True)
time.sleep(60)
"""
GREETS = """
import os, sys
print("port", os.environ["PORT"], *sys.argv[1:])
print("typed", sys.stdin.readline().strip(), sys.stdin.isatty())
"""


@pytest.fixture
def suite(monkeypatch):
    """The benchmark's module."""
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    yield importlib.import_module("official_examples")
    sys.modules.pop("official_examples", None)


@pytest.fixture
def run(suite, tmp_path, monkeypatch):
    """Runs programs with a table's entries; returns exit code and page."""
    monkeypatch.setattr(suite, "KEY_INTERVAL", 0.05)
    server, folder = tmp_path / "server.py", tmp_path / "examples"
    server.write_text(SERVER)
    folder.mkdir()

    def run(programs, entries, **more):
        for name, text in programs.items():
            (folder / name).write_text(text)
        table = {
            "title": "Ours",
            "source": "https://example.org",
            "server": ["python", str(server)],
            "ready": r"ready at \S+:(?P<port>\d+)",
            "examples": entries,
            **more,
        }
        path, page = tmp_path / "ours.yaml", tmp_path / "page.md"
        path.write_text(json.dumps(table))
        words = [str(path), "--examples", str(folder), "--python", sys.executable]
        code = suite.main([*words, "--out", str(page)])
        assert sorted(one.name for one in folder.iterdir()) == sorted(programs)
        return code, page.read_text()

    return run


def test_examples_get_arguments_variables_and_keys(run):
    entry = {
        "arguments": ["to", "{port}"],
        "environment": {"PORT": "{port}"},
        "keys": ["yes\n"],
        "expect": "port 4567 to 4567\ntyped yes True",
    }
    code, page = run({"greets.py": GREETS}, {"greets.py": entry})
    assert code == 0
    assert "1 runs, 0 by design not, 0 its own fault, 0 fails" in page
    assert "| `greets.py` | runs |" in page


@pytest.mark.parametrize(
    ("program", "entry", "remark"),
    [
        ("raise ValueError('why')", {}, "ValueError: why"),
        ("import sys; sys.exit(3)", {}, "exit code 3"),
        ("print('a')", {"expect": "b"}, "it did not print 'b'"),
        ("while True: pass", {"limit": 0.3}, "it did not end in 0.3 s"),
        ("print('a')", {"endless": True}, "it ended"),
        ("print('a')", {"own_fault": "it is old", "shows": "x"}, "the table says: it is old"),
        ("print('x')", {"by_design": "no end", "hangs": True}, "the table says: no end"),
        ("raise ValueError('why')", {"by_design": "no end", "hangs": True}, "ValueError: why"),
        ("while True: pass",
         {"own_fault": "old", "shows": "x", "hangs": True, "limit": 0.3}, "did not end in 0.3 s"),
        ("int('x')", {"by_design": "no b", "shows": "KeyError"}, "ValueError"),
    ],
)  # fmt: skip
def test_what_the_table_does_not_expect_fails(program, entry, remark, run, capsys):
    code, page = run({"one.py": program}, {"one.py": entry})
    assert code == 1
    assert remark in page
    assert "not as the table says: one.py" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("program", "entry", "result"),
    [
        ("import time; time.sleep(60)", {"endless": True, "limit": 0.3}, "runs"),
        ("raise ValueError('why')", {"own_fault": "it is old", "shows": "why"}, "its own fault"),
        ("print(seen)", {"before": "import builtins\nbuiltins.seen = 'x'", "expect": "x"}, "runs"),
        ("import pathlib; print(pathlib.Path('f').read_text())",
         {"files": {"f": {"a": 1}}, "expect": '{"a": 1}'}, "runs"),
        ("import time; time.sleep(60)",
         {"by_design": "no end", "hangs": True, "limit": 0.3}, "by design not"),
    ],
)  # fmt: skip
def test_what_the_table_expects_passes(program, entry, result, run):
    code, page = run({"one.py": program}, {"one.py": entry})
    assert code == 0
    assert f"| `one.py` | {result} |" in page


def test_a_call_that_the_server_refuses_fails(run):
    entries = {"one.py": {"files": {"complain": ""}}}
    code, page = run({"one.py": "import time; time.sleep(0.2)"}, entries, forbid=["refused"])
    assert code == 1
    assert "call refused" in page
    code, _ = run({"one.py": "import time; time.sleep(0.2)"}, entries, forbid=["(?<!call) refused"])
    assert code == 0


def test_a_table_lists_files_that_exist_and_known_entries(run):
    with pytest.raises(ValueError, match=r"does not have other\.py"):
        run({"one.py": ""}, {"other.py": {}})
    with pytest.raises(ValueError, match=r"one\.py has limits: choose from .*limit"):
        run({"one.py": ""}, {"one.py": {"limits": 3}})


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"by_design": "no b"}, r"one\.py: by_design and own_fault need shows, or hangs"),
        ({"own_fault": "old"}, r"one\.py: by_design and own_fault need shows, or hangs"),
        ({"shows": "x"}, r"one\.py: shows and hangs have no effect without by_design"),
        ({"hangs": True}, r"one\.py: shows and hangs have no effect without by_design"),
        ({"own_fault": "old", "hangs": True, "endless": True}, "hangs and endless are given"),
    ],
)
def test_a_known_reason_has_evidence(entry, message, run):
    with pytest.raises(ValueError, match=message):
        run({"one.py": ""}, {"one.py": entry})


def test_a_table_can_add_to_another(suite, tmp_path):
    base = {"title": "a", "source": "b", "server": ["c"], "ready": "d", "examples": {"e.py": {}}}
    (tmp_path / "base.yaml").write_text(json.dumps(base))
    more = {"base": "base.yaml", "title": "x", "examples": {"f.py": {"limit": 1}}}
    (tmp_path / "more.yaml").write_text(json.dumps(more))
    table = suite.read_table(tmp_path / "more.yaml")
    assert (table.title, table.source) == ("x", "b")
    assert table.examples == {"e.py": {}, "f.py": {"limit": 1}}


def test_a_server_that_does_not_start_is_an_error(run):
    with pytest.raises(RuntimeError, match="did not start"):
        run({"one.py": ""}, {}, server=["python", "-c", "print('no')"])


@pytest.mark.parametrize("path", TABLES, ids=lambda path: path.stem)
def test_tables_are_valid(path, suite):
    table = suite.read_table(path)
    for name, entry in table.examples.items():
        suite.make(suite.Example, {**table.defaults, **entry}, name)


@pytest.mark.slow
@pytest.mark.parametrize("path", TABLES, ids=lambda path: path.stem)
def test_official_examples_do_what_the_table_says(path, suite):
    """EXAMPLES_AIRSIM is the folder of the examples, and PYTHON_AIRSIM the client's Python."""
    name = path.stem.upper()
    folder, python = os.environ.get(f"EXAMPLES_{name}"), os.environ.get(f"PYTHON_{name}")
    if folder is None or python is None:
        pytest.skip(f"EXAMPLES_{name} and PYTHON_{name} are not set")
    assert suite.main([str(path), "--examples", folder, "--python", python]) == 0
