"""The comparison with other simulators, as far as it goes without them."""

import csv
import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


def script(name):
    spec = importlib.util.spec_from_file_location(name, BENCHMARKS / f"{name}.py")
    sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(sys.modules[name])
    return sys.modules[name]


simulators = script("simulators")
compare = script("compare")  # which imports it
cities = script("cities")  # which imports compare
edge = script("edge")  # which imports both


@pytest.mark.slow
def test_without_peers_it_measures_the_floor_and_real_time(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(compare, "starts", lambda rounds: {"warm": 1.25, "cold": 12.5})
    compare.main(["--peers", "--rounds", "3", "--seconds", "0.01", "--out", str(tmp_path)])
    with open(tmp_path / "benchmark.csv") as file:
        rows = list(csv.DictReader(file))
    assert [row["against"] for row in rows] == ["the floor in C (floor, 64 x 8)", "real time"]
    assert all(float(row["ours"]) > 1000 for row in rows)
    assert float(rows[1]["theirs"]) == 240_000
    text = (tmp_path / "benchmark.md").read_text()
    assert text == capsys.readouterr().out
    assert "1.2 s with warm caches" in text
    with Image.open(tmp_path / "benchmark.png") as picture:
        assert picture.size[0] > 800


def test_medians_of_interleaved_rounds():
    class Fixed:
        def __init__(self, *rates):
            self.rates = iter(rates)

        def rate(self, case, seconds):
            return next(self.rates)

    one = compare.Comparison("a", "x", "peer", "y", "things/s", 2.0)
    row = compare.measure(
        one, {"bulletuav": Fixed(10.0, 40.0, 30.0), "peer": Fixed(5.0, 10.0, 3.0)}, 3, 1.0
    )
    assert (row.ours, row.theirs, row.ratio) == (30.0, 5.0, 4.0)


def test_every_case_of_ours_is_served_and_errors_are_told():
    server = compare.Server(sys.executable, "serve_bulletuav.py")
    cases = sorted({one.ours for one in compare.COMPARISONS} - {"bullet, 1000"})
    for case in cases[::3]:  # `benchmarks/compare.py` asks for all
        assert server.rate(case, 0.001) > 0
    with pytest.raises(RuntimeError, match="KeyError: 'nothing'"):
        server.rate("nothing", 0.001)
    assert server.rate("reset, 10", 0.001) > 0  # it goes on
    server.close()


@pytest.mark.slow
def test_a_simulator_that_is_not_there_is_left_out(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(compare, "starts", lambda rounds: {"warm": 1.0, "cold": 2.0})
    monkeypatch.setattr(
        compare, "install", lambda peer, folder: sys.executable
    )  # which has no VMAS
    compare.main(["--peers", "VMAS", "--rounds", "1", "--seconds", "0.01", "--out", str(tmp_path)])
    captured = capsys.readouterr()
    told = " ".join(captured.err.split())
    assert "left out: navigation, 64 x 8: its process ended with code 1" in told
    assert "ModuleNotFoundError: No module named 'vmas'" in told
    assert "VMAS" not in captured.out


@pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")
def test_a_peer_in_c_is_built_of_its_sources(tmp_path):
    """Sources of ours in the place of those of PufferLib: each decision counts up an action."""
    folder = tmp_path / "drone_swarm"
    folder.mkdir()
    (folder / "drone_swarm.h").write_text("""
#include <math.h>
#include <stdlib.h>
#include "raylib.h"
typedef struct {
    int num_agents, max_rings;
    float *observations, *actions, *rewards;
    unsigned char *terminals;
    Camera3D camera;
} DroneSwarm;
static float rndf(float low, float high) { return low + (high - low) * rand() / (float)RAND_MAX; }
void init(DroneSwarm *one) { one->rewards[0] = 0; }
void c_reset(DroneSwarm *one) { one->observations[0] = sqrtf(PI); }
void c_step(DroneSwarm *one) { one->rewards[0] += one->actions[0]; }
void c_close_client(Client *client) { DrawWhatNobodyHas(); }
""")
    given = (sys.executable, "serve_drone_swarm.py", str(tmp_path))
    server = compare.Server(*given)
    for case in {one.theirs for one in compare.COMPARISONS if one.peer == "drone_swarm"}:
        assert server.rate(case, 0.001) > 0
    server.close()
    (folder / "drone_swarm.h").write_text("void c_close_client(")
    server = compare.Server(*given)
    with pytest.raises(RuntimeError, match="gcc"):
        server.rate("single, 10 %", 0.001)
    server.close()


def test_environments_are_made_once(tmp_path, monkeypatch):
    commands = []

    def run(command, check):
        commands.append([str(word) for word in command])
        (tmp_path / "PyFlyt").mkdir(exist_ok=True)

    monkeypatch.setattr(subprocess, "run", run)
    for _ in range(2):
        assert compare.install("PyFlyt", tmp_path) == tmp_path / "PyFlyt" / "bin" / "python"
    assert [command[1:3] for command in commands] == [["-m", "venv"], ["-m", "pip"]]
    assert commands[1][-1] == "PyFlyt==0.29.0"


def test_a_folder_that_is_no_checkout(tmp_path, capsys):
    for peer, folder in compare.CHECKOUTS.items():
        with pytest.raises(SystemExit):
            compare.main([f"--{peer.replace('_', '-')}", str(tmp_path)])
        told = f"is no checkout of {peer}: it has no folder {folder}"
        assert told in capsys.readouterr().err
    for wrong in (["--rounds", "0"], ["--seconds", "-1"]):
        with pytest.raises(SystemExit):
            compare.main(wrong)
        assert "numbers above 0 are needed" in capsys.readouterr().err


def test_starts_measure_warm_and_cold(monkeypatch):
    folders = []
    monkeypatch.setattr(
        subprocess, "run", lambda command, check, env, cwd: folders.append(env["NUMBA_CACHE_DIR"])
    )
    assert set(compare.starts(2)) == {"warm", "cold"}
    assert len(folders) == 3
    assert len(set(folders)) == 1


@pytest.mark.slow
def test_cases_in_cities_are_served(tmp_path, capsys, monkeypatch):
    cases = [one for one in cities.comparisons() if one.theirs.rpartition(", ")[2] in ("1", "100")]
    server = compare.Server(sys.executable, "serve_bulletuav.py")
    for case in {one.ours for one in cases} | {
        one.theirs for one in cases if one.peer == cities.FLOOR
    }:
        assert server.rate(case, 0.001) > 0
    server.close()
    monkeypatch.setattr(cities, "install", lambda peer, folder: sys.executable)
    monkeypatch.setattr(cities, "comparisons", lambda: cases[:1])
    cities.main(["--rounds", "1", "--seconds", "0.01", "--out", str(tmp_path)])
    assert "rays of 60 m, 100 buildings" in capsys.readouterr().out
    assert (tmp_path / "cities.csv").stat().st_size > 0


def test_cases_of_edge_computing_are_served(tmp_path, capsys, monkeypatch):
    rows = edge.comparisons()
    assert [(one.theirs, one.goal) for one in rows[:-1]] == [
        (f"mec, {count}", 10.0) for count in (1, 1, 64, 64, 256, 256)
    ]
    alone = [one._replace(peer="real time") for one in rows if one.theirs == "mec, 1"]
    monkeypatch.setattr(edge, "install", lambda peer, folder: sys.executable)
    monkeypatch.setattr(edge, "comparisons", lambda: alone)
    edge.main(["--rounds", "1", "--seconds", "0.001", "--out", str(tmp_path)])
    assert capsys.readouterr().out == (tmp_path / "edge.md").read_text()
    with open(tmp_path / "edge.csv") as file:
        measured = {row["title"]: float(row["ours"]) for row in csv.DictReader(file)}
    assert list(measured) == [one.title for one in alone]  # none was left out
    assert min(measured.values()) > 0
