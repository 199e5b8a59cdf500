"""The page of lost nodes, from rows of programs that start no cluster."""

import json
from pathlib import Path

import pytest
from programs import load_program

PROGRAM = Path(__file__).parents[1] / "benchmarks" / "cluster.py"
EVALUATION = [
    {"nodes": 0, "episodes": 50, "killed": [], "seconds": 1.4},
    {"nodes": 4, "episodes": 50, "killed": [10, 20, 40], "seconds": 9.6},
]
PHASES = {"before": 2, "runner killed": 5, "node killed": 3, "node added": 7, "restored": 4}


@pytest.fixture
def benchmark():
    return load_program(PROGRAM)


def write_client(folder, name, rows):
    lines = ["print('noise')", *(f"print({json.dumps(row)!r})" for row in rows)]
    (folder / f"{name}.py").write_text("\n".join(lines))


def test_the_page_has_the_rows_of_both_programs(benchmark, tmp_path, monkeypatch):
    page = tmp_path / "page.md"
    write_client(tmp_path, "ray_cluster", EVALUATION)
    write_client(tmp_path, "rllib_cluster", [{"nodes": 2, "iterations": PHASES, "seconds": 61.0}])
    monkeypatch.setattr(benchmark, "CLIENTS", tmp_path)
    monkeypatch.setattr(benchmark, "version", lambda _: "2.1.0")
    benchmark.main(["--losses", str(page)])
    text = page.read_text()
    rows = [line for line in text.splitlines() if line.startswith("|")]
    assert "| one process | 50 |  | 1 |  |" in rows
    assert "| 4 | 50 | 10, 20, 40 | 10 | the same bytes |" in rows
    assert "| 2 | 2 | 5 | 3 | 7 | 4 | 61 |" in rows
    assert "Ray 2.1.0" in text


def test_a_program_that_fails_leaves_the_page(benchmark, tmp_path, monkeypatch):
    page = tmp_path / "page.md"
    (tmp_path / "ray_cluster.py").write_text("raise SystemExit('other files')")
    monkeypatch.setattr(benchmark, "CLIENTS", tmp_path)
    with pytest.raises(benchmark.subprocess.CalledProcessError):
        benchmark.main(["--losses", str(page)])
    assert not page.exists()
