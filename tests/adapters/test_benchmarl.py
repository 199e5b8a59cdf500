"""What the adapter of BenchMARL says where it cannot run.

BenchMARL needs an older TorchRL than the suite has: it runs by hand, see `clients`.
"""

import importlib
import importlib.metadata
import sys

import pytest


def imported_with(monkeypatch, **versions):
    """Import the adapter where these versions are installed, and nothing else."""

    def version(name):
        if name not in versions:
            raise importlib.metadata.PackageNotFoundError(name)
        return versions[name]

    monkeypatch.setattr(importlib.metadata, "version", version)
    monkeypatch.delitem(sys.modules, "bulletuav.adapters.benchmarl", raising=False)
    importlib.import_module("bulletuav.adapters.benchmarl")


@pytest.mark.parametrize("versions", [{}, {"torchrl": "0.11.1"}], ids=str)
def test_the_extra_is_named_where_it_is_missing(monkeypatch, versions):
    monkeypatch.setitem(sys.modules, "benchmarl.algorithms", None)
    with pytest.raises(ImportError, match=r"constraints/benchmarl\.txt .*\[benchmarl\]'"):
        imported_with(monkeypatch, **versions)


@pytest.mark.parametrize("torchrl", ["0.12.0", "0.14.1", "1.0.0"])
def test_a_later_torchrl_is_refused_in_one_line(monkeypatch, torchrl):
    with pytest.raises(ImportError) as error:
        imported_with(monkeypatch, torchrl=torchrl)
    told = str(error.value)
    assert f"torchrl below 0.12, and {torchrl} is installed" in told
    assert "exclude each other" in told
    assert "[benchmarl]" in told
    assert "\n" not in told
