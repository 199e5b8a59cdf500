"""Programs of version 0.1 that build tasks on families."""

import importlib
from typing import ClassVar

import numpy as np
import pytest

import bulletuav
from bulletuav.tasks import find_task
from bulletuav.tasks.families import FORMER
from bulletuav.tasks.ingredients import FORMER_NAMES, reward


@pytest.mark.parametrize(
    ("module", "name", "present"),
    [(module, *names) for module, table in FORMER.items() for names in table.items()],
)
def test_a_former_name_warns_and_gives_the_present_object(module, name, present):
    former = importlib.import_module(f"bulletuav.tasks.families.{module}")
    with pytest.warns(DeprecationWarning, match=f"{module}.{name} is now {present}; .* next rel"):
        found = getattr(former, name)
    home, _, last = present.rpartition(".")
    assert found is getattr(importlib.import_module(home), last)


def test_an_unknown_name_of_a_former_module_is_an_attribute_error():
    former = importlib.import_module("bulletuav.tasks.families.airspace")
    with pytest.raises(AttributeError, match="has no attribute 'Sky'"):
        _ = former.Sky


def test_a_task_on_a_family_flies_as_one_on_goal_flight():
    former = "bulletuav.tasks.families"
    airspace, difficulties, options = (
        importlib.import_module(f"{former}.{module}")
        for module in ("airspace", "difficulties", "flight_config")
    )
    with pytest.warns(DeprecationWarning, match="next release"):
        family, config_class = airspace.Airspace, options.AirspaceConfig
    with pytest.warns(DeprecationWarning, match="next release"):
        circle_arena, levels = options.circle_arena, difficulties.AIRSPACE_DIFFICULTIES

    class Flown(family[config_class]):
        """A ring of drones, each of which flies to where its neighbour was."""

        name = "flown"
        difficulties: ClassVar = {"medium": levels["medium"]}

        def __init__(self, config, context):
            super().__init__(config, context)
            self.arena_low, self.arena_high = circle_arena(config, context, 40.0)

        def spawn(self, rng):
            """Start on a ring."""
            angle = 2 * np.pi * np.arange(self.context.num_drones) / self.context.num_drones
            height = np.full(len(angle), self.config.altitude)
            ring = np.stack([40 * np.cos(angle), 40 * np.sin(angle), height], axis=1)
            return self.launch(self.config.scattered(ring, rng), np.roll(ring, 1, axis=0), rng)

    env = bulletuav.parallel_env(Flown, dynamics="point_mass", num_obstacles=3, boundary="soft")
    observations, _ = env.reset(seed=0)
    assert len(observations) == 8
    observations, rewards, *_ = env.step({agent: np.ones(3) for agent in env.agents})
    assert all(np.isfinite(reward) for reward in rewards.values())
    env.close()


@reward
def of_way(way):
    return way


@reward
def of_way_before(way_before):
    return way_before


@reward
def of_all(all_first_way):
    return all_first_way[0]


@pytest.mark.parametrize("term", [of_way, of_way_before, of_all])
def test_a_former_argument_is_an_error_that_names_the_present_one(term):
    (asked,) = term.__code__.co_varnames
    present = FORMER_NAMES[asked.removeprefix("all_")]

    class Own(find_task("crossing")):
        name = "own"
        reward: ClassVar = {"own": (term, 1.0)}

    with pytest.raises(ValueError, match=f"asks for '{asked}', .*did you mean .*{present}'"):
        bulletuav.Aviary(Own, dynamics="point_mass")


def test_every_former_argument_has_a_present_one():
    @reward
    def present(remaining_distance, remaining_distance_before, initial_distance):
        return remaining_distance + remaining_distance_before + initial_distance

    assert set(present.__code__.co_varnames) == set(FORMER_NAMES.values())

    class Own(find_task("crossing")):
        name = "own"
        reward: ClassVar = {"own": (present, 1.0)}

    aviary = bulletuav.Aviary(Own, num_drones=2, dynamics="point_mass")
    aviary.reset(seeds=0)
    rewards = aviary.step(np.zeros((1, 2, 3))).rewards
    aviary.close()
    assert (rewards > 3 * aviary.task.config.goal_radius).all()
