import ast
import ctypes
import itertools
import math
import os
import platform
import re
import subprocess
import sys
import time
import types
from pathlib import Path
from typing import NamedTuple

import numba
import numpy as np
import pytest
from forking import forking

import bulletuav
from bulletuav.compiled import compiling, dispatcher, folders, kernel, plain, shipped, stamps

TANH = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)(("tanh", ctypes.CDLL(None)))
"""A function of the C library, at an address of this process"""


@kernel.func
def squashed(x):
    return TANH(x)


class Inner(NamedTuple):
    numbers: np.ndarray
    scale: float


class Outer(NamedTuple):
    inner: Inner
    pair: tuple[int, float]
    flag: bool


@pytest.fixture(scope="module")
def run_in():
    with forking() as run:
        yield run


@pytest.fixture
def package(tmp_path, run_in):
    """A package of our modules that compile, a helper in one file, its caller in another."""
    folder = tmp_path / "small"
    (folder / "compiled").mkdir(parents=True)
    for module in (kernel, dispatcher, compiling, plain, stamps, folders, shipped):
        file = Path(module.__file__)
        code = file.read_text().replace("from bulletuav.", "from small.")
        (folder / "compiled" / file.name).write_text(code)
    (folder / "__init__.py").write_text("")
    (folder / "version.py").write_text('__version__ = "1"\n')
    (folder / "compiled" / "__init__.py").write_text("")
    (folder / "unrelated.py").write_text("x = 1\n")
    (folder / "helper.py").write_text(
        "from small.compiled.kernel import kernel\n@kernel\ndef helper(x):\n    return x + 1\n"
    )
    (folder / "middle.py").write_text(
        "from small.helper import helper\nfrom small.compiled.kernel import func\n"
        "@func\ndef middle(x):\n    return helper(x)\n"
    )
    (folder / "caller.py").write_text(
        "from small.middle import middle\nfrom small.compiled.kernel import kernel\n"
        "@kernel\ndef caller(x):\n    return middle(x) * 10\n"
    )

    def run(before="", at_once=1, kind="warm"):
        code = (
            before + "from small.caller import caller; "
            "print(caller(1), sum(caller.stats.cache_hits.values()))"
        )
        reported = run_in(tmp_path, *[code] * at_once, kind=kind)
        found = [tuple(int(number) for number in out.split()) for out in reported]
        return found if at_once > 1 else found[0]

    return folder, run


def edit(path, old, new):
    """Change a file as an editor or an upgrade would, keeping its old time stamp."""
    stamp = path.stat()
    path.write_text(path.read_text().replace(old, new))
    os.utime(path, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))


def test_of_processes_that_start_at_once_one_compiles(package):
    """Else both do, and the next compiles what calls the one whose code was overwritten."""
    _, run = package
    assert sorted(run(at_once=3)) == [(20, 0), (20, 1), (20, 1)]
    assert run() == (20, 1)


@pytest.mark.parametrize(
    ("part", "patience"),
    [
        ("", 0.3),  # all functions, by a process that was stopped
        (", 1, 5", 300.0),  # one, but another one
    ],
)
def test_other_processes_are_not_waited_for_in_vain(package, tmp_path, part, patience):
    folder, run = package
    (folder / "held.py").write_text(
        "import fcntl, sys, time\nlock = open(sys.argv[1], 'ab')\n"
        f"fcntl.lockf(lock, fcntl.LOCK_EX{part})\nprint('locked', flush=True)\ntime.sleep(1000)\n"
    )
    assert run() == (20, 0)
    (lock,) = (tmp_path / "cache").rglob(".lock")
    edit(folder / "helper.py", "x + 1", "x + 2")
    command = [sys.executable, folder / "held.py", lock]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as holder:
        assert holder.stdout.readline() == b"locked\n"
        assert run(f"import small.compiled.dispatcher as d; d.PATIENCE = {patience}; ") == (30, 0)
        assert holder.poll() is None  # the lock is held still
        holder.kill()


def test_each_form_of_each_function_has_a_lock_of_its_own(monkeypatch, tmp_path):
    """Two functions with one lock could wait for each other."""
    places = []
    monkeypatch.setattr(dispatcher, "_wait_for", lambda lock, place: places.append(place))
    monkeypatch.setattr(kernel, "_CACHE", tmp_path)
    one, other = kernel.kernel(lambda x: x + 1), kernel.kernel(lambda x: x + 2)
    assert (one(1), one(1.5), other(1), other(1.5)) == (2, 2.5, 3, 3.5)
    assert len(set(places)) == 4


