"""Build the source distribution and a wheel twice, check them, and print their hashes.

    python tools/release.py --out dist

It builds what is committed, in two folders of different names. Files of a release are only those
that came out alike, to the last byte. On x86-64, the wheel gets machine code for three levels of
processors (see `tools/build_code.py`), which takes half an hour; `--no-code` leaves it out. It
needs the extra `dev`. Wheels for other systems are made by cibuildwheel, as `pyproject.toml` says,
from the source distribution.
"""

import argparse
import gzip
import hashlib
import io
import os
import platform
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
CODE = "bulletuav/compiled/shipped"
"""Folder of the machine code in the sources and in a wheel"""
MAX_SIZE = 25.0
"""Maximum size of a wheel, MB"""


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


def unpack(place: Path) -> Path:
    """Copy what is committed to a new folder, and return the folder."""
    source = place / "source"
    source.mkdir(parents=True)
    archive = place / "source.tar"
    run("git", "archive", "-o", archive, "HEAD")
    with tarfile.open(archive) as packed:
        packed.extractall(source, filter="data")
    return source


def build_code(place: Path, out: Path) -> None:
    """Build the machine code of what is committed.

    Args:
        place: Folder for the sources, and for a wheel without machine code, which builds it.
        out: Folder for the machine code.
    """
    source, package = unpack(place), place / "package"
    run(sys.executable, "-m", "build", "--wheel", "--outdir", place, source)
    (wheel,) = place.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(package)
    command = [sys.executable, str(source / "tools" / "build_code.py"), "--out", str(out)]
    variables = {"PYTHONPATH": str(package), "NUMBA_CACHE_DIR": str(place / "cache")}
    subprocess.run(command, cwd=place, env={**os.environ, **variables}, check=True)


def build(place: Path, epoch: int, code: Path) -> list[Path]:
    """Build what is committed.

    Args:
        place: Folder for the sources and the files.
        epoch: Time that files in archives get, s since 1970.
        code: Folder of the wheel's machine code; there is none if the folder is absent.

    Returns:
        The source distribution, and the wheel.
    """
    source, out = unpack(place), place / "dist"
    # The source distribution is for any processor: the code is added after it
    for kind in ("--sdist", "--wheel"):
        command = (sys.executable, "-m", "build", kind, "--outdir", out, source)
        run(*command, SOURCE_DATE_EPOCH=str(epoch))
        if kind == "--sdist" and code.is_dir():
            shutil.copytree(code, source / CODE)
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


def check_wheel(wheel: Path, code: Path) -> None:
    """Leave unless a wheel has all modules, assets and machine code, and nothing else."""
    names = zipfile.ZipFile(wheel).namelist()
    size = wheel.stat().st_size / 1e6
    if size > MAX_SIZE:
        raise SystemExit(f"{wheel.name} has {size:.1f} MB, more than {MAX_SIZE:.0f} MB")
    modules = {str(path.relative_to(ROOT)) for path in ROOT.glob("bulletuav/**/*.py")}
    modules |= {f"{CODE}/{path.relative_to(code).as_posix()}" for path in code.glob("*/*")}
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
    parser.add_argument("--no-code", action="store_true", help="leave out the machine code")
    arguments = parser.parse_args()
    out = arguments.out
    epoch = int(run("git", "log", "-1", "--format=%ct"))
    with tempfile.TemporaryDirectory() as name:
        code = Path(name, "code")
        if not arguments.no_code and platform.machine() in ("x86_64", "AMD64"):
            build_code(Path(name, "unshipped"), code)
        places = (Path(name) / one for one in ("one", "another-name"))
        first, second = (build(place, epoch, code) for place in places)
        for mine, other in zip(first, second, strict=True):
            if hash_of(mine) != hash_of(other):
                raise SystemExit(f"two builds of {mine.name} differ: no release")
        check_wheel(first[1], code)
        print(run(sys.executable, "-m", "twine", "check", "--strict", *first), end="")
        out.mkdir(parents=True, exist_ok=True)
        for path in first:
            shutil.copy(path, out)
            print(hash_of(path), out / path.name)


if __name__ == "__main__":
    main()
