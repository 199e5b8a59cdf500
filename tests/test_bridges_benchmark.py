"""The benchmark of servers in real time: delays, memory, and tables."""

import csv
import importlib
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from programs import load_program

BENCHMARKS = Path(__file__).parent.parent / "benchmarks"


@pytest.fixture
def bridges(monkeypatch):
    """The benchmark's module, with vehicles that turn ten times a second."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    # Not by its name, which is also that of a folder of tests
    module = load_program(BENCHMARKS / "bridges.py")
    monkeypatch.setattr(module, "PERIOD", 0.1)
    yield module
    sys.modules.pop("bridge_clients", None)


@pytest.fixture
def make_clients(bridges):
    """Makes clients of vehicles that follow each command after a time, s, at twice real time."""

    reading = importlib.import_module("bridge_clients").Reading

    class Fake(bridges.Clients):
        command_hz, words = 50.0, ()

        def __init__(self, num_vehicles, delay):
            super().__init__(num_vehicles, 0)
            self.delay, self.turned = delay, {}
            self.sides = [1] * num_vehicles

        def connect(self): ...

        def send(self, k, side):
            if side != self.sides[k]:
                self.sides[k], self.turned[k] = side, time.perf_counter()

        def receive(self, seconds, watched):
            time.sleep(min(seconds, 0.001))
            now = time.perf_counter()
            return [
                reading(k, 2 * now, self.sides[k] * (1 if now >= turned + self.delay else -1))
                for k, turned in [(0, now), *self.turned.items()]
            ]

        def visit(self): ...

        def close(self): ...

    return Fake


def test_delays_are_those_from_commands_to_effects(bridges, make_clients):
    flight = bridges.fly(make_clients(2, 0.02), 0.5)
    assert flight.factor == pytest.approx(2.0, rel=1e-3)
    assert 2 <= len(flight.delays) <= 8
    assert 0.02 <= min(flight.delays) < 0.05
    assert flight.missed <= 1  # on a busy machine


def test_commands_without_an_effect_are_counted(bridges, make_clients):
    flight = bridges.fly(make_clients(1, 0.5), 0.5)
    assert flight.delays == []
    assert flight.missed >= 1


@pytest.mark.parametrize(("growth", "is_flat"), [(0.5, True), (2.0, False)])
def test_memory_is_judged_by_its_second_half(bridges, growth, is_flat):
    times = [10.0 * k for k in range(100)]
    memory = [300.0 - k if k < 50 else 250.0 + growth / 360 * k for k in range(100)]
    slope = bridges.Soak(times, memory).slope()
    assert slope == pytest.approx(growth)
    assert (slope < bridges.MAX_GROWTH) == is_flat


def test_the_table_of_a_page_is_replaced_and_nothing_else(bridges, tmp_path):
    page = tmp_path / "page.md"
    heads = ("a", "b")
    other = "| a | c |\n| ---: | ---: |\n| 5 | 6 |\n"
    table = bridges.make_table(heads, [["1", "2"], ["3", "4"]])
    page.write_text(f"Head.\n\n{table}\nMiddle.\n\n{other}")
    bridges.replace_table(page, heads, [["7", "8"]])
    table = "| a | b |\n| ---: | ---: |\n| 7 | 8 |\n"
    assert page.read_text() == f"Head.\n\n{table}\nMiddle.\n\n{other}"
    with pytest.raises(SystemExit, match="no table"):
        bridges.replace_table(page, ("x",), [])


@pytest.mark.slow
def test_a_short_soak_flies_all_servers(tmp_path):
    """Memory still grows in the first minute, so the exit code does not count."""
    log = tmp_path / "soak.csv"
    command = [sys.executable, BENCHMARKS / "bridges.py", "--soak", "40", "--log", log]
    found = subprocess.run(
        [*command, "--port", "27450"],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        timeout=400,
    )
    rows = [line.split("|")[1:-1] for line in found.stdout.splitlines()[2:5]]
    assert [row[0].strip() for row in rows] == ["airsim", "mavlink", "crazyflie"]
    for row in rows:
        assert int(row[6]) >= 30, row  # commands with an effect, of about 38
        assert int(row[8]) >= 1, row
    with log.open() as file:
        samples = list(csv.DictReader(file))
    assert len(samples) >= 2
    assert all(float(one["mavlink_mib"]) > 50 for one in samples)