def test_what_is_not_whole_on_disk_is_compiled_anew(package):
    folder, run = package
    assert run() == (20, 0)
    for file in (folder.parent / "cache").rglob("*.nbc"):
        file.write_bytes(file.read_bytes()[: 0 if "helper" in file.name else 100])
    assert run() == (20, 0)
    assert run() == (20, 1)


def test_where_nothing_can_be_kept_it_is_told_once(monkeypatch, caplog, tmp_path):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(dispatcher, "_replace", full)
    monkeypatch.setattr(kernel, "_CACHE", tmp_path)
    squared = kernel.kernel(lambda x: x * x)
    assert (squared(3), squared(0.5)) == (9, 0.25)
    (reported,) = [one.message for one in caplog.records]
    assert (
        reported
        == "[Errno 28] No space left on device: compiled functions are not stored for later runs"
    )


def test_who_is_interrupted_before_it_is_linked_is_compiled_anew(monkeypatch, tmp_path):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(kernel, "_CACHE", tmp_path)
    cubed = kernel.kernel(lambda x: x * x * x)
    with monkeypatch.context() as patch:
        patch.setattr(dispatcher, "_replace", interrupted)
        with pytest.raises(KeyboardInterrupt):
            cubed(3)
    assert not cubed.overloads
    assert cubed(3) == 27
    assert len(list(tmp_path.glob("*.nbc"))) == 1


def test_an_edit_of_a_helper_in_another_file_is_seen_by_its_cached_caller(package):
    folder, run = package
    assert run() == (20, 0)
    assert run() == (20, 1)  # from the cache
    edit(folder / "helper.py", "x + 1", "x + 2")
    assert run() == (30, 0)
    assert run() == (30, 1)


def test_an_edit_elsewhere_leaves_what_is_compiled(package):
    folder, run = package
    run()
    edit(folder / "unrelated.py", "x = 1", "x = 2")
    assert run() == (20, 1)


def test_a_caller_is_compiled_anew_where_what_it_calls_has_another_symbol(package):
    """Two processes that compile at once leave such files: calling them would end the process."""
    folder, run = package
    assert run() == (20, 0)
    for file in (folder.parent / "cache").rglob("helper-*"):
        file.unlink()
    # Numba counts what it compiles in its symbols: here one more comes before the helper
    assert run("from small.middle import middle; middle(1.5); middle(1j); ") == (20, 0)
    assert run() == (20, 1)


def test_an_edit_leaves_no_old_machine_code(package):
    folder, run = package
    run()
    before = {path.name for path in (folder.parent / "cache").rglob("*.nbc")}
    edit(folder / "helper.py", "x + 1", "x + 2")
    run()
    after = {path.name for path in (folder.parent / "cache").rglob("*.nbc")}
    assert len(before) == len(after) > 0
    assert not before & after


def test_stored_code_finds_functions_of_numbas(package):
    """It ends the process otherwise."""
    folder, run = package
    (folder / "helper.py").write_text(
        "import numpy as np\nfrom small.compiled.kernel import allocating\n@allocating\n"
        "def helper(x):\n    made = np.ones(3)\n"
        "    return x + int(made[1]) * (hash('text') == hash('text'))\n"
    )
    assert run(kind="cold") == (20, 0)
    assert run(kind="cold") == (20, 1)


def test_machine_code_with_addresses_of_this_process_is_not_stored(monkeypatch, tmp_path):
    monkeypatch.setattr(kernel, "_CACHE", tmp_path)
    compiled = kernel.kernel(lambda x: TANH(x))
    assert compiled(0.5) == math.tanh(0.5)
    assert list(tmp_path.glob("*.nbc")) == []


def test_copied_code_with_addresses_of_this_process_is_not_stored(monkeypatch, tmp_path):
    monkeypatch.setattr(kernel, "_CACHE", tmp_path)
    squashed.keep_in(tmp_path)
    caller = kernel.kernel(lambda x: squashed(x) + 1.0)
    assert caller(0.5) == math.tanh(0.5) + 1.0
    assert len(squashed.inner.overloads) == 1
    assert not list(tmp_path.glob("*.nbc"))


