"""One registry of ingredients by name, by `module:Name`, and from other packages."""

import importlib
import sys
import threading
import types
import warnings
from concurrent.futures import ThreadPoolExecutor

import pytest

from bulletuav import registry
from bulletuav.registry import PACKAGES, find, names, register


def anything(found):
    return True


def is_class(found):
    return isinstance(found, type)


@pytest.fixture(autouse=True)
def own_tables(monkeypatch):
    """What a test registers is forgotten after it."""
    for kind in PACKAGES:
        names(kind)
    tables = {kind: dict(table) for kind, table in registry._registered.items()}
    monkeypatch.setattr(registry, "_registered", tables)
    monkeypatch.setattr(registry, "_loaded", set(registry._loaded))


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Writes a module that can be imported: module("shop", "class Bread: ...")."""
    monkeypatch.syspath_prepend(tmp_path)
    written = []

    def write(name, text):
        (tmp_path / f"{name}.py").write_text(text)
        importlib.invalidate_caches()
        written.append(name)

    yield write
    for name in written:
        sys.modules.pop(name, None)


# Names


@pytest.mark.parametrize("kind", PACKAGES)
def test_names_of_every_kind_are_sorted_words_that_are_found(kind):
    listed = names(kind)
    assert listed or kind == "controller"  # of which the package has a table of its own
    assert listed == sorted(set(listed))
    for name in listed:
        assert name.isidentifier()
        assert find(kind, name, anything) is registry._registered[kind][name]


def test_the_packages_own_ingredients_are_there():
    assert {"gps", "imu", "lidar", "radio", "camera", "clearance", "sight"} <= set(names("sensor"))
    assert {"hover", "crossing", "mec"} <= set(names("task"))
    assert {"bullet", "rigid_body", "point_mass"} <= set(names("dynamics"))
    assert {"straight", "orca", "random"} <= set(names("policy"))
    assert {"velocity", "rotor"} <= set(names("action"))
    assert {"position", "velocity"} <= set(names("observation"))


def test_an_ingredient_is_also_given_as_the_object_itself():
    class Bread:
        pass

    assert find("sensor", Bread, is_class) is Bread
    assert "Bread" not in names("sensor")


# The decorator


def test_the_decorator_gives_a_name_and_leaves_the_object_as_it_is():
    @register("reward")
    def warmth(distance):
        return 1.0

    assert find("reward", "warmth", callable) is warmth
    assert warmth(0) == 1.0
    assert "warmth" in names("reward")
    assert "warmth" not in names("sensor")


def test_the_name_is_that_given_or_the_objects_own_or_that_of_the_code():
    class Bread:
        name = "rye"

    class Cake:
        pass

    assert register("sensor")(Bread) is Bread
    register("sensor")(Cake)
    register("sensor", "crumbs")(Bread)
    assert {"rye", "Cake", "crumbs"} <= set(names("sensor"))
    assert find("sensor", "crumbs", is_class) is Bread
    assert "Bread" not in names("sensor")


def test_an_object_without_code_of_its_own_is_registered_by_its_name():
    class Bread:
        name = "rye"

    one = Bread()
    register("sensor")(one)
    register("sensor")(one)
    assert find("sensor", "rye", anything) is one


@pytest.mark.parametrize("name", ["two words", "my-sensor", "5th", "a:b", "", 5, None])
def test_a_name_that_is_no_word_is_refused(name):
    class Bread:
        pass

    Bread.name = name
    if name in ("", None):  # as if there were none
        register("sensor")(Bread)
        assert find("sensor", "Bread", is_class) is Bread
    else:
        with pytest.raises(ValueError, match="name of sensor .* is .*: a word is needed"):
            register("sensor")(Bread)


def test_what_has_no_name_is_refused():
    with pytest.raises(ValueError, match="name of sensor 5 is None: a word is needed"):
        register("sensor")(5)


def test_a_name_that_is_taken_twice_is_refused_and_the_first_one_stays():
    before = find("sensor", "gps", anything)

    class Other:
        name = "gps"

    with pytest.raises(ValueError, match="sensor 'gps' is registered already: choose another name"):
        register("sensor")(Other)
    assert find("sensor", "gps", anything) is before
    register("reward", "gps")(Other)  # of another kind
    assert find("reward", "gps", anything) is Other


def test_objects_of_one_class_are_not_the_same():
    class Bread:
        name = "rye"

    register("sensor")(Bread())
    with pytest.raises(ValueError, match="'rye' is registered already"):
        register("sensor")(Bread())


def test_what_is_registered_as_another_kind_is_not_found():
    register("sensor", "price")(5)
    with pytest.raises(ValueError, match="'price' is registered as 5: that is no sensor"):
        find("sensor", "price", is_class)


def test_the_same_code_may_come_again_as_by_a_reload(module):
    module("shop", "class Bread:\n    name = 'rye'\n")
    shop = importlib.import_module("shop")
    first = register("sensor")(shop.Bread)
    second = register("sensor")(importlib.reload(shop).Bread)
    assert first is not second
    assert find("sensor", "rye", is_class) is second


# Unknown names and kinds


def test_the_nearest_names_are_told():
    with pytest.raises(ValueError, match=r"unknown sensor 'lidr': did you mean 'lidar'\?"):
        find("sensor", "lidr", anything)
    with pytest.raises(ValueError, match="unknown task 'hoover': did you mean 'hover'"):
        find("task", "hoover", anything)


def test_all_names_are_told_where_none_is_near():
    with pytest.raises(ValueError, match="unknown sensor 'xyzzy': choose from") as error:
        find("sensor", "xyzzy", anything)
    assert str(error.value).endswith(f"choose from {', '.join(names('sensor'))}")


@pytest.mark.parametrize("source", [None, 5, 1.5, ["gps"], b"gps", object()])
def test_what_is_neither_a_name_nor_an_ingredient_is_refused(source):
    with pytest.raises(ValueError, match="unknown sensor .*: choose from"):
        find("sensor", source, is_class)


def test_names_are_taken_as_they_are():
    for name in ("GPS", " gps", "gps ", ""):
        with pytest.raises(ValueError, match="unknown sensor"):
            find("sensor", name, anything)


@pytest.mark.parametrize("ask", [names, lambda kind: find(kind, "gps", anything), register])
def test_unknown_kinds_are_refused_with_the_nearest(ask):
    with pytest.raises(ValueError, match="unknown kind of ingredient 'senser': .* 'sensor'"):
        ask("senser")


# `module:Name`


def test_what_is_in_a_module_is_found_by_it(module):
    module("shop", "class Bread:\n    pass\n\ndef bake():\n    return 5\n")
    bread = find("sensor", "shop:Bread", is_class)
    assert bread.__module__ == "shop"
    assert find("sensor", "shop:Bread", is_class) is bread
    assert find("reward", "shop:bake", callable)() == 5
    assert "Bread" not in names("sensor")


def test_modules_in_packages_are_found_too():
    found = find("sensor", "bulletuav.sensors.gps:Gps", is_class)
    assert found is find("sensor", "gps", is_class)


@pytest.mark.parametrize("name", ["no_such_shop", "no_such_shop.inner", "bulletuav.no_such", "\0"])
def test_a_module_that_is_not_there_is_told(name):
    with pytest.raises(ValueError, match=f"sensor {name}:Bread cannot be imported: "):
        find("sensor", f"{name}:Bread", anything)


@pytest.mark.parametrize("name", ["", ".", ".x", "..x", "x.", "a..b", "bulletuav..sensors"])
def test_what_is_no_whole_name_of_a_module_is_refused(name):
    for attribute in ("Bread", ""):
        with pytest.raises(ValueError, match="cannot be imported: .* no whole name") as error:
            find("sensor", f"{name}:{attribute}", anything)
        assert f"sensor {name}:{attribute} " in str(error.value)
        assert f"{name!r} is no whole name of a module" in str(error.value)


def test_why_a_module_cannot_be_imported_is_told(module):
    module("shop", "import no_such_flour\n")
    with pytest.raises(ValueError, match="shop:Bread cannot be imported: .*no_such_flour"):
        find("sensor", "shop:Bread", anything)


def test_what_a_module_lacks_is_told_with_the_nearest_names(module):
    module("shop", "class Bread:\n    pass\n\n_hidden = 5\n")
    with pytest.raises(ValueError, match="shop:Bred is not there: did you mean 'Bread'"):
        find("sensor", "shop:Bred", anything)
    for name in ("xyzzy", "", "Bread.crumb", "Bread:crumb"):
        with pytest.raises(ValueError, match=f"sensor shop:{name} is not there: ") as error:
            find("sensor", f"shop:{name}", anything)
        assert "Bread" in str(error.value).partition("is not there")[2]
        assert "_hidden" not in str(error.value)


def test_what_is_of_another_kind_is_told(module):
    module("shop", "price = 5\n")
    with pytest.raises(ValueError, match="sensor shop:price is 5: that is no sensor"):
        find("sensor", "shop:price", is_class)


# Other packages


class Point:
    """An entry point."""

    def __init__(self, name, load):
        self.name, self.load = name, load


class Offered(dict):
    """What is offered, by group."""

    def select(self, group):
        return self.get(group, [])


@pytest.fixture
def offer(monkeypatch):
    """Lets other packages offer ingredients of a kind: offer("sensor", rye=Bread)."""

    def installed(kind, **loads):
        points = [Point(name, load) for name, load in loads.items()]
        offered = Offered({f"bulletuav.{kind}": points})
        monkeypatch.setattr(registry, "_entry_points", lambda _: offered)
        registry._loaded.discard(kind)

    return installed


def test_other_packages_add_ingredients_by_entry_points(offer):
    class Bread:
        pass

    offer("sensor", rye=lambda: Bread)
    assert "rye" in names("sensor")
    assert find("sensor", "rye", is_class) is Bread
    assert "gps" in names("sensor")
    assert "rye" not in names("task")


def test_entry_points_are_loaded_once_and_not_before_their_kind_is_asked_for(offer):
    loaded = []

    class Bread:
        pass

    offer("sensor", rye=lambda: loaded.append(1) or Bread)
    names("task")
    assert not loaded
    for _ in range(3):
        names("sensor")
        find("sensor", "rye", is_class)
    assert loaded == [1]


def broken():
    raise ImportError("no flour")


def crashed():
    raise ZeroDivisionError("no oven")


@pytest.mark.parametrize(("load", "said"), [(broken, "no flour"), (crashed, "no oven")])
def test_a_broken_entry_point_is_left_out_with_a_warning(offer, load, said):
    class Bread:
        pass

    offer("sensor", stale=load, rye=lambda: Bread)
    words = f"entry point 'stale' of bulletuav.sensor is ignored: {said}"
    with pytest.warns(UserWarning, match=words):
        listed = names("sensor")
    assert "stale" not in listed
    assert {"gps", "rye"} <= set(listed)
    with pytest.raises(ValueError, match="unknown sensor 'stale'"):
        find("sensor", "stale", anything)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        names("sensor")  # told once


def test_an_entry_point_does_not_take_a_name_of_ours(offer):
    before = find("sensor", "gps", anything)

    class Other:
        pass

    offer("sensor", gps=lambda: Other)
    with pytest.warns(UserWarning, match="'gps' of bulletuav.sensor is ignored: .* registered"):
        names("sensor")
    assert find("sensor", "gps", anything) is before


def test_an_entry_point_whose_name_is_no_word_is_left_out(offer):
    class Bread:
        pass

    offer("sensor", **{"rye-bread": lambda: Bread})
    with pytest.warns(UserWarning, match="'rye-bread' .* is ignored: .* a word is needed"):
        assert "rye-bread" not in names("sensor")


# Threads


@pytest.fixture
def stop(module, monkeypatch):
    """Where the module of a kind stops while it is imported: it sets `began`, waits for `go_on`."""
    events = types.ModuleType("stop")
    events.began, events.go_on = threading.Event(), threading.Event()
    monkeypatch.setitem(sys.modules, "stop", events)
    monkeypatch.setitem(registry.PACKAGES, "sensor", "shop")
    monkeypatch.setattr(registry, "_loaded", set(registry._loaded) - {"sensor"})
    yield events
    events.go_on.set()


STOP = "import stop\nstop.began.set()\nassert stop.go_on.wait(60)\n"
BREAD = "from bulletuav.registry import names, register\nclass Bread: ...\n"


def test_names_wait_for_what_another_thread_is_importing(module, stop):
    module("shop", f"{STOP}{BREAD}register('sensor', 'rye')(Bread)\n")
    with ThreadPoolExecutor(2) as pool:
        first = pool.submit(names, "sensor")
        assert stop.began.wait(60)
        second = pool.submit(names, "sensor")
        with pytest.raises(TimeoutError):  # one that does not wait is done by then
            second.result(0.2)
        stop.go_on.set()
        assert "rye" in first.result(60)
        assert "rye" in second.result(60)


def test_a_module_may_ask_for_names_while_another_thread_waits_for_it(module, stop):
    # This thread holds the lock of the module's import when it asks, and the other one wants it
    module("shop", f"{STOP}{BREAD}register('sensor', 'rye')(Bread)\nseen = names('sensor')\n")
    with ThreadPoolExecutor(2) as pool:
        imported = pool.submit(importlib.import_module, "shop")
        assert stop.began.wait(60)
        asked = pool.submit(names, "sensor")
        stop.go_on.set()
        assert "rye" in asked.result(60)
        assert "rye" in imported.result(60).seen


def test_a_module_may_ask_for_names_of_its_own_kind(module, stop):
    stop.go_on.set()
    module("shop", f"{STOP}{BREAD}before = names('sensor')\nregister('sensor', 'rye')(Bread)\n")
    assert "rye" in names("sensor")
    assert "rye" not in sys.modules["shop"].before


def test_a_kind_whose_import_failed_is_imported_again(module, stop):
    stop.go_on.set()
    module("shop", "import no_such_flour\n")
    for _ in range(2):
        with pytest.raises(ImportError, match="no_such_flour"):
            names("sensor")
