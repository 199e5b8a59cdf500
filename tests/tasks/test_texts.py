"""What `bulletuav tasks NAME --all` prints contradicts neither the code nor itself."""

import inspect
import re
from dataclasses import dataclass

import pytest

import bulletuav
from bulletuav.cli import main
from bulletuav.commands.task_description import (
    difficulties_table,
    ends_table,
    option_texts,
    options_table,
    reward_table,
)
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.tasks import TaskConfig, find_task
from bulletuav.tasks.ends import leaves_arena

TASKS = bulletuav.list_tasks()


def rows(table):
    """Rows of a table, as lists of texts."""
    return [list(row) for row in zip(*(column.cells for column in table.columns), strict=True)]


@pytest.fixture(params=TASKS)
def printed(request, capsys, monkeypatch):
    """A task's class, its defaults, and what is printed of it, on one line."""
    monkeypatch.setenv("COLUMNS", "2000")
    main(["tasks", request.param, "--all"])
    said = " ".join(capsys.readouterr().out.split())
    return find_task(request.param), EnvSpec(request.param, 1, {}), said


def ends_outside(task, spec):
    """Whether drones outside of the arena end, with the defaults."""
    return leaves_arena in task.ends or getattr(spec.task.config, "boundary", "") == "end"


def test_the_text_says_each_thing_once(printed):
    _, spec, said = printed
    d_safe = spec.task.config.d_safe
    described = re.findall(r"d_safe(?: =| is|:)? (\d+(?:\.\d+)?)(?= m|,)", said)
    assert all(float(one) == d_safe for one in described)
    for far, near in re.findall(r"from 0 at (\d+) m to 1 at (\d+) m", said):
        assert (float(far), float(near)) == (spec.task.zone, d_safe)
    horizons = re.findall(r"(?:[Tt]runcated a|A)fter (\d+) decisions", said)
    assert [int(one) for one in horizons] == [spec.options.horizon] * 2  # in words, and in a table
    assert "Difficulties (" not in said  # which a table tells
    for heading in ("Observation,", "Action,", "Reward per decision,", "End:", "Success:"):
        assert said.count(f" {heading}") == 1


def test_the_text_ends_episodes_where_the_task_does(printed):
    task, spec, said = printed
    (end,) = re.findall(r" End: (.*?) Success:", said)
    assert ("outside" in end) == ends_outside(task, spec)
    assert ("stop at" in end) == (spec.task.rebound == 0.0)
    names = [row[0] for row in rows(ends_table(task))]
    assert names[-1] == "horizon"
    assert ("battery" in names) == (spec.options.battery_capacity is not None)
    assert set(names) >= {one.__name__ for one in task.ends}
    boundary = [row[1] for row in rows(ends_table(task)) if row[0] == "boundary"]
    assert boundary == [repr(getattr(spec.task.config, "boundary", ""))] * len(boundary)


def test_presets_that_the_text_names_can_be_asked_for(printed):
    task, _, said = printed
    named = set(re.findall(r"Preset (\w+):", said))
    assert named == set(task.presets)
    for preset in named:
        EnvSpec(task.name, 1, {"preset": preset})


@pytest.mark.parametrize("name", TASKS)
def test_tables_hold_what_the_code_does(name):
    task = find_task(name)
    spec = EnvSpec(name, 1, {})
    table = rows(reward_table(task))
    weights = {term: float(weight) for term, weight, *_ in table}
    if not getattr(spec.task.config, "num_obstacles", 0):
        # Without obstacles there is nothing to warn of.
        weights.pop("obstacle_warning", None)
        spec.task.weights.pop("obstacle_warning", None)
    assert weights == spec.task.weights
    assert all(about for *_, about in table)
    if task.training_weights:
        trained = EnvSpec(name, 1, {"reward": "training"}).task.weights
        in_training = {term: float(weight) for term, _, weight, _ in table}
        assert in_training.items() >= trained.items() - {("obstacle_warning", 0.0)}
    values = dict(rows(difficulties_table(task)))
    assert set(values) == {
        *(f"difficulty {one}" for one in task.difficulties),
        *(f"preset {one}" for one in task.presets),
    }
    for one, options in task.difficulties.items():
        for option, value in options.items():
            assert f"{option}={value!r}" in values[f"difficulty {one}"]
    options = {option: (default, about) for option, default, about in rows(options_table(task))}
    assert options["horizon"][0] == repr(task.defaults["horizon"])
    assert options["d_safe"][0] == repr(spec.task.config.d_safe)
    assert all(about for _, about in options.values())


def test_options_are_told_by_the_nearest_class():
    described = option_texts(find_task("los").Config)
    assert described["boundary"].startswith("Behaviour at the bounds, by default")
    assert described["contact_ends"].endswith('or of its whole "world".')
    assert "d_safe" in described


def test_own_tasks_describe_inherited_options():
    """Also those whose default they change, with and without a docstring of their own."""

    @dataclass(frozen=True)
    class Bare(TaskConfig):
        d_safe: float = 3.0

    @dataclass(frozen=True)
    class Documented(Bare):
        """Options.

        Attributes:
            size: Size, m.
        """

        d_safe: float = 4.0
        size: float = 1.0

    usual = option_texts(TaskConfig)
    assert usual["d_safe"].startswith("Separation below which")
    assert option_texts(Bare) == usual
    assert option_texts(Documented) == {**usual, "size": "Size, m."}


def test_bases_are_not_printed(printed):
    task, _, said = printed
    for base in inspect.getmro(task)[1:]:
        if base.__module__.startswith("bulletuav.tasks.parts"):
            assert inspect.getdoc(base).partition("\n")[0] not in said