def test_functions_of_arrays_are_made_of_stored_code(package):
    """In a process that has compiled nothing yet."""
    folder, run = package
    (folder / "helper.py").write_text(
        "import numpy as np\nfrom small.compiled.kernel import elementwise\n@elementwise\n"
        "def sum_of(x, y):\n    return x + y\n"
        "def helper(x):\n    return int(sum_of(np.arange(2), x)[1])\n"
    )
    (folder / "caller.py").write_text(
        "from types import SimpleNamespace\nfrom small.helper import helper\n"
        "def caller(x):\n    return helper(x)\n"
        "caller.stats = SimpleNamespace(cache_hits={})\n"
    )
    assert run(kind="cold") == run(kind="cold") == (2, 0)


def test_functions_of_numbers_take_numbers_and_arrays():
    twice = kernel.elementwise(lambda x, y: 2.0 * x + y)
    assert twice(1, 2.0) == 4
    assert isinstance(twice(1, 2), np.float64)
    assert twice(np.arange(3.0), 1.0).tolist() == [1, 3, 5]
    assert twice([1.0, 2.0], np.zeros((2, 1))).shape == (2, 2)


def test_functions_of_numbers_give_arrays_the_same_before_and_after_many(monkeypatch):
    monkeypatch.setattr(kernel, "_ONE_BY_ONE", 5)
    third = kernel.elementwise(lambda x, y: x / 3.0 + y)
    x = np.linspace(0.1, 0.7, 6).reshape(2, 3)
    given = [(x[:, :2], 1.0), (x, x), (x.T, 1.0), (x, x[0]), (x[0, :, None], x[:1]), (x[:0], 1.0)]
    given += [(np.float32(x), np.float32(1)), (np.arange(3), 1), (np.array(0.7), 1.0)]
    for numbers in given:
        third._left = 5
        first, later = third(*numbers), third._of_arrays(*numbers)
        assert type(first) is type(later)
        assert first.dtype == later.dtype
        assert first.strides == later.strides
        assert np.array_equal(first, later)


def test_plain_numba_would_have_run_stale_code(package):
    """What the module is for: if this fails, numba has learnt it and the module can go."""
    folder, run = package
    for path in (folder / "helper.py", folder / "caller.py"):
        path.write_text(
            path.read_text().replace(
                "from small.compiled.kernel import kernel",
                "import numba\nkernel = numba.njit(cache=True)",
            )
        )
    assert run() == (20, 0)
    edit(folder / "helper.py", "x + 1", "x + 2")
    assert run() == (20, 1)


def test_old_folders_are_forgotten_and_a_place_to_write_is_found(tmp_path, monkeypatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    folder = kernel.cache_folder()
    assert folder.parent == tmp_path / "bulletuav-kernels"
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
    monkeypatch.setattr(folders.tempfile, "gettempdir", lambda: str(tmp_path / "temporary"))
    assert Path(tmp_path, "temporary") in kernel.cache_folder().parents
    monkeypatch.setattr(folders.tempfile, "gettempdir", lambda: str(blocked))
    with pytest.raises(OSError, match="set NUMBA_CACHE_DIR"):
        kernel.cache_folder()


def test_the_global_setting_of_numba_is_left_alone():
    before = str(numba.config.CACHE_DIR)
    compiled = kernel.kernel(lambda x: 1.0 / x)
    assert str(numba.config.CACHE_DIR) == before
    assert compiled(0.0) == float("inf")


def test_imports_are_found_as_python_finds_them():
    """The stamp of a function is of all files that its file imports."""
    for path in sorted(PACKAGE.rglob("*.py")):
        expected = set()
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom):
                assert node.level == 0, path  # relative ones are not looked for
                names = [f"{node.module}.{alias.name}" for alias in node.names] + [node.module]
            elif isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            else:
                continue
            for name in names:
                place = PACKAGE.parent.joinpath(*name.split("."))
                expected |= {place.with_suffix(".py"), place / "__init__.py"}
        files = {one for one in expected if PACKAGE in one.parents and one.is_file()}
        found = set(map(Path, stamps._imported(str(path))))
        assert files - {PACKAGE / "__init__.py"} <= found, path


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


