import ast
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numba
import numpy as np
import pytest

import bulletuav
from bulletuav import kernel


@pytest.fixture
def package(tmp_path):
    """A package of our `kernel` module, a helper in one file and its compiled caller in another."""
    folder = tmp_path / "small"
    folder.mkdir()
    shutil.copy(kernel.__file__, folder / "kernel.py")
    (folder / "__init__.py").write_text("")
    (folder / "helper.py").write_text(
        "from small.kernel import kernel\n@kernel\ndef helper(x):\n    return x + 1\n"
    )
    (folder / "caller.py").write_text(
        "from small.helper import helper\nfrom small.kernel import kernel\n"
        "@kernel\ndef caller(x):\n    return helper(x) * 10\n"
    )

    def run():
        env = {
            **os.environ,
            "PYTHONPATH": str(tmp_path),
            "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
        }
        code = (
            "from small.caller import caller; "
            "print(caller(1), sum(caller.stats.cache_hits.values()))"
        )
        out = subprocess.run(
            [sys.executable, "-c", code],
            env=env,
            capture_output=True,
            text=True,
            check=True,
            cwd=tmp_path,
        )
        return tuple(int(number) for number in out.stdout.split())

    return folder, run


def edit(path, old, new):
    """Change a file as an editor or an upgrade would, keeping its old time stamp."""
    stamp = path.stat()
    path.write_text(path.read_text().replace(old, new))
    os.utime(path, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))


def test_an_edit_of_a_helper_in_another_file_is_seen_by_its_cached_caller(package):
    folder, run = package
    assert run() == (20, 0)
    assert run() == (20, 1)  # from the cache
    edit(folder / "helper.py", "x + 1", "x + 2")
    assert run() == (30, 0)
    edit(folder / "helper.py", "x + 2", "x + 1")
    assert run() == (20, 1)  # the old sources find their old cache


def test_plain_numba_would_have_run_stale_code(package):
    """What the module is for: if this fails, numba has learnt it and the module can go."""
    folder, run = package
    for path in (folder / "helper.py", folder / "caller.py"):
        path.write_text(
            path.read_text().replace(
                "from small.kernel import kernel", "import numba\nkernel = numba.njit(cache=True)"
            )
        )
    assert run() == (20, 0)
    edit(folder / "helper.py", "x + 1", "x + 2")
    assert run() == (20, 1)


def test_the_hash_covers_every_file_and_name(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "b.py").write_text("x = 1")
    first = kernel.source_hash(tmp_path)
    (tmp_path / "a" / "b.py").write_text("x = 2")
    second = kernel.source_hash(tmp_path)
    (tmp_path / "a" / "b.py").rename(tmp_path / "a" / "c.py")
    assert len({first, second, kernel.source_hash(tmp_path)}) == 3


def test_old_folders_are_forgotten_and_a_place_to_write_is_found(tmp_path, monkeypatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    folder = kernel.cache_folder()
    assert folder == tmp_path / "bulletuav-kernels" / kernel.source_hash(but=kernel.APART)
    for k in range(12):
        (folder.parent / f"old{k}").mkdir()
        os.utime(folder.parent / f"old{k}", (k, k))
    kernel.cache_folder()
    assert sorted(path.name for path in folder.parent.iterdir()) == sorted(
        [folder.name, *(f"old{k}" for k in range(5, 12))]
    )
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(blocked))
    monkeypatch.setattr(kernel.tempfile, "gettempdir", lambda: str(tmp_path / "temporary"))
    assert Path(tmp_path, "temporary") in kernel.cache_folder().parents
    monkeypatch.setattr(kernel.tempfile, "gettempdir", lambda: str(blocked))
    with pytest.raises(OSError, match="set NUMBA_CACHE_DIR"):
        kernel.cache_folder()


def test_the_global_setting_of_numba_is_left_alone():
    before = str(numba.config.CACHE_DIR)
    compiled = kernel.kernel(lambda x: 1.0 / x)
    assert str(numba.config.CACHE_DIR) == before
    assert compiled(0.0) == float("inf")


