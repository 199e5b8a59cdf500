"""Files that others made, damaged in all ways: a result, or one error of one line with their name.

`python -m tests.fuzz --seed 7 --cases 5000` does more.
"""

import pytest
from fuzz.formats import FORMATS
from fuzz.run import ROOT, run

CASES = 6
"""Cases of each format, of which the first two are no files; the others are slow"""
MANY = 300


def test_formats_are_those_of_the_table():
    """SECURITY.md lists what reads files: for each there is a format, or a reason why not."""
    table = (ROOT / "SECURITY.md").read_text()
    for one in FORMATS.values():
        name = one.file.replace("town.", ".").replace("own.", ".")
        assert name.lstrip(".").split(".")[-1].lower() in table.lower(), name


@pytest.mark.parametrize("some", ["files", "snapshot"])
def test_damaged_files_give_one_clear_error(some):
    """All formats in one process, which takes seconds to start."""
    names = ["snapshot"] if some == "snapshot" else [name for name in FORMATS if name != "snapshot"]
    wanted = {name: (0, max(3, round(FORMATS[name].weight * CASES))) for name in names}
    faults, count = run(wanted, seed=0)
    assert not faults, "\n".join(map(str, faults))
    assert count >= sum(last for _, last in wanted.values())


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMATS)
def test_many_damaged_files(name):
    faults, count = run({name: (0, round(FORMATS[name].weight * MANY))}, seed=1)
    assert not faults, "\n".join(map(str, faults))
    assert count


def test_a_process_that_dies_is_a_fault(monkeypatch):
    """Otherwise no crash would ever be found."""
