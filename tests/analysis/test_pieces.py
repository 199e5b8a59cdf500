"""Evaluations and comparisons that are flown in pieces, and made one again."""

import socket
import sys
import types

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import bulletuav
from bulletuav.analysis.pieces import WorkPiece, parse_piece
from bulletuav.cli import main
from bulletuav.report.results import merge

CALM = {"dynamics": "single_integrator", "num_drones": 2, "horizon": 12, "difficulty": "easy"}
ARGUMENTS = ["--dynamics", "single_integrator", "--drones", "2", "--horizon", "12"]


def files(folder):
    """Bytes of all files but those of pieces, by their path."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and "pieces" not in path.parts
    }


@given(st.integers(1, 40), st.integers(1, 12), st.integers(0, 30))
def test_pieces_take_everything_once_and_equally_much(count, of, first):
    shares = [WorkPiece(k, of, first).select(range(count)) for k in range(1, of + 1)]
    assert sorted(one for share in shares for one in share) == list(range(count))
    sizes = [len(share) for share in shares]
    assert max(sizes) - min(sizes) <= 1


@pytest.mark.parametrize("text", ["0/3", "4/3", "3", "a/b", "1/0", "-1/2", "", 5, None])
def test_what_is_no_piece_is_refused(text):
    with pytest.raises(ValueError, match="K/N is needed"):
        parse_piece(text)
    assert parse_piece("2/3") == parse_piece(WorkPiece(2, 3)) == (2, 3, 0)


def test_an_evaluation_of_pieces_has_the_bytes_of_one_process(tmp_path, capsys):
    command = ["evaluate", "crossing", "--episodes", "35", *ARGUMENTS]
    main([*command, "--out", str(tmp_path / "whole")])
    for piece in ("3/3", "1/3", "2/3"):
        capsys.readouterr()
        main([*command, "--out", str(tmp_path / "apart"), "--piece", piece])
        printed = capsys.readouterr().out
        assert f"finished piece {piece[0]} of 3" in printed
        assert f"bulletuav merge {tmp_path / 'apart'}" in printed.replace("\n", "")
        assert not (tmp_path / "apart" / "summary.json").exists()
        if piece == "1/3":
            with pytest.raises(SystemExit):
                main(["merge", str(tmp_path / "apart")])
            assert "lacks 10 of 35 episodes, the first is 10" in capsys.readouterr().err
    main(["merge", str(tmp_path / "apart")])
    whole = files(tmp_path / "whole")
    assert files(tmp_path / "apart") == whole
    assert set(whole) == {"run.json", "episodes.csv", "summary.json", "summary.png"}
    # Whoever goes on without a piece takes what is there, too
    (tmp_path / "apart" / "episodes.csv").unlink()
    (tmp_path / "apart" / "run.json").unlink()
    result = bulletuav.evaluate(
        "crossing",
        episodes=35,
        out=tmp_path / "apart",
        **{"dynamics": "single_integrator", "num_drones": 2, "horizon": 12},
    )
    assert (result.flight, len(result.rows)) == (0, 35)


def test_a_comparison_of_pieces_has_the_bytes_of_one_process(tmp_path, capsys):
    command = [
        *["compare", "--tasks", "crossing", "--policies", "straight,stay", "--episodes", "20"],
        *ARGUMENTS,
        *["--against", "stay"],
    ]
    main([*command, "--out", str(tmp_path / "whole")])
    for piece in ("1/3", "2/3", "3/3"):
        main([*command, "--out", str(tmp_path / "apart"), "--piece", piece])
    # Four batches of two policies, in three pieces
    flown = sorted(tmp_path.glob("apart/runs/*/pieces/*/episodes.csv"))
    assert [len(path.read_text().splitlines()) - 1 for path in flown] == [10, 0, 10, 10, 10, 0]
    main(["merge", str(tmp_path / "apart")])
    assert files(tmp_path / "apart") == files(tmp_path / "whole")
    with pytest.raises(SystemExit):
        main(
            [*command[:4], "stay", *command[5:], "--out", str(tmp_path / "apart"), "--piece", "1/3"]
        )
    assert "pieces of another comparison" in capsys.readouterr().err
    (tmp_path / "apart" / "pieces" / "cases.json").write_text("{}")
    with pytest.raises(SystemExit):
        main(["merge", str(tmp_path / "apart")])
    assert "cases.json is damaged" in capsys.readouterr().err


def test_pieces_of_another_run_or_damaged_ones_are_refused(tmp_path):
    bulletuav.evaluate("crossing", "stay", 10, piece="1/1", out=tmp_path, **CALM)
    with pytest.raises(ValueError, match="holds another run: its policy is 'stay'"):
        bulletuav.evaluate("crossing", "straight", 10, out=tmp_path, **CALM)
    run = tmp_path / "pieces" / "1-of-1" / "run.json"
    run.write_text("[]")
    with pytest.raises(SystemExit):
        main(["merge", str(tmp_path)])
    with pytest.raises(ValueError, match="holds a run that is damaged"):
        bulletuav.evaluate("crossing", "stay", 10, out=tmp_path, **CALM)


def test_where_there_is_nothing_to_merge_it_says_so(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(["merge", str(tmp_path)])
    assert "holds no pieces: fly them with --piece 1/N to N/N" in capsys.readouterr().err
    with pytest.raises(ValueError, match="without out: pass the folder that all pieces write to"):
        bulletuav.evaluate("crossing", episodes=10, piece="1/2", **CALM)
    with pytest.raises(SystemExit):
        main(["evaluate", "crossing", "--piece", "3/2"])
    assert "K/N is needed" in capsys.readouterr().err


def test_code_in_files_of_pieces_is_not_trusted(tmp_path):
    bulletuav.evaluate("crossing", "stay", 10, piece="1/1", out=tmp_path, **CALM)
    run = tmp_path / "pieces" / "1-of-1" / "run.json"
    run.write_text(run.read_text().replace("'stay'", "'evil:Policy'"))
    with pytest.raises(ValueError, match="pass --trust"):
        merge(tmp_path)


@pytest.mark.parametrize("ray", ["", 5])
def test_addresses_that_are_none_are_refused(ray):
    with pytest.raises(ValueError, match="the address of a cluster is needed"):
        bulletuav.evaluate("crossing", episodes=10, ray=ray, **CALM)


def test_a_cluster_needs_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.delitem(sys.modules, "bulletuav.adapters.ray", raising=False)
    with pytest.raises(ImportError, match="needs the extra 'ray'"):
        bulletuav.evaluate("crossing", episodes=10, ray="auto", **CALM)


class Cluster:
    """As much of Ray as one process can be: parts come back in another order."""

    def __init__(self, answers=True):
        self.calls, self.answers, self.joined = [], answers, []

    def is_initialized(self):
        return False

    def init(self, address, **_):
        if not self.answers:
            raise ConnectionError(f"Could not find {address}\nmore")
        self.joined.append(address)

    def shutdown(self):
        self.joined.pop()

    def cluster_resources(self):
        return {"CPU": 1.0}

    def remote(self, work):
        def do(part):
            self.calls.append(list(part))
            return lambda: work(part)

        return type("Task", (), {"options": lambda self, **_: self, "remote": staticmethod(do)})()

    def wait(self, waiting):
        return waiting[-1:], waiting[:-1]

    def get(self, one):
        return one()


@pytest.fixture
def cluster(monkeypatch):
    """Stands in for Ray."""
    one = Cluster()
    exceptions = types.ModuleType("ray.exceptions")
    exceptions.RayTaskError = type("RayTaskError", (Exception,), {})
    module = types.ModuleType("ray")
    for name in (
        "is_initialized",
        "init",
        "shutdown",
        "cluster_resources",
        "remote",
        "wait",
        "get",
    ):
        setattr(module, name, getattr(one, name))
    monkeypatch.setitem(sys.modules, "ray", module)
    monkeypatch.setitem(sys.modules, "ray.exceptions", exceptions)
    monkeypatch.delitem(sys.modules, "bulletuav.adapters.ray", raising=False)
    yield one
    sys.modules.pop("bulletuav.adapters.ray", None)


def test_a_cluster_gives_the_same_rows(cluster):
    alone = bulletuav.evaluate("crossing", "straight", 90, seed=3, **CALM)
    shared = bulletuav.evaluate("crossing", "straight", 90, seed=3, ray="auto", **CALM)
    assert shared.hash == alone.hash
    assert [len(part) for part in cluster.calls] == [2, 2, 2, 2, 1]
    assert cluster.joined == []
    np.testing.assert_equal(shared.rows, alone.rows)


def test_a_cluster_that_does_not_answer_is_one_clear_line(cluster):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # a port at which nobody listens
        place = f"127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(
            ConnectionError, match=rf"no Ray cluster answers at '{place}' \(.*refused"
        ):
            bulletuav.evaluate("crossing", episodes=10, ray=place, **CALM)
        taken.listen()
        cluster.answers = False
        for address in (place, "auto", "ray://10.0.0.1:10001"):
            with pytest.raises(ConnectionError, match=rf"'{address}' \(Could not find {address}\)"):
                bulletuav.evaluate("crossing", episodes=10, ray=address, **CALM)
