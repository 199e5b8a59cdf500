"""Tables of docs/benchmarks/conflict.md: their commands flew them, and fly the same again."""

import csv
import re
import shlex
import sys
from pathlib import Path

import pytest

import bulletuav

DOCS = Path(__file__).parents[1] / "docs"
sys.path.append(str(DOCS / "_ext"))
import site_reference  # noqa: E402

PAGE = (DOCS / "benchmarks" / "conflict.md").read_text()
AVOIDANCE = DOCS / "results" / "avoidance" / "leaderboard.md"
CAPTURES = DOCS / "results" / "pursuit_evasion"


def read(path):
    """Rows of a csv file."""
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def cells(line):
    """Cells of a row of a table in markdown."""
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_the_table_of_policies_is_that_of_its_command():
    (command,) = re.findall(r"bulletuav compare .*--out docs/results/avoidance", PAGE)
    words = shlex.split(command)
    asked = {name: words[words.index(f"--{name}") + 1] for name in ("tasks", "policies")}
    episodes = words[words.index("--episodes") + 1]
    rows = list(site_reference.read_leaderboard(AVOIDANCE))
    assert {(row["difficulty"], row["dynamics"]) for row in rows} == {("medium", "bullet")}
    assert {row["episodes"] for row in rows} == {episodes}
    assert set(re.findall(r"(?m)^## .* seeds (\d+) to", AVOIDANCE.read_text())) == {"0"}
    found = {(row["task"], row["policy"]): row for row in rows}
    (table,) = re.findall(r"\| policy \| `crossing`.*?(?=\n\n)", PAGE, re.DOTALL)
    head, _, *lines = table.splitlines()
    tasks = [cell.strip("`") for cell in cells(head)[1:]]
    assert tasks == asked["tasks"].split(",")
    assert [cells(line)[0].strip("`") for line in lines] == asked["policies"].split(",")
    for line in lines:
        policy, *shown = cells(line)
        for task, cell in zip(tasks, shown, strict=True):
            row = found[task, policy.strip("`")]
            rates = [row[name] for name in ("success", "conflict", "collision", "time s")]
            assert cell == " / ".join(rate.split()[0] for rate in rates)


@pytest.mark.parametrize("name", ["captures", "captures_hard"])
def test_the_tables_of_captures_are_those_of_their_files(name):
    text = (CAPTURES / f"{name}.md").read_text()
    rows = read(CAPTURES / f"{name}.csv")
    for difficulty, part in zip(*[iter(re.split(r"(?m)^## (\w+)$", text)[1:])] * 2, strict=True):
        head, _, *lines = part.strip().splitlines()
        for line in lines:
            chasers, *shown = cells(line)
            for evaders, cell in zip(cells(head)[1:], shown, strict=True):
                (row,) = [
                    row
                    for row in rows
                    if (row["difficulty"], row["chasers"], row["evaders"])
                    == (difficulty, chasers.strip("`"), evaders)
                ]
                low, high = float(row["low"]), float(row["high"])
                every = f"{float(row['all']):.2f} [{low:.2f}, {high:.2f}]"
                assert (
                    cell == f"{every} / {float(row['captured']):.2f} / {float(row['seconds']):.1f}"
                )
                assert f"{row['episodes']} episodes of each pair, seeds {row['seed']} to " in text


def test_a_pair_of_the_table_flies_the_same_again():
    row = next(
        row
        for row in read(CAPTURES / "captures.csv")
        if (row["difficulty"], row["chasers"], row["evaders"]) == ("easy", "lead", "random")
    )
    flown = bulletuav.evaluate(
        "pursuit_evasion",
        f"{row['chasers']} vs {row['evaders']}",
        int(row["episodes"]),
        int(row["seed"]),
        difficulty=row["difficulty"],
        dynamics=row["dynamics"],
    )
    assert flown.hash == row["hash"]


@pytest.mark.slow
@pytest.mark.parametrize(("task", "policy"), [("converge", "mvp"), ("obstacles", "orca")])
def test_a_row_of_the_policies_flies_the_same_again(task, policy):
    row = next(
        row
        for row in site_reference.read_leaderboard(AVOIDANCE)
        if (row["task"], row["policy"]) == (task, policy)
    )
    flown = bulletuav.evaluate(task, policy, int(row["episodes"]), 0, difficulty=row["difficulty"])
    assert flown.hash.startswith(row["hash"])


def test_no_table_is_of_a_former_version():
    pages = [*(DOCS / "benchmarks").rglob("*.md"), *(DOCS / "results").rglob("*.md")]
    for page in pages:
        assert not re.search(r"version 0\.[0-8]\b", page.read_text()), page
