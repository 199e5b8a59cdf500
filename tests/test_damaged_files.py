"""Files that others made, damaged in all ways: a result, or one error of one line with their name.

`python -m tests.fuzz --seed 7 --cases 5000` does more.
"""

import random
import re

import pytest
from fuzz import cases, formats
from fuzz.formats import FORMATS, Format
from fuzz.mutations import damage
from fuzz.run import run

import bulletuav

CASES = 20
"""Cases of each format, of which the first two are no files; more are slow"""
MANY = 300


def raises(error, more=""):
    """What reads a file, and raises an error instead."""

    def read(folder):
        raise error(f"{folder} is odd{more}")

    return read


@pytest.mark.parametrize("some", ["files", "snapshot"])
def test_damaged_files_give_one_clear_error(some):
    """All formats in one process, as each process takes seconds to start."""
    names = ["snapshot"] if some == "snapshot" else [name for name in FORMATS if name != "snapshot"]
    wanted = {name: (0, max(3, round(FORMATS[name].weight * CASES))) for name in names}
    faults, count = run(wanted, seed=0)
    assert not faults, "\n".join(map(str, faults))
    assert count == sum(last for _, last in wanted.values())


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMATS)
def test_many_damaged_files(name):
    faults, _ = run({name: (0, round(FORMATS[name].weight * MANY))}, seed=1)
    assert not faults, "\n".join(map(str, faults))


@pytest.mark.parametrize(
    ("read", "found"),
    [
        (raises(ValueError), None),
        (raises(FileNotFoundError), None),
        (raises(KeyError), "KeyError"),
        (raises(RecursionError), "RecursionError"),
        (lambda folder: int("x"), "no name of the file"),
        (raises(ValueError, "\n"), "more than a line"),
        (raises(OSError, "x" * 9000), "a message of"),
    ],
)
def test_what_is_a_fault(read, found, tmp_path, monkeypatch):
    monkeypatch.setitem(FORMATS, "own", Format("own.txt", "text", None, read))
    fault = cases.fault_of("own", tmp_path)
    assert fault is None if found is None else found in fault


def test_a_process_that_dies_or_hangs_is_a_fault_and_others_are_read(tmp_path, monkeypatch):
    """Of a program that ends in the second of four cases, by a signal; then all are well."""
    program = tmp_path / "cases.py"
    program.write_text(
        "import json, os, sys\n"
        "name, seed, first, last = sys.argv[1].split(':')\n"
        "for index in range(int(first), int(last)):\n"
        "    print(json.dumps({'name': name, 'index': index, 'begins': True}), flush=True)\n"
        "    if index == 1: os.kill(os.getpid(), 11)\n"
        "    print(json.dumps({'name': name, 'index': index, 'fault': None}), flush=True)\n"
    )
    monkeypatch.setattr("fuzz.run.PROGRAM", [str(program)])
    faults, count = run({"own": (0, 4)}, seed=3)
    (fault,) = faults
    assert fault[:3] == ("own", 3, 1)
    assert fault.what.startswith("SIGSEGV")
    assert count == 4


def test_damage_is_the_same_for_the_same_seed():
    for kind in ("text", "json", "bytes"):
        content = b'{"a": [1, 2, {"b": "c"}]}'
        one, two = (
            [damage(content, kind, random.Random(f"{k}")) for k in range(200)] for _ in range(2)
        )
        assert one == two
        assert len(set(one)) > 100


NO_SUCH_CORNER = "f 1 2 999999999\n"


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("body.obj", formats.BOX + NO_SUCH_CORNER),
        ("body.stl", bytes(80) + (2**31).to_bytes(4, "little") + bytes(50)),
        ("body.stl", b"solid"),
        ("body.dae", "<a>" * 5000),
    ],
)
def test_meshes_that_pictures_show_are_read_before_the_engine_reads_them(name, content, tmp_path):
    """The engine dies with SIGSEGV of the first one."""
    formats.make_visual_urdf(tmp_path)
    urdf = tmp_path / "own.urdf"
    urdf.write_text(urdf.read_text().replace("body.obj", name))
    (tmp_path / "body.obj").unlink()
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ValueError, match=rf"^{re.escape(str(urdf))}: <mesh filename> is {name}: "):
        bulletuav.load_airframe(urdf)