def test_a_number_that_stands_in_a_call_makes_no_form_of_its_own():
    """Plain numba would compile five; flags and numbers may have defaults, too."""

    @kernel.func
    def scaled(x, times, back=False):
        return -times * x if back else times * x

    @kernel.kernel
    def all_of(x, n):
        return scaled(x, 2) + scaled(x, 3) + scaled(x, n, True) + scaled(x, n, False) + scaled(x, n)

    assert all_of(1.0, 7) == 2 + 3 - 7 + 7 + 7
    forms = set(scaled.inner.overloads)
    assert {form[:2] for form in forms} == {(numba.float64, numba.int64)}
    assert len(forms) == 2  # with a flag, and without


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


def test_long_compilation_is_logged_once(monkeypatch, caplog, tmp_path):
    monkeypatch.setattr(kernel, "_CACHE", tmp_path)
    monkeypatch.setattr(dispatcher, "MANY", 2)
    compilation = dispatcher.Compilation()
    monkeypatch.setattr(dispatcher, "COMPILATION", compilation)
    # However much time passes in between, as until a first touch
    now = itertools.count(step=1000.0)
    clock = types.SimpleNamespace(monotonic=lambda: next(now), sleep=time.sleep)
    monkeypatch.setattr(dispatcher, "time", clock)
    compiled = kernel.kernel(lambda x: x + 1)
    for number in (1, 1.0, 1j, True, np.float32(1.0)):
        compiled(number)
    assert [one.message for one in caplog.records] == [
        "compiling for this machine, for a minute or two; later runs start immediately "
        "(bulletuav compile compiles everything at once)"
    ]
    assert compilation.num_functions == len(list(tmp_path.glob("*.nbc"))) == 5
    assert compilation.seconds >= 5 * 1000.0


def test_who_watches_compilation_hears_of_each_function_in_place_of_the_log(
    monkeypatch, caplog, tmp_path
):
    monkeypatch.setattr(kernel, "_CACHE", tmp_path)
    monkeypatch.setattr(dispatcher, "MANY", 1)
    compilation = dispatcher.Compilation()
    monkeypatch.setattr(dispatcher, "COMPILATION", compilation)
    heard = []
    compilation.watch = lambda one: heard.append(one.num_functions)
    compiled = kernel.kernel(lambda x: x + 2)
    for number in (1, 1.0, 2, 1j):
        compiled(number)
    assert heard == [1, 2, 3]
    assert caplog.records == []


def test_tuples_in_memory_are_read_by_name_and_their_arrays_written_in_place():
    """Also within each other, and by a function that is given the address again."""
    in_memory = kernel.in_memory

    @kernel.uncached
    def add(inner, by):
        inner = in_memory(inner)
        inner.numbers[0] += by * inner.scale
        return inner.numbers[0]

    @kernel.uncached
    def both(given):
        given = in_memory(given)
        other = in_memory(Outer(given.inner, given.pair, not given.flag))
        first = add(given.inner, 1.0)
        return first, add(other.inner, 2.0), other.pair[1], other.flag

    numbers = np.array([1.0])
    assert both(Outer(Inner(numbers, 10.0), (3, 4.0), True)) == (11.0, 31.0, 4.0, False)
    assert numbers[0] == 31.0


def test_a_tuple_in_memory_has_no_other_fields():
    in_memory = kernel.in_memory

    @kernel.uncached
    def wrong(inner):
        return in_memory(inner).missing

    with pytest.raises(numba.TypingError, match="missing"):
        wrong(Inner(np.zeros(1), 1.0))


SHIPS = "import numba; numba.config.CPU_NAME = 'x86-64-v2'; numba.config.CPU_FEATURES = ''; "
"""Compiles for a level, as the build does"""


@pytest.fixture
def shipping(package, tmp_path):
    """The package with machine code for x86-64-v2, moved to another place; its folder of code."""
    folder, run = package
    assert run(SHIPS, kind="cold") == (20, 0)
    code = folder / "compiled" / "shipped" / "x86-64-v2"
    code.mkdir(parents=True)
    (kept,) = (tmp_path / "cache" / "bulletuav-kernels").iterdir()
    for file in kept.glob("*.nbc"):
        file.rename(code / file.name)
    (tmp_path / "elsewhere").mkdir()
    folder.rename(tmp_path / "elsewhere" / "small")
    code = tmp_path / "elsewhere" / "small" / "compiled" / "shipped" / "x86-64-v2"

    def run_elsewhere(before="", kind="cold"):
        before = f"import sys; sys.path.insert(0, {str(tmp_path / 'elsewhere')!r}); {before}"
        return run(before, kind=kind)

    return code, run_elsewhere


