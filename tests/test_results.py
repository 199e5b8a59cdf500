"""Raw results: packed reproducibly, fetched from archives and commits, and checked."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "tools"))
import results  # noqa: E402

ROWS = ("hover-ppo-0", "hover-ppo-1")


@pytest.fixture
def tree(tmp_path):
    """A repository with two rows, a run and a manifest, and the archive of these."""
    root, archive = tmp_path / "tree", tmp_path / "bulletuav-results.tar.gz"
    for k, name in enumerate(ROWS):
        folder = root / results.PLACES[0] / name
        folder.mkdir(parents=True)
        (folder / "row.json").write_text(json.dumps({"seed": k}))
        (folder / "policy.safetensors").write_bytes(bytes(range(k, 200)))
    (root / results.PLACES[2]).mkdir(parents=True)
    (root / results.PLACES[2] / "run.yaml").write_text("algo: ppo\n")
    results.pack(root, archive)
    return root, archive


def empty(root):
    """Remove all raw results of a tree."""
    for place in results.PLACES:
        shutil.rmtree(root / place, ignore_errors=True)


def test_the_same_files_give_the_same_archive(tree, tmp_path):
    root, archive = tree
    manifest = (root / results.MANIFEST).read_text()
    again = tmp_path / "again" / archive.name
    results.pack(root, again)
    assert again.read_bytes() == archive.read_bytes()
    assert (root / results.MANIFEST).read_text() == manifest
    assert len(results.read_manifest(root)["files"]) == 5
    assert [len(files) for files in json.loads(manifest)["files"].values()] == [2, 2, 1]


def test_a_row_is_fetched_from_an_archive(tree, capsys):
    root, archive = tree
    before = {path: (root / path).read_bytes() for path in results.list_files(root)}
    empty(root)
    call = ["--root", str(root), "fetch", "--archive", str(archive)]
    results.main([*call, ROWS[1]])
    assert capsys.readouterr().out == f"{results.PLACES[0]}/{ROWS[1]}\n"
    assert {results.name_row(path) for path in results.list_files(root)} == {ROWS[1]}
    results.main([*call, "--all"])
    assert {path: (root / path).read_bytes() for path in results.list_files(root)} == before


def test_rows_are_fetched_from_the_commit_that_has_them(tree, tmp_path):
    root, archive = tree
    git = ["git", "-C", str(root), "-c", "user.name=a", "-c", "user.email=a@b.c"]
    for words in (["init", "-q"], ["add", "."], ["commit", "-q", "-m", "rows"]):
        subprocess.run([*git, *words], check=True, capture_output=True)
    head = subprocess.run([*git, "rev-parse", "HEAD"], check=True, capture_output=True, text=True)
    results.pack(root, tmp_path / "again" / archive.name, commit=head.stdout.strip())
    empty(root)
    results.fetch(root, [ROWS[0]])
    assert results.check(root, []) == ("2 of 5 files agree with the manifest, 3 are missing", True)


def test_without_commit_and_release_the_error_says_what_to_do(tree):
    root, _ = tree
    empty(root)
    with pytest.raises(SystemExit, match="not published yet.*--archive FILE"):
        results.main(["--root", str(root), "fetch", ROWS[0]])
    assert not results.list_files(root)


@pytest.mark.parametrize(
    ("rows", "match"), [(["hover-ppo-7"], "no row hover-ppo-7.*hover-ppo-1"), ([], "name the rows")]
)
def test_rows_that_do_not_exist_are_refused(tree, rows, match, capsys):
    with pytest.raises(SystemExit) as raised:
        results.main(["--root", str(tree[0]), "fetch", *rows])
    assert re.search(match, f"{raised.value} {capsys.readouterr().err}")


def test_a_damaged_archive_changes_nothing(tree, tmp_path):
    root, archive = tree
    other = tmp_path / "other"
    shutil.copytree(root, other)
    (other / results.PLACES[0] / ROWS[1] / "row.json").write_text("{}")
    (other / results.MANIFEST).unlink()
    results.pack(other, tmp_path / "other.tar.gz")
    empty(root)
    whole = archive.read_bytes()
    (tmp_path / "short.tar.gz").write_bytes(whole[: len(whole) // 2])
    for name, match in (("other", "differs from the manifest"), ("short", "cannot be read")):
        with pytest.raises(results.ResultsError, match=match):
            results.fetch(root, [], str(tmp_path / f"{name}.tar.gz"))
    assert not results.list_files(root)


def test_files_that_differ_are_reported_and_kept(tree):
    root, archive = tree
    changed = root / results.PLACES[0] / ROWS[0] / "row.json"
    changed.write_text("changed")
    (changed.parent / "note.txt").write_text("mine")
    text, agrees = results.check(root, [])
    assert not agrees
    assert f"differs: {results.PLACES[0]}/{ROWS[0]}/row.json" in text
    assert f"not listed: {results.PLACES[0]}/{ROWS[0]}/note.txt" in text
    with pytest.raises(results.ResultsError, match="--replace"):
        results.fetch(root, [ROWS[0]], str(archive))
    assert changed.read_text() == "changed"
    results.fetch(root, [ROWS[0]], str(archive), replace=True)
    assert changed.read_text() == '{"seed": 0}'


def test_rows_that_were_not_fetched_are_not_packed_away(tree, tmp_path):
    root, _ = tree
    shutil.rmtree(root / results.PLACES[0] / ROWS[0])
    with pytest.raises(results.ResultsError, match="fetch --all"):
        results.pack(root, tmp_path / "new.tar.gz")


def test_the_manifest_has_all_rows_of_the_leaderboard(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    from leaderboard_rows import list_rows

    from bulletuav.policies.run import read_settings

    manifest = results.read_manifest(ROOT)
    rows = list_rows(read_settings(ROOT / "benchmarks" / "leaderboard.yaml", "settings"))
    listed = {results.name_row(path) for path in manifest["files"]}
    tables = {path.parent.name for path in ROOT.glob("docs/results/**/leaderboard.md")}
    assert listed == {row.name for row in rows} | {"racer", "streets"} | tables
    assert len(manifest["commit"]) == 40
    _, agrees = results.check(ROOT, [])
    assert agrees
