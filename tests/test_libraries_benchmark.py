"""The table of trainers of other libraries, here of clients that train nothing."""

import json
import sys
from pathlib import Path

import pytest
from programs import load_program

PROGRAM = Path(__file__).parents[1] / "benchmarks" / "libraries.py"


@pytest.fixture
def benchmark():
    return load_program(PROGRAM)


def write_client(folder, name, **changes):
    found = {"versions": {name: "1.2"}, "python": "3.11", "how": "PPO", "glue": 3, "worlds": 2}
    found |= {"share": 0.25, "training": 1234.0, **changes}
    (folder / f"{name}_client.py").write_text(f"print('noise')\nprint({json.dumps(found)!r})\n")


def test_rows_are_those_of_the_clients_and_others_stay(benchmark, tmp_path):
    page = tmp_path / "results" / "page.md"
    write_client(tmp_path, "zeta")
    write_client(tmp_path, "alpha")
    usual = ["--clients", str(tmp_path), "--out", str(page)]
    benchmark.main([f"zeta={sys.executable}", f"alpha={sys.executable}", *usual])
    write_client(tmp_path, "alpha", glue=7)
    benchmark.main([f"alpha={sys.executable}", *usual])
    rows = [line for line in page.read_text().splitlines() if line.startswith("| `")]
    assert [row.split(" | ")[:4] for row in rows] == [
        ["| `alpha`", "alpha 1.2, Python 3.11", "PPO", "7"],
        ["| `zeta`", "zeta 1.2, Python 3.11", "PPO", "3"],
    ]
    assert all(" | 0.25 | 1,234 | " in row for row in rows)
    write_client(tmp_path, "zeta", share=None)
    benchmark.main([f"zeta={sys.executable}", *usual])
    assert " | 2 | - | 1,234 | " in page.read_text()


def test_unknown_libraries_and_failures_are_errors(benchmark, tmp_path, capsys):
    usual = ["--clients", str(tmp_path), "--out", str(tmp_path / "page.md")]
    write_client(tmp_path, "alpha")
    with pytest.raises(ValueError, match="unknown library 'beta': choose from alpha"):
        benchmark.main([f"beta={sys.executable}", *usual])
    with pytest.raises(SystemExit):
        benchmark.main(["alpha", *usual])
    assert "write NAME=PYTHON" in capsys.readouterr().err
    (tmp_path / "bad_client.py").write_text("raise SystemExit(3)")
    with pytest.raises(Exception, match="exit status 3"):
        benchmark.main([f"bad={sys.executable}", *usual])
    assert not (tmp_path / "page.md").exists()
