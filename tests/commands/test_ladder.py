"""The benchmark of the dynamics' errors and costs."""

import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / "benchmarks"))
import ladder  # noqa: E402


@pytest.mark.parametrize("kind", ladder.KINDS)
def test_flights_of_fine_steps_are_those_of_the_equations(kind):
    flight = ladder.draw(np.random.default_rng(1), kind)._replace(seconds=0.05)
    end = ladder.solve(flight)
    assert np.linalg.norm(end - flight.position) > 1e-4
    # Wakes are held within a substep, which is of first order
    tolerance = 1e-4 if kind == "in a wake" else 1e-8
    np.testing.assert_allclose(ladder.fly(flight, "rigid_body", 960), end, atol=tolerance)


def test_table_and_picture_show_all_rows(tmp_path, capsys):
    ladder.main([f"--out={tmp_path}", "--flights=1", "--rates", "120", "--rounds=1"])
    page = (tmp_path / "ladder.md").read_text()
    assert capsys.readouterr().out.endswith(page)
    assert page.count("| 120 |") == len(ladder.DYNAMICS)
    assert page.count("| - | - | - | - |") == len(ladder.DYNAMICS) - len(ladder.NEWTONIAN)
    assert np.asarray(Image.open(tmp_path / "ladder.png")).std() > 1
