"""The release tool: notes, parts of the wheel, and the audit of dependencies."""

import hashlib
import json
import sys
from pathlib import Path

import pytest

from bulletuav.version import __version__

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "tools"))

import release  # noqa: E402

CHANGELOG = """# Changelog

## Unreleased

- later

## 0.9.0 - 2026-11-27

### Added

- this

## 0.9

- before
"""


def test_notes_are_the_section_of_the_version():
    assert release.read_notes(CHANGELOG, "0.9.0") == "### Added\n\n- this\n"
    assert release.read_notes(CHANGELOG, "0.9") == "- before\n"


def test_a_version_without_notes_is_not_released():
    with pytest.raises(SystemExit, match=r"no section of version 1\.0"):
        release.read_notes(CHANGELOG, "1.0")


def test_this_version_has_notes_of_a_length_that_is_read():
    assert release.read_version(ROOT) == __version__
    notes = release.read_notes((ROOT / "CHANGELOG.md").read_text(), __version__)
    entries = [line for line in notes.splitlines() if line.startswith(("-", "#"))]
    assert 0 < len(entries) <= 60


def report(*packages):
    return json.dumps({"dependencies": packages, "fixes": []})


CHECKED = {"name": "numpy", "version": "2.4.6", "vulns": []}
SKIPPED = {"name": "rich", "skip_reason": "Dependency not found on PyPI"}
FOUND = {"id": "CVE-1", "fix_versions": ["14"], "aliases": [], "description": ""}


def test_an_audit_that_found_nothing():
    found = release.judge_audit(report(CHECKED, {**CHECKED, "name": "scipy"}), "")
    assert found == "no known vulnerability in 2 packages"


@pytest.mark.parametrize(
    ("printed", "errors", "cause"),
    [
        # What pip-audit calls "no known vulnerabilities", with exit code 0
        (report(CHECKED, SKIPPED), "", "1 of 2 packages were not audited.*not found on PyPI"),
        (report(), "", "no package was found"),
        ("", "ConnectionError: ...\nFailed to resolve\n", "no package was audited.*to resolve"),
        ("", "", "printed nothing"),
    ],
)
def test_an_audit_that_could_not_look_ends_the_release(printed, errors, cause):
    with pytest.raises(SystemExit, match=f"{cause}") as ended:
        release.judge_audit(printed, errors)
    assert "--no-audit" in str(ended.value)


def test_a_vulnerability_ends_the_release(capsys):
    with pytest.raises(SystemExit, match="known vulnerabilities"):
        release.judge_audit(report(SKIPPED, {**CHECKED, "vulns": [FOUND]}), "")
    assert capsys.readouterr().out == "numpy 2.4.6: CVE-1, fixed in 14\n"


def test_parts_of_a_wheel(tmp_path, monkeypatch):
    """Its dependencies, the script that it contains, its version and its hash."""
    installed = {"components": [{"name": "numpy"}], "metadata": {"component": {"name": "x"}}}
    monkeypatch.setattr(release, "run", lambda *command, **variables: json.dumps(installed))
    wheel = tmp_path / "bulletuav-1.2.3-py3-none-any.whl"
    wheel.write_bytes(b"wheel")
    parts = release.list_parts(ROOT, Path(sys.executable))
    path = release.write_parts(parts, wheel, tmp_path)
    assert path.name == "bulletuav-1.2.3.cdx.json"
    written = json.loads(path.read_text())
    numpy, three = written["components"]
    assert (numpy["name"], three["name"]) == ("numpy", "three")
    script = (ROOT / "bulletuav" / "report" / "web" / "three.core.min.js").read_text()
    assert f'="{three["version"].split(".")[1]}",' in script
    about = written["metadata"]["component"]
    assert (about["version"], about["purl"]) == ("1.2.3", "pkg:pypi/bulletuav@1.2.3")
    assert about["hashes"][0]["content"] == hashlib.sha256(b"wheel").hexdigest()
