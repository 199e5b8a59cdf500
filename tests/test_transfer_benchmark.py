"""The benchmark of trained policies elsewhere: latency, refused cases, and rows that are kept."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

import bulletuav
from bulletuav.dynamics import DYNAMICS
from bulletuav.policies.find import find_policy

BENCHMARKS = Path(__file__).parent.parent / "benchmarks"


@pytest.fixture
def transfer(monkeypatch):
    """The benchmark's module."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    yield importlib.import_module("transfer")
    sys.modules.pop("transfer", None)


def test_actions_are_flown_as_many_decisions_later_and_not_across_episodes(transfer):
    options = find_policy("trained", "hover").complete("hover", {"dynamics": "rigid_body"})
    aviary = bulletuav.Aviary("hover", 2, **options)
    late, prompt = transfer.late("hover", 2)(aviary), find_policy("trained", "hover")(aviary)
    rng = np.random.default_rng(0)
    width = len(aviary.observer.labels)
    seen = rng.normal(size=(7, 2, 1, width))
    chosen = [prompt.act(one, aviary.swarm) for one in seen]
    late.reset(np.array([True, True]))
    flown = [late.act(one, aviary.swarm) for one in seen[:4]]
    late.reset(np.array([False, True]))
    flown += [late.act(one, aviary.swarm) for one in seen[4:]]
    aviary.close()
    for world, sources in enumerate(([0, 0, 0, 1, 2, 3, 4], [0, 0, 0, 1, 4, 4, 4])):
        for k, source in enumerate(sources):
            np.testing.assert_array_equal(flown[k][world], chosen[source][world])


def test_conditions_that_are_refused_have_a_reason_and_no_number(transfer):
    row = transfer.measure("hover", "dynamics", "point_mass", 1)
    assert (row.mean, transfer.cell(row)) == ("", "-")
    assert "'point_mass' does not accept" in row.reason
    page = transfer.markdown([row._replace(value=name) for name in DYNAMICS], episodes=1)
    assert "`hover`, dynamics point_mass;" in page


@pytest.mark.filterwarnings("ignore:the package's policy")
def test_too_many_drones_for_their_starts_have_a_reason(transfer):
    row = transfer.measure("pursuit_evasion", "num_drones", 32, 1)
    assert (row.mean, transfer.cell(row)) == ("", "-")
    assert "no room" in row.reason


def test_rows_are_flown_once(transfer, tmp_path, monkeypatch):
    monkeypatch.setitem(transfer.AXES, "wind", (0.0, 1.0))
    calls = []
    measured = transfer.Row("hover", "wind", "0.0", "digest", "3", "0.500", "0.250", "0.750")

    def measure(task, axis, value, episodes):
        calls.append(value)
        return measured._replace(value=str(value), policy=transfer.digest(task))

    monkeypatch.setattr(transfer, "measure", measure)
    for _ in range(2):
        command = ["--tasks", "hover", "--axes", "wind", "--episodes", "3", "--out", str(tmp_path)]
        monkeypatch.setattr(sys, "argv", ["transfer.py", *command])
        transfer.main()
    assert calls == [0.0, 1.0]
    assert (
        "| `hover` | 0.50 [0.25, 0.75] | 0.50 [0.25, 0.75] |"
        in (tmp_path / "transfer.md").read_text()
    )
    assert (tmp_path / "transfer.png").stat().st_size > 1000
