"""Random operations and faults on the whole interface; `python -m tests.simulation` does more."""

import subprocess
import sys
from pathlib import Path

import pytest
from simulation.at_work import OPERATIONS, WARNINGS
from simulation.invariants import Broken, attempt, require_clear, require_inside, resident
from simulation.run import drawn, run, shrink, table

import bulletuav

SEEDS = range(20)
SHORT = 6
"""How many of them are flown in any case, which draw all operations, too; the others are slow"""
EACH = 480
"""Operations of a seed: with the slow seeds and the runs that are repeated, 10,000 in all"""
ROOT = Path(__file__).parents[1]
PROGRAM = """
import sys, tempfile
from tests.simulation.run import run
with tempfile.TemporaryDirectory() as folder:
    print(run(int(sys.argv[1]), 100, folder).digest)
"""


@pytest.mark.parametrize(
    "seed", [*SEEDS[:SHORT], *(pytest.param(k, marks=pytest.mark.slow) for k in SEEDS[SHORT:])]
)
def test_all_that_should_hold_holds_after_each_operation(seed, tmp_path):
    outcome = run(seed, EACH, tmp_path)
    told = f"python -m tests.simulation --narrow --seed {seed} --operations {EACH} --each {EACH}"
    assert outcome.failure is None, f"{outcome.failure}\n{told}\n{table([outcome])}"
    assert sum(outcome.counts.values()) == EACH
    assert not list(tmp_path.iterdir())


def test_a_seed_gives_the_same_bits_again_and_in_another_process(tmp_path):
    outcomes = [run(3, 100, tmp_path) for _ in range(2)]
    before = resident()
    outcomes.append(run(3, 100, tmp_path))
    assert resident() - before < 30.0  # MB; environments come and go
    assert [one.failure for one in outcomes] == [None] * 3
    assert len({one.digest for one in outcomes}) == 1
    assert outcomes[0].digest != run(4, 100, tmp_path).digest
    told = subprocess.run(
        [sys.executable, "-c", PROGRAM, "3"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert told.stdout.split() == [outcomes[0].digest]


def test_seeds_draw_all_operations_on_all_slots():
    seen = {drawn(seed, number)[:2] for seed in SEEDS[:SHORT] for number in range(EACH)}
    assert {name for name, _ in seen} == set(OPERATIONS)
    assert {slot for _, slot in seen} == {0, 1, 2}
    assert all(len(text) > 10 for text in WARNINGS)


def test_a_failure_is_found_and_shrunk_to_the_few_operations_that_show_it(tmp_path, monkeypatch):
    """A bug that is put in: the counter goes on by two, as the first one that builds can tell."""
    decide = bulletuav.Aviary.decide

    def twice(self):
        decide(self)
        self.steps += self.steps > 3

    monkeypatch.setattr(bulletuav.Aviary, "decide", twice)
    found = next(one for one in (run(seed, 300, tmp_path) for seed in range(9)) if one.failure)
    assert "steps went from" in found.failure.what or "otherwise" in found.failure.what
    few = shrink(found.failure, found.ran, tmp_path, wide=False)
    assert few[-1] == found.failure.operation
    assert 2 <= len(few) <= 12
    again = run(found.seed, 0, tmp_path, only=few)
    assert again.failure.kind == found.failure.kind


def test_errors_that_are_no_help_are_told_from_clear_ones():
    def unclear():
        return [][1]

    def silent():
        raise ValueError("")

    for call in (unclear, silent):
        with pytest.raises(Broken, match="no clear error"):
            attempt(call)
    _, error = attempt(lambda: bulletuav.parallel_env("nonsense"))
    require_clear(error)
    with pytest.raises(Broken, match="took what cannot be"):
        attempt(bulletuav.list_tasks, must=True)
    with pytest.raises(Broken, match="refused what can be"):
        attempt(lambda: bulletuav.parallel_env("nonsense"), must=False)


def test_observations_that_are_outside_are_found():
    env = bulletuav.parallel_env("crossing", num_drones=2, dynamics="point_mass")
    space = env.observation_space("drone_0")
    observation = env.reset(seed=0)[0]["drone_0"]
    require_inside(space, observation)
    for wrong in (observation + 1e6, observation.astype(float), observation[:-1]):
        with pytest.raises(Broken, match="an observation"):
            require_inside(space, wrong)
    env.close()
