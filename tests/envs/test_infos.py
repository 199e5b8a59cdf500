"""Infos are dicts whose values are made when somebody reads them."""

import copy
import json
import pickle

import numpy as np
import pytest

import bulletuav
from bulletuav.envs.infos import METHODS, lazy_infos

READS = {
    "item": lambda infos: infos["a"],
    "get": lambda infos: infos.get("b", 0),
    "items": lambda infos: dict(infos.items()),
    "keys": lambda infos: list(infos.keys()),
    "values": lambda infos: list(infos.values()),
    "length": len,
    "list": list,
    "reversed": lambda infos: list(reversed(infos)),
    "in": lambda infos: ("a" in infos, "c" in infos),
    "equal": lambda infos: infos == {"a": 1, "b": 2},
    "unequal": lambda infos: infos != {"a": 1, "b": 2},
    "dict": dict,
    "unpacked": lambda infos: {**infos},
    "keywords": lambda infos: dict(**infos),
    "union": lambda infos: infos | {"c": 3},
    "union from": lambda infos: {"c": 3} | infos,
    "updated": lambda infos: {"c": 3, **infos},
    "text": repr,
    "json": json.dumps,
    "copy": lambda infos: infos.copy(),
    "shallow": copy.copy,
    "deep": copy.deepcopy,
    "pickle": lambda infos: pickle.loads(pickle.dumps(infos)),
    "truth": bool,
}


@pytest.mark.parametrize("read", READS)
def test_they_read_as_a_dict(read):
    made = []

    def make():
        made.append(1)
        return {"a": 1, "b": 2}

    infos = lazy_infos(make)
    assert not made
    assert READS[read](infos) == READS[read]({"a": 1, "b": 2})
    assert READS[read](infos) == READS[read]({"a": 1, "b": 2})
    assert len(made) == 1


WRITES = {
    "set": lambda infos: infos.__setitem__("a", 3),
    "delete": lambda infos: infos.__delitem__("a"),
    "pop": lambda infos: infos.pop("a"),
    "popitem": lambda infos: infos.popitem(),
    "update": lambda infos: infos.update(c=3),
    "default": lambda infos: infos.setdefault("a", 5),
    "clear": lambda infos: infos.clear(),
    "or": lambda infos: infos.__ior__({"b": 5}),
}


@pytest.mark.parametrize("write", WRITES)
def test_they_are_written_as_a_dict(write):
    infos, plain = lazy_infos(lambda: {"a": 1, "b": 2}), {"a": 1, "b": 2}
    WRITES[write](infos)
    WRITES[write](plain)
    assert dict(infos) == plain


def test_every_method_of_dict_that_looks_at_values_is_one_of_theirs():
    others = {"__class__", "__init__", "__new__", "__doc__", "__sizeof__", "fromkeys", "copy"}
    others |= {"__class_getitem__", "__hash__", "__reduce__"}
    assert {name for name in vars(dict) if getattr(dict, name, None)} - set(METHODS) <= others | {
        "__getattribute__",
        "__lt__",
        "__le__",
        "__gt__",
        "__ge__",
    }


def test_an_interrupt_loses_nothing():
    """Whoever asks next gets them."""
    told = iter((KeyboardInterrupt, {"a": 1, "b": 2}))

    def make():
        value = next(told)
        if value is KeyboardInterrupt:
            raise value
        return value

    infos = lazy_infos(make)
    with pytest.raises(KeyboardInterrupt):
        len(infos)
    assert list(infos.items()) == [("a", 1), ("b", 2)]


def test_infos_of_a_step_stay_when_others_are_flown():
    env = bulletuav.parallel_env("hover", dynamics="rigid_body", num_drones=2)
    env.reset(seed=0)
    action = {agent: np.full(4, 0.3, "f4") for agent in env.agents}
    first = env.step(action)[-1]
    second = env.step(action)[-1]
    again = bulletuav.parallel_env("hover", dynamics="rigid_body", num_drones=2)
    again.reset(seed=0)
    assert {**again.step(action)[-1]} == first
    assert first != second
    assert isinstance(first, dict)
    assert set(first) == {"drone_0", "drone_1"}