def stored(tmp_path):
    return list((tmp_path / "cache").rglob("*.nbc"))


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="levels are of x86-64")
class TestShipped:
    def test_code_of_the_package_is_loaded_from_anywhere_and_nothing_written(
        self, shipping, tmp_path
    ):
        code, run = shipping
        before = {file: file.stat().st_mtime_ns for file in code.rglob("*")}
        code.chmod(0o500)
        assert run() == (20, 1)
        assert {file: file.stat().st_mtime_ns for file in code.rglob("*")} == before
        assert not stored(tmp_path)

    @pytest.mark.parametrize("size", [0, 100, None])
    def test_damaged_code_is_compiled_again_and_kept_in_the_cache(self, shipping, tmp_path, size):
        code, run = shipping
        for file in code.iterdir():
            data = bytearray(file.read_bytes())
            data[len(data) // 2] ^= 1
            file.write_bytes(data[:size])
        assert run() == (20, 0)
        assert len(stored(tmp_path)) == len(list(code.iterdir()))
        assert run() == (20, 1)

    @pytest.mark.parametrize(
        ("before", "kind"),
        [
            ("", "warm"),  # numba was initialised for this processor before
            ("import numba; numba.config.CPU_NAME = 'nocona'; ", "cold"),
            ("import numba; numba.config.CPU_FEATURES = '-avx2'; ", "cold"),
            ("import llvmlite; llvmlite.__version__ = '0.1'; ", "cold"),
            ("import numba; numba.__version__ = '0.1'; ", "cold"),
        ],
    )
    def test_code_for_anything_else_is_not_loaded(self, shipping, tmp_path, before, kind):
        _, run = shipping
        assert run(before, kind=kind) == (20, 0)
        assert stored(tmp_path)

    def test_code_of_an_edited_file_is_not_loaded(self, shipping):
        code, run = shipping
        edit(code.parents[2] / "helper.py", "x + 1", "x + 2")
        assert run() == (30, 0)

    def test_native_code_is_compiled_if_it_was_requested(self, shipping):
        _, run = shipping
        mark = "from small.compiled.shipped import native_mark; native_mark()"
        assert run() == (20, 1)
        assert run(f"{mark}.touch(); import os; ") == (20, 1)  # this process began before
        assert run() == (20, 0)
        assert run(f"{mark}.unlink(); ") == (20, 1)  # compiled before
        assert run() == (20, 1)


V2 = dict.fromkeys(shipped.LEVELS[2].features, True)
V3 = dict.fromkeys(shipped.LEVELS[1].features, True)
V4 = dict.fromkeys(shipped.LEVELS[0].features, True)


@pytest.mark.parametrize(
    ("features", "built", "level"),
    [
        (V4, "234", "x86-64-v4"),
        (V4, "23", "x86-64-v3"),
        (V4 | {"avx512vl": False}, "234", "x86-64-v3"),
        (V3, "234", "x86-64-v3"),
        (V3 | {"bmi2": False}, "234", "x86-64-v2"),
        (V2, "34", None),
        ({"sse2": True}, "234", None),
        ({"neon": True}, "234", None),
        (V4, "", None),
    ],
)
def test_the_best_level_that_the_processor_supports(features, built, level, tmp_path, monkeypatch):
    for number in built:
        (tmp_path / f"x86-64-v{number}").mkdir()
    monkeypatch.setattr(shipped.llvm, "get_host_cpu_features", lambda: features)
    found = shipped.find_level(tmp_path)
    assert (found and found.name) == level
    # Numba's own switch
    monkeypatch.setattr(shipped.config, "ENABLE_AVX", 0)
    found = shipped.find_level(tmp_path)
    assert (found and found.name) == ("x86-64-v2" if level and "2" in built else None)


def test_an_unknown_processor_has_no_level(monkeypatch, tmp_path):
    def unknown():
        raise RuntimeError

    monkeypatch.setattr(shipped.llvm, "get_host_cpu_features", unknown)
    assert shipped.find_level(tmp_path) is None
