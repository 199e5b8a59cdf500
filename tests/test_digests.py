"""Digests of a covering set of environments against the table in `digests.txt`.

Continuous integration runs this for several kinds of machine code: see `.ci/run`.
"""

from pathlib import Path

import digests
import pytest

import bulletuav
from bulletuav.engine.calls import HAS_BULLET

TABLE = Path(__file__).with_name("digests.txt").read_text().splitlines()
COVERING = list(digests.variations())[::29]


def test_the_covering_set_has_each_task_and_dynamics():
    assert {one["task"] for one in COVERING} == set(bulletuav.list_tasks())
    assert {one["dynamics"] for one in COVERING if "dynamics" in one} == set(digests.DYNAMICS)


@pytest.mark.slow
@pytest.mark.parametrize("given", COVERING, ids=str)
def test_environments_have_the_digests_of_the_table(given):
    is_same_bullet = HAS_BULLET and digests.machine() in TABLE[0]
    if given.get("dynamics", "bullet") == "bullet" and not is_same_bullet:
        pytest.skip("Bullet's sine and cosine are those of the C library")
    assert digests.line(given) in TABLE
