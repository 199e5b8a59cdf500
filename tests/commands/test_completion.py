"""Words that a shell completes; skipped without the extra."""

import contextlib
import os
import subprocess
import sys

import pytest
from waiting import PATIENCE

from bulletuav.cli import main


def completed(line, tmp_path, forked=True):
    """Words that are offered at the end of a line, by a copy of this process or by another."""
    told = tmp_path / "told"
    asked = {
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_STDOUT_FILENAME": str(told),
        "_ARGCOMPLETE_IFS": "\n",
        "COMP_LINE": line,
        "COMP_POINT": str(len(line)),
    }
    if not forked:
        command = [sys.executable, "-m", "bulletuav"]
        subprocess.run(command, env=os.environ | asked, check=True, timeout=PATIENCE)
    elif (child := os.fork()) == 0:  # a process that has imported the package
        os.environ |= asked
        with contextlib.suppress(BaseException):
            main([])  # exits by itself
        os._exit(1)
    else:
        assert os.waitpid(child, 0)[1] == 0
    return {word.strip() for word in told.read_text().split("\n")}


def test_tasks_policies_and_options_are_offered(tmp_path):
    pytest.importorskip("argcomplete", reason="needs the extra completion")
    assert completed("bulletuav fly cross", tmp_path, forked=False) == {"crossing"}
    assert completed("bulletuav fly crossing --policy orc", tmp_path) == {"orca", "orca_observed"}
    assert completed("bulletuav fly crossing --dyn", tmp_path) == {"--dynamics"}
    assert "replay" in completed("bulletuav re", tmp_path)


def test_without_the_extra_it_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "argcomplete", None)
    monkeypatch.setenv("_ARGCOMPLETE", "1")
    with pytest.raises(ImportError, match=r"\[completion\]"):
        main(["tasks"])
