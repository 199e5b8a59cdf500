"""Pack, fetch and check the raw results: rows of tables, and trained runs that pages show.

    python tools/results.py fetch crossing-ppo-0 racer
    python tools/results.py fetch --all
    python tools/results.py check
    python tools/results.py pack --out dist/bulletuav-results.tar.gz

Raw results are no part of the tree. `docs/results/manifest.json` lists their files with sizes and
SHA-256 hashes, the commit that has them, and the archive of a release. `fetch` restores rows to
their places: from `--archive` (a file or a URL), else from that commit where git has it, which
needs no network, else from the release. Each file is checked before it is written. A row can also
be made again: `python benchmarks/leaderboard.py --rows crossing-ppo-0 --out again`.
"""

import argparse
import difflib
import gzip
import hashlib
import io
import json
import os
import subprocess
import sys
import tarfile
import urllib.error
import urllib.request
from collections.abc import Iterator, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from bulletuav.version import REPOSITORY  # noqa: E402

MANIFEST = PurePosixPath("docs/results/manifest.json")
TABLES = (
    "avoidance",
    "baselines",
    "cities",
    "formation",
    "learning/hover",
    "learning/mec",
    "service",
)
"""Tables of `bulletuav compare`, of which the tree has the Markdown and the picture"""
PLACES = (
    "docs/results/leaderboard/rows",
    "docs/results/leaderboard/leaderboard.csv",
    "docs/results/race/racer",
    "docs/results/cities/streets",
    *(f"docs/results/{table}/leaderboard.csv" for table in TABLES),
)
"""Folders and files of raw results"""
RELEASES = f"{REPOSITORY}/releases/latest/download/"
TIMEOUT = 60.0
"""Seconds to wait for a server"""


class ResultsError(Exception):
    """Raw results cannot be packed, fetched or checked; the message says why."""


