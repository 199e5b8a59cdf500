"""Build the source distribution and a wheel twice, check them, and print their hashes.

    python tools/release.py --out dist

It builds what is committed, in two folders of different names. Files of a release are only those
that came out alike, to the last byte. On x86-64, the wheel gets machine code for three levels of
processors (see `tools/build_code.py`), which takes half an hour; `--no-code` leaves it out. It
needs the extra `dev`. Wheels for other systems are made by cibuildwheel, as `pyproject.toml` says,
from the source distribution.

Next to them it writes the release notes, and a list of the wheel's parts and dependencies (a
CycloneDX SBOM). Dependencies with known vulnerabilities, or which cannot be checked for any, end
the release before anything is built; `--no-audit` leaves this check out.
"""

import argparse
import gzip
import hashlib
import io
import json
import os
import platform
import re
import runpy
import shutil
import subprocess
import sys
import tarfile
import tempfile
import tomllib
import zipfile
from pathlib import Path
from typing import Any

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
    done = subprocess.run(
        [str(word) for word in command],
        cwd=folder,
        env={**os.environ, **variables},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise SystemExit(f"{' '.join(map(str, command))} failed:\n{done.stdout}{done.stderr}")
    return done.stdout


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


def read_version(source: Path) -> str:
    """Return the version of the package in a folder of sources."""
    return runpy.run_path(str(source / "bulletuav" / "version.py"))["__version__"]  # type: ignore[no-any-return]


def read_notes(changelog: str, version: str) -> str:
    """Return the section of a version in a changelog, without its heading."""
    section = rf"^## {re.escape(version)}(?: [^\n]*)?\n(.*?)(?=^## |\Z)"
    found = re.search(section, changelog, re.MULTILINE | re.DOTALL)
    if found is None:
        raise SystemExit(f"CHANGELOG.md has no section of version {version}")
    return found[1].strip() + "\n"


def install_dependencies(source: Path, place: Path) -> Path:
    """Install the package's dependencies, at the versions of constraints.txt.

    Args:
        source: Folder of the sources.
        place: Folder of the new virtual environment, which has nothing else.

    Returns:
        Its Python interpreter.
    """
    run(sys.executable, "-m", "venv", "--without-pip", place)
    (python,) = {*place.glob("bin/python"), *place.glob("Scripts/python.exe")}
    project = tomllib.loads((source / "pyproject.toml").read_text())["project"]
    pip = (sys.executable, "-m", "pip", "--python", python, "install", "--no-compile")
    run(*pip, "--only-binary", ":all:", "-c", source / "constraints.txt", *project["dependencies"])
    return python


def audit(python: Path) -> None:
    """Leave unless all packages of an environment are free of known vulnerabilities."""
    find = "import sysconfig; print(sysconfig.get_path('purelib'))"
    packages = run(python, "-c", find).strip()
    command = (sys.executable, "-m", "pip_audit", "--progress-spinner", "off", "--format", "json")
    # It ends with an error both where it finds a vulnerability and where it cannot look for any
    done = subprocess.run(
        [*command, "--path", packages], capture_output=True, text=True, check=False
    )
    print(judge_audit(done.stdout, done.stderr))


def judge_audit(report: str, errors: str) -> str:
    """Return the result of an audit that checked all packages and found nothing; leave otherwise.

    Args:
        report: What pip-audit printed as JSON; anything else if it failed.
        errors: What it printed on standard error.
    """
    without = "pass --no-audit to build without an audit"
    try:
        packages = json.loads(report)["dependencies"]
    except json.JSONDecodeError:
        cause = (errors.strip() or "pip-audit printed nothing").splitlines()[-1]
        raise SystemExit(f"no package was audited; {without}: {cause}") from None
    for one in packages:
        for found in one.get("vulns", []):
            better = ", ".join(found["fix_versions"]) or "none"
            print(f"{one['name']} {one['version']}: {found['id']}, fixed in {better}")
    if any(one.get("vulns") for one in packages):
        raise SystemExit("dependencies have known vulnerabilities: no release")
    skipped = [one["skip_reason"] for one in packages if "skip_reason" in one]
    if skipped or not packages:
        cause = skipped[0] if skipped else "no package was found"
        count = f"{len(skipped)} of {len(packages)} packages were not audited"
        raise SystemExit(f"{count}; {without}: {cause}")
    return f"no known vulnerability in {len(packages)} packages"


def list_parts(source: Path, python: Path) -> dict[str, Any]:
    """List the package's dependencies, and what the wheel has of others, as a CycloneDX SBOM.

    Args:
        source: Folder of the sources.
        python: Interpreter of an environment with nothing but the dependencies.
    """
    command = (sys.executable, "-m", "cyclonedx_py", "environment", "--output-reproducible")
    about = ("--mc-type", "library", "--pyproject", source / "pyproject.toml")
    # With a time in the environment, it would write it to the list
    parts: dict[str, Any] = json.loads(run(*command, *about, python, SOURCE_DATE_EPOCH=""))
    (version,) = re.findall(
        r"^\| three\.js.*\| ([\d.]+) \|", (source / "THIRD_PARTY.md").read_text(), re.MULTILINE
    )
    parts["components"].append(
        {
            "bom-ref": f"three=={version}",
            "licenses": [{"license": {"acknowledgement": "declared", "id": "MIT"}}],
            "name": "three",
            "purl": f"pkg:npm/three@{version}",
            "type": "library",
            "version": version,
        }
    )
    return parts


def write_parts(parts: dict[str, Any], wheel: Path, out: Path) -> Path:
    """Write an SBOM with the name, the version and the hash of the wheel to a folder."""
    name, version, *_ = wheel.name.split("-")
    parts["metadata"]["component"] |= {
        "version": version,
        "purl": f"pkg:pypi/{name}@{version}",
        "hashes": [{"alg": "SHA-256", "content": hash_of(wheel)}],
    }
    path = out / f"{name}-{version}.cdx.json"
    path.write_text(json.dumps(parts, indent=2, sort_keys=True) + "\n")
    return path


def hash_of(path: Path) -> str:
    """Hash a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def main() -> None:
    """Build twice, compare, check, and keep."""
    parser = argparse.ArgumentParser(description="Build a release, twice, and check it.")
    parser.add_argument("--out", type=Path, default=Path("dist"), help="folder for the files")
    parser.add_argument("--no-code", action="store_true", help="leave out the machine code")
    parser.add_argument(
        "--no-audit", action="store_true", help="do not look for vulnerabilities of dependencies"
    )
    arguments = parser.parse_args()
    out = arguments.out
    epoch = int(run("git", "log", "-1", "--format=%ct"))
    with tempfile.TemporaryDirectory() as name:
        source = unpack(Path(name, "parts"))
        notes = read_notes((source / "CHANGELOG.md").read_text(), read_version(source))
        python = install_dependencies(source, Path(name, "dependencies"))
        if arguments.no_audit:
            print("dependencies were not audited: --no-audit")
        else:
            audit(python)
        parts = list_parts(source, python)
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
        (out / "NOTES.md").write_text(notes)
        kept = [Path(shutil.copy(path, out)) for path in first]
        for path in (*kept, write_parts(parts, first[1], out)):
            print(hash_of(path), path)


if __name__ == "__main__":
    main()
