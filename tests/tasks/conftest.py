"""Fixtures of tests of tasks in cities."""

import pytest
from urban import EXACT, FLIGHTS, placed

import bulletuav


@pytest.fixture
def make_urban():
    """Builds aviaries, by default small ones, and closes them."""
    made = []

    def one(task, num_worlds=1, **options):
        small = {} if "city" in options or task == "hover" else {"area": 250.0, "num_layouts": 1}
        if task in FLIGHTS:
            small["leg"] = 100.0
        made.append(
            bulletuav.Aviary(task, num_worlds, **{"dynamics": "rigid_body", **small, **options})
        )
        made[-1].reset(seeds=0)
        return made[-1]

    yield one
    for aviary in made:
        aviary.close()


@pytest.fixture
def put_urban(make_urban):
    """Builds aviaries whose drones start at given places."""

    def one(task, city, position, goal=None, users=None, **options):
        more = {"num_drones": len(position), **({} if users is None else {"num_users": len(users)})}
        return make_urban(
            placed(task, position, goal, users), city=city, **{**EXACT, **more, **options}
        )

    return one