def read_manifest(root: Path) -> dict[str, Any]:
    """Return the manifest: commit, archive, and size and hash of each file by its path."""
    try:
        manifest: dict[str, Any] = json.loads((root / MANIFEST).read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise ResultsError(f"{root / MANIFEST} does not exist") from error
    manifest["files"] = {
        f"{folder}/{name}": {"size": size, "sha256": sha256}
        for folder, files in manifest["files"].items()
        for name, (size, sha256) in files.items()
    }
    return manifest


def write_manifest(root: Path, manifest: dict[str, Any]) -> None:
    """Write the manifest by folders, with one line per file, so that changes can be read."""
    folders: dict[str, list[str]] = {}
    for path, one in manifest["files"].items():
        folder, _, name = path.rpartition("/")
        line = f"   {json.dumps(name)}: {json.dumps([one['size'], one['sha256']])}"
        folders.setdefault(folder, []).append(line)
    parts = [
        f"  {json.dumps(folder)}: {{\n" + ",\n".join(lines) + "\n  }"
        for folder, lines in folders.items()
    ]
    head = [f" {json.dumps(name)}: {json.dumps(manifest[name])}" for name in ("commit", "archive")]
    head.append(' "files": {\n' + ",\n".join(parts) + "\n }")
    (root / MANIFEST).write_text("{\n" + ",\n".join(head) + "\n}\n", encoding="utf-8")


def list_files(root: Path) -> list[str]:
    """List the raw results that are in a tree, sorted by path."""
    places = [root / place for place in PLACES]
    found = [path for place in places for path in (place, *place.rglob("*")) if path.is_file()]
    return sorted(path.relative_to(root).as_posix() for path in found)


def describe(content: bytes) -> dict[str, Any]:
    """Return the size and the SHA-256 hash of a file."""
    return {"size": len(content), "sha256": hashlib.sha256(content).hexdigest()}


def name_row(path: str) -> str:
    """Return the name of the row that a file belongs to: the name of its folder."""
    return PurePosixPath(path).parent.name


def choose_files(manifest: dict[str, Any], rows: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return the manifest's files of some rows; of all rows if none is named."""
    files: dict[str, dict[str, Any]] = manifest["files"]
    known = {name_row(path) for path in files}
    for row in rows:
        if row not in known:
            near = ", ".join(difflib.get_close_matches(row, known) or sorted(known)[:3])
            raise ResultsError(f"the manifest has no row {row}; it has rows such as {near}")
    return {path: one for path, one in files.items() if not rows or name_row(path) in rows}


def pack(root: Path, out: Path, commit: str | None = None) -> dict[str, Any]:
    """Write a reproducible archive of all raw results, and the manifest.

    Files are sorted and have no owner and no time, so the same files give the same archive. A row
    of the old manifest that is not in the tree raises `ResultsError`.

    Args:
        root: The folder of the repository.
        out: The archive, `.tar.gz`.
        commit: Commit that has the files; by default that of the old manifest.
    """
    if not out.name.endswith(".tar.gz"):
        raise ResultsError(f"{out} does not end in .tar.gz")
    old = read_manifest(root) if (root / MANIFEST).exists() else {"commit": None, "files": {}}
    paths = list_files(root)
    missing = {name_row(path) for path in set(old["files"]).difference(paths)}
    if missing:
        raise ResultsError(
            f"{len(missing)} rows of the manifest are not here, such as {min(missing)}: "
            "python tools/results.py fetch --all"
        )
    plain, files = io.BytesIO(), {}
    with tarfile.open(fileobj=plain, mode="w", format=tarfile.USTAR_FORMAT) as archive:
        for path in paths:
            content = (root / path).read_bytes()
            files[path] = describe(content)
            member = tarfile.TarInfo(path)
            member.size = len(content)
            archive.addfile(member, io.BytesIO(content))
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_bytes(gzip.compress(plain.getvalue(), compresslevel=9, mtime=0))
    manifest = {
        "commit": commit or old["commit"],
        "archive": {"name": out.name, **describe(out.read_bytes())},
        "files": files,
    }
    write_manifest(root, manifest)
    return manifest


def read_archive(content: bytes) -> Iterator[tuple[str, bytes]]:
    """Give the path and the content of each file of an archive."""
    try:
        with tarfile.open(fileobj=io.BytesIO(content)) as archive:
            for member in archive:
                opened = archive.extractfile(member) if member.isfile() else None
                if opened is not None:
                    yield member.name, opened.read()
    except (tarfile.TarError, EOFError, OSError) as error:
        raise ResultsError(f"the archive cannot be read: {error}") from error


def read_commit(root: Path, commit: str, paths: Sequence[str]) -> bytes | None:
    """Return an archive of some files at a commit; None where git or the commit is missing."""
    command = ["git", "archive", "--format=tar", commit, "--", *paths]
    try:
        made = subprocess.run(command, cwd=root, capture_output=True, check=False)
    except FileNotFoundError:
        return None
    return made.stdout if made.returncode == 0 else None


def download(url: str) -> bytes:
    """Download an archive."""
    if "/OWNER" in url:
        raise ResultsError(
            "the project is not published yet, so there is no release to fetch from; "
            "use a git checkout with its history, or --archive FILE"
        )
    if not url.startswith("https://"):
        raise ResultsError(f"{url} is not an address that begins with https://")
    try:
        with urllib.request.urlopen(url, timeout=TIMEOUT) as answer:
            content: bytes = answer.read()
    except urllib.error.URLError as error:
        raise ResultsError(f"{url} cannot be downloaded: {error}") from error
    return content


def find_source(root: Path, manifest: dict[str, Any], archive: str | None, rows: set[str]) -> bytes:
    """Return the archive of some rows: the given one, else the commit's, else the release's."""
    if archive is not None and "://" not in archive:
        try:
            return Path(archive).read_bytes()
        except OSError as error:
            raise ResultsError(f"{archive} cannot be read: {error}") from error
    if archive is None and manifest["commit"]:
        paths = sorted(path for path in manifest["files"] if name_row(path) in rows)
        found = read_commit(root, manifest["commit"], paths)
        if found is not None:
            return found
    content = download(archive or RELEASES + manifest["archive"]["name"])
    if archive is None and describe(content)["sha256"] != manifest["archive"]["sha256"]:
        raise ResultsError("the archive of the release is not the one that the manifest lists")
    return content


def fetch(
    root: Path, rows: Sequence[str], archive: str | None = None, *, replace: bool = False
) -> list[str]:
    """Restore the files of some rows to their places, and return their paths.

    Nothing is written if a file is missing in the source or differs from the manifest, or if one
    in the tree differs from it and `replace` is false.
    """
    manifest = read_manifest(root)
    wanted = choose_files(manifest, rows)
    present = {path: (root / path).read_bytes() for path in wanted if (root / path).is_file()}
    changed = [path for path, content in present.items() if describe(content) != wanted[path]]
    if changed and not replace:
        raise ResultsError(f"{changed[0]} differs from the manifest; --replace overwrites it")
    lacking = [path for path in wanted if path not in present or path in changed]
    if lacking:
        source = find_source(root, manifest, archive, {name_row(path) for path in lacking})
        contents = dict(read_archive(source))
        for path in lacking:
            if path not in contents:
                raise ResultsError(f"the archive has no {path}")
            if describe(contents[path]) != wanted[path]:
                raise ResultsError(f"{path} of the archive differs from the manifest")
        for path in lacking:
            place = root / path
            place.parent.mkdir(parents=True, exist_ok=True)
            part = place.with_name(place.name + ".part")
            part.write_bytes(contents[path])
            os.replace(part, place)
    return list(wanted)


def check(root: Path, rows: Sequence[str], archive: str | None = None) -> tuple[str, bool]:
    """Compare files with the manifest; return a report, and whether all that is there agrees.

    Files of the tree are compared, or those of an archive. Rows of the tree that were not fetched
    are counted, but are no fault; an archive must have all files.
    """
    manifest = read_manifest(root)
    wanted = choose_files(manifest, rows)
    if archive is None:
        paths = (path for path in list_files(root) if not rows or name_row(path) in rows)
        contents = {path: (root / path).read_bytes() for path in paths}
    else:
        found = read_archive(find_source(root, manifest, archive, set(rows)))
        contents = {path: one for path, one in found if not rows or name_row(path) in rows}
    listed = [path for path in contents if path in wanted]
    different = [path for path in listed if describe(contents[path]) != wanted[path]]
    extra = [path for path in contents if path not in wanted]
    missing = [path for path in wanted if path not in contents]
    lines = [f"differs: {path}" for path in different] + [f"not listed: {path}" for path in extra]
    agreeing = f"{len(listed) - len(different)} of {len(wanted)} files agree with the manifest"
    lines.append(f"{agreeing}, {len(missing)} are missing")
    return "\n".join(lines), not (different or extra or (archive is not None and missing))


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    """Parse the arguments."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--root", type=Path, default=ROOT, help="folder of the repository")
    commands = parser.add_subparsers(dest="command", required=True)
    packing = commands.add_parser("pack", help="write the archive of a release, and the manifest")
    packing.add_argument("--out", type=Path, required=True, metavar="FILE", help="the .tar.gz")
    packing.add_argument("--commit", help="commit that has the files (default: as before)")
    fetching = commands.add_parser("fetch", help="restore rows to their places")
    checking = commands.add_parser("check", help="compare files with the manifest")
    for one in (fetching, checking):
        one.add_argument("rows", nargs="*", metavar="ROW", help="such as crossing-ppo-0 or racer")
        one.add_argument("--archive", metavar="FILE", help="file or https address of an archive")
    fetching.add_argument("--all", action="store_true", help="fetch all rows")
    fetching.add_argument("--replace", action="store_true", help="overwrite files that differ")
    arguments = parser.parse_args(argv)
    if arguments.command == "fetch" and arguments.all == bool(arguments.rows):
        parser.error("name the rows to fetch, or use --all")
    return arguments


def main(argv: Sequence[str] | None = None) -> None:
    """Run a command; exit with 1 if results differ, and with a message on an error."""
    given = parse(argv)
    try:
        if given.command == "pack":
            about = pack(given.root, given.out, given.commit)["archive"]
            print(f"{given.out}: {about['size']} bytes, SHA-256 {about['sha256']}")
        elif given.command == "fetch":
            paths = fetch(given.root, given.rows, given.archive, replace=given.replace)
            for folder in sorted({str(PurePosixPath(path).parent) for path in paths}):
                print(folder)
        else:
            text, agrees = check(given.root, given.rows, given.archive)
            print(text)
            sys.exit(not agrees)
    except ResultsError as error:
        sys.exit(f"results: {error}")


if __name__ == "__main__":
    main()
