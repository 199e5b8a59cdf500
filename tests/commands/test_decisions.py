"""The benchmark of short decisions writes what it measured."""

import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / "benchmarks"))
import decisions  # noqa: E402


class Fixed:
    """A server of rates that fall with the number of drones."""

    def __init__(self, share):
        self.share = share

    def rate(self, case, seconds):
        drones = int(case.split(", ")[1])
        return self.share * 1e5 / drones


@pytest.mark.parametrize("peer", [None, Fixed(0.1)])
def test_rates_are_measured_in_turn_and_drawn(peer, tmp_path):
    rows = decisions.measure(Fixed(1.0), peer, 3, 0.1)
    assert len(rows) == 12 * (1 if peer is None else 3)
    assert ("bulletuav", 10, 48, 1e4) in rows
    assert (("bare", 100, 240, 100.0) in rows) == (peer is not None)
    decisions.draw(rows, tmp_path / "rates.png")
    assert np.asarray(Image.open(tmp_path / "rates.png")).std() > 1


def test_a_decision_is_made_of_its_parts(tmp_path):
    made = decisions.parts("rigid_body")
    assert list(made) == ["flight", "other stages", "around the program", "agents' dictionaries"]
    assert made["flight"] > 0
    assert sum(made.values()) > 1
    decisions.draw_parts({"rigid_body": made}, tmp_path / "parts.png")
    assert np.asarray(Image.open(tmp_path / "parts.png")).std() > 1
