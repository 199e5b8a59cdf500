"""Build the source distribution and a wheel twice, check them, and print their hashes.

    python tools/release.py --out dist

It builds what is committed, in two folders of different names. Files of a release are only those
that came out alike, to the last byte. It needs the extra `dev`. Wheels for other systems are made
by cibuildwheel, as `pyproject.toml` tells, from the source distribution.
"""

import argparse
import gzip
import hashlib
import io
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
NEEDED = (
    "LICENSE",
    "assets/urdf/cf2x.urdf",
    "assets/tracks/oval.toml",
    "py.typed",
    "report/web/page.html",
    "report/web/three.module.min.js",
    "report/web/three.LICENSE",
    "constraints.txt",
)
"""Ends of names that a wheel has, beside all modules"""


def run(*command: str | Path, folder: Path = ROOT, **variables: str) -> str:
    """Run a command and return what it wrote; leave with its errors where it fails."""
    told = subprocess.run(
        [str(word) for word in command],
        cwd=folder,
        env={**os.environ, **variables},
        capture_output=True,
        text=True,
        check=False,
    )
    if told.returncode:
        raise SystemExit(f"{' '.join(map(str, command))} failed:\n{told.stdout}{told.stderr}")
    return told.stdout


def build(place: Path, epoch: int) -> list[Path]:
    """Build what is committed.

    Args:
        place: Folder for the sources and the files.
        epoch: Time that files in archives get, s since 1970.

    Returns:
        The source distribution, and the wheel that was built from it.
    """
    source = place / "source"
    source.mkdir(parents=True)
    archive = place / "source.tar"
    run("git", "archive", "-o", archive, "HEAD")
    with tarfile.open(archive) as packed:
        packed.extractall(source, filter="data")
    out = place / "dist"
    run(sys.executable, "-m", "build", "--outdir", out, source, SOURCE_DATE_EPOCH=str(epoch))
    (sdist,), (wheel,) = out.glob("*.tar.gz"), out.glob("*.whl")
    level(sdist, epoch)
    return [sdist, wheel]


def level(sdist: Path, epoch: int) -> None:
    """Give all files of a source distribution one time and owner, as setuptools does not."""
    with tarfile.open(sdist) as packed:
        members = [
            (member, packed.extractfile(member).read() if member.isfile() else b"")  # type: ignore[union-attr]
            for member in sorted(packed.getmembers(), key=lambda member: member.name)
        ]
    raw = io.BytesIO()
    with tarfile.open(fileobj=raw, mode="w", format=tarfile.PAX_FORMAT) as packed:
        for member, content in members:
            member.mtime, member.uid, member.gid, member.pax_headers = epoch, 0, 0, {}
            member.uname = member.gname = ""
            packed.addfile(member, io.BytesIO(content))
    with sdist.open("wb") as file, gzip.GzipFile("", "wb", mtime=epoch, fileobj=file) as zipped:
        zipped.write(raw.getvalue())


def check_wheel(wheel: Path) -> None:
    """Leave unless a wheel has all modules and assets, and nothing else."""
    names = zipfile.ZipFile(wheel).namelist()
    modules = {str(path.relative_to(ROOT)) for path in ROOT.glob("bulletuav/**/*.py")}
    missing = sorted(modules - set(names))
    missing += [end for end in NEEDED if not any(name.endswith(end) for name in names)]
    top = {name.split("/")[0] for name in names}
    extra = sorted(one for one in top if one != "bulletuav" and not one.startswith("bulletuav-"))
    if missing or extra:
        raise SystemExit(f"{wheel.name} lacks {missing} and has {extra} beside the package")


def hash_of(path: Path) -> str:
    """Hash a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def main() -> None:
    """Build twice, compare, check, and keep."""
    parser = argparse.ArgumentParser(description="Build a release, twice, and check it.")
    parser.add_argument("--out", type=Path, default=Path("dist"), help="folder for the files")
    out = parser.parse_args().out
    epoch = int(run("git", "log", "-1", "--format=%ct"))
    with tempfile.TemporaryDirectory() as name:
        first, second = (build(Path(name) / one, epoch) for one in ("one", "another-name"))
        for mine, other in zip(first, second, strict=True):
            if hash_of(mine) != hash_of(other):
                raise SystemExit(f"two builds of {mine.name} differ: no release")
        check_wheel(first[1])
        print(run(sys.executable, "-m", "twine", "check", "--strict", *first), end="")
        out.mkdir(parents=True, exist_ok=True)
        for path in first:
            shutil.copy(path, out)
            print(hash_of(path), out / path.name)


if __name__ == "__main__":
    main()
