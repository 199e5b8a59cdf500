"""Tasks of other packages, by entry point, and by their class."""

import sys
import textwrap

import pytest

import bulletuav
from bulletuav import registry
from bulletuav.tasks import find_task

HOVER_HIGHER = """
    from bulletuav.tasks.hover import Hover

    class Higher(Hover):
        name = "higher"

    not_a_task = 5
    """


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Installs a package with entry points, as pip leaves it: install(name="module:Class", ...)."""
    # A module that is first imported here would be registered in this test only
    for kind in registry.PACKAGES:
        registry.names(kind)
    registered = {kind: dict(table) for kind, table in registry._registered.items()}
    monkeypatch.setattr(registry, "_registered", registered)
    monkeypatch.setattr(registry, "_loaded", registry._loaded - {"task"})

    def with_entry_points(**points):
        (tmp_path / "other_package.py").write_text(textwrap.dedent(HOVER_HIGHER))
        info = tmp_path / "other_package-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: other-package\nVersion: 1.0\n")
        lines = [f"{name} = {place}" for name, place in points.items()]
        (info / "entry_points.txt").write_text("\n".join(["[bulletuav.task]", *lines, ""]))
        monkeypatch.syspath_prepend(tmp_path)

    yield with_entry_points
    sys.modules.pop("other_package", None)


def test_tasks_of_another_package_are_found(install):
    install(higher="other_package:Higher")
    assert "higher" in bulletuav.list_tasks()
    assert bulletuav.list_tasks() == sorted(bulletuav.list_tasks())
    aviary = bulletuav.Aviary("higher", height=7.0)
    aviary.reset(seeds=0)
    assert aviary.scene.goal[0, 0, 2] == 7
    aviary.close()


@pytest.mark.parametrize("place", ["other_package:Nothing", "no_package:Task"])
def test_an_entry_point_to_nothing_is_left_out_with_a_warning(install, place):
    install(broken=place, higher="other_package:Higher")
    with pytest.warns(UserWarning, match="entry point 'broken' of bulletuav.task is ignored"):
        found = bulletuav.list_tasks()
    assert "higher" in found
    assert "crossing" in found
    assert "broken" not in found


def test_a_class_is_a_task_without_being_installed():
    class Low(find_task("hover")):
        name = "low"

    env = bulletuav.parallel_env(Low, height=1.0)
    env.reset(seed=0)
    assert env.metadata["name"] == "bulletuav_low_v2"
    env.close()
    result = bulletuav.evaluate(Low, "random", 2, action="velocity", horizon=5)
    assert result.about["task"] == "low"