def test_a_new_task_leaves_the_kernels_as_they_are(tmp_path):
    (tmp_path / "tasks" / "rewards").mkdir(parents=True)
    before = kernel.source_hash(tmp_path, but=kernel.APART)
    (tmp_path / "tasks" / "mine.py").write_text("x = 1")
    assert kernel.source_hash(tmp_path, but=kernel.APART) == before != kernel.source_hash(tmp_path)
    (tmp_path / "tasks" / "rewards" / "mine.py").write_text("x = 1")
    assert kernel.source_hash(tmp_path, but=kernel.APART) != before


def test_kernels_use_nothing_of_files_that_do_not_count():
    """What lets their cache outlive an edit of those: the folders below them do count."""
    package, count = Path(bulletuav.__file__).parent, 0
    of_tasks = r"bulletuav\.tasks(\.(?!observations|rewards|families)\w+)?"
    flat = [rf"bulletuav\.{one}(\.\w+)?" for one in kernel.APART if one != "tasks"]
    apart = re.compile("|".join([of_tasks, *flat]))
    for path in package.rglob("*.py"):
        tree = ast.parse(path.read_text())
        imported = {
            alias.asname or alias.name
            for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom) and apart.fullmatch(node.module or "")
            for alias in node.names
        }
        for node in ast.walk(tree):
            marks = {ast.unparse(one) for one in getattr(node, "decorator_list", ())}
            if marks & {"kernel", "func", "elementwise"}:
                code = [one for line in node.body for one in ast.walk(line)]
                found = [one for one in code if isinstance(one, ast.Name)]
                own = {one.id for one in found if isinstance(one.ctx, ast.Store)}
                own |= {one.arg for one in node.args.args}
                used = {one.id for one in found} - own
                assert not used & imported, f"{path}: {node.name}"
                count += 1
    assert count > 100


PACKAGE = Path(bulletuav.__file__).parent
NUMBERS = {"None", "bool", "int", "float", "tuple", "Vec3", "Quat4"}
"""Parts of what an `allocating` function may return to one that counts no references"""


def compiled_functions():
    """Give (module, name) -> (decorator, what it returns, (module, name) of all that it calls)."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        module = ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)
        tree = ast.parse(path.read_text())
        origin = {
            alias.asname or alias.name: (node.module, alias.name)
            for node in tree.body
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
        }
        for node in tree.body:
            names = [ast.unparse(one) for one in getattr(node, "decorator_list", [])]
            kinds = [name for name in names if name in ("kernel", "func", "allocating")]
            if kinds:
                calls = {
                    origin.get(call.func.id, (module, call.func.id))
                    for call in ast.walk(node)
                    if isinstance(call, ast.Call) and isinstance(call.func, ast.Name)
                }
                returns = ast.unparse(node.returns) if node.returns else "None"
                found[module, node.name] = kinds[0], returns, calls
    return found


def test_who_counts_no_references_is_given_no_arrays():
    """An array that nobody counts would never be freed."""
    functions = compiled_functions()
    assert len(functions) > 300
    given = [
        (caller, called)
        for caller, (kind, _, calls) in functions.items()
        for called in calls
        if kind != "allocating"
        and functions.get(called, ("", "", ()))[0] == "allocating"
        and not set(re.findall(r"\w+", functions[called][1])) <= NUMBERS
    ]
    assert given == []


def test_kernels_refuse_to_make_arrays():
    @kernel.kernel
    def make(size):
        return np.zeros(size)

    @kernel.allocating
    def may_make(size):
        return np.zeros(size)

    with pytest.raises(numba.core.errors.TypingError):
        make(3)
    assert may_make(3).tolist() == [0, 0, 0]


def test_borrowed_arrays_are_the_same_ones():
    class Two(NamedTuple):
        one: np.ndarray
        rest: tuple

    @kernel.allocating
    def change(two):
        lent = kernel.borrowed(two)
        lent.one[0] = 5.0
        lent.rest[0][1] = 6.0
        return lent.rest[1]

    two = Two(np.zeros(2), (np.zeros(2), 7))
    before = sys.getrefcount(two.one), sys.getrefcount(two.rest[0])
    assert change(two) == 7
    assert two.one.tolist() == [5, 0]
    assert two.rest[0].tolist() == [0, 6]
    assert (sys.getrefcount(two.one), sys.getrefcount(two.rest[0])) == before
