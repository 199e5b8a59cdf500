"""Every odd value of YAML in every setting of a run: settings, or one error that names the file."""

import itertools
import json

import pytest
import yaml

from bulletuav.parsing import MAX_DEPTH, parse_json, read_json, read_toml, read_xml, read_yaml
from bulletuav.policies.run import RunConfig
from bulletuav.training.study import Study

TAGS = (
    *("str", "int", "float", "bool", "null", "timestamp", "binary", "set", "omap", "pairs"),
    *("seq", "map", "merge", "value", "python/tuple", "python/name:os.system", "own"),
)
CONTENTS = (
    *("x", "''", "~", "1", "-1.5", "1e3", "2001-01-01", "2001-13-45", "12:30:45", "[1]", "[[]]"),
    *("[x, y]", "{a: 1}", "{}", "{1: 2}", "'=x'", "aGk=", "é"),
)
PLAIN = (
    # Whole numbers in all bases, times and numbers of base 60, with signs and underscores
    *("0x", "0x1F", "0xFFFFFFFFFFFFFFFFFFFF", "0b1", "0b", "0b2", "0o17", "0o", "017", "08", "1_0"),
    *("_1", "+1", "--1", "1:30", "1:99", "-1:1:1", "190:20:30.15", "1:", "9" * 18, "9" * 19),
    *("9" * 400, "9" * 4300, "9" * 4301, "9" * 5000, "-" + "9" * 5000, "0x" + "f" * 5000, "1e5000"),
    *("0b" + "1" * 20000, "1:" * 200 + "1", "0" * 5000, "9223372036854775808", "-0"),
    # Floats
    *(
        ".inf",
        "-.inf",
        ".NaN",
        ".nan",
        "1e400",
        "-1e400",
        "1e-400",
        "5e-324",
        "1.7976931348623157e308",
    ),
    *("1e", "e1", ".", "-", "+", "1.", ".5", "1.5.2", "1,5", "0." + "1" * 5000, "infinity", "nan"),
    # Dates
    *("2001-01-01", "0000-00-00", "9999-99-99", "2001-02-30", "2001-01-01 00:00:00", "1-1-1"),
    *("2001-12-14t21:59:43.10-05:00", "2001-12-14t25:61:61Z", "2001-12-14 21:59:43.10 +99:99"),
    # Words
    *(
        "yes",
        "No",
        "ON",
        "off",
        "true",
        "TRUE",
        "~",
        "null",
        "Null",
        "",
        "''",
        '""',
        "=",
        "<<",
        "y",
    ),
    *("'\\ud800'", '"\\ud800"', '"\\udcff"', '"\\0"', '"\\U0010ffff"', '"\\xff"', '"\\"', "'", '"'),
    *("x" * 5000, "é", "\u2028", "\U0001f600", "\x85", "\x00", "\x07", "\ufeff", "%x", "@x", "`x"),
    *("&a x", "*a", "&a [*a]", "!x", "! x", "!<x> y", "!!", "!!x y", "|", ">", "|9", "|+-", "? x"),
    *(
        "module:Name",
        "-1",
        "..",
        "/",
        "/dev/null",
        "a: b: c",
        "- x",
        "x #",
        "#",
        ": ",
        "-",
        "--- x",
    ),
    # Collections
    *("[", "]", "{", "}", "[,]", "{,}", "[]", "{}", "[[], {}]", "{a}", "{a, b}", "[a: b]", "{: }"),
    *("{a: 1, a: 2}", "{[1]: 2}", "{{a: 1}: 2}", "{1: 2}", "{~: 1}", "{1.5: 1}", "{true: 1}"),
    *("{2001-01-01: 1}", "{<<: x}", "{<<: [x]}", "{<<: {a: 1}}", "{? [x] : y}", "{'': 1}"),
    *("{=: 1}", '{"\\ud800": 1}', "[1, [2, [3, [4, [5]]]]]", "[~, ~]", "{a: {a: {a: {a: 1}}}}"),
    *("[" * 90 + "]" * 90, "[" * 20000 + "]" * 20000, "[" * 3000, "{a: " * 150 + "1" + "}" * 150),
    *("[" + "x, " * 3000 + "x]", "!!timestamp", "!!int", "!!float", "!!bool", "!!set {a, b}"),
    *("!!omap [a: 1]", "!!pairs [a: 1, a: 2]", "!!binary '%'", "!!binary aGk=", "!!str [x]"),
    *("!!seq x", "!!map x", "!!set x", "!!int [1]", "!!float {a: 1}", "!!null x", "!!null [1]"),
)
SCALARS = list(dict.fromkeys([*PLAIN, *(f"!!{tag} {one}" for tag in TAGS for one in CONTENTS)]))
OWN = {
    "version": 1,
    "task": "crossing",
    "algo": "ppo",
    "seed": 0,
    "steps": 64,
    "worlds": 2,
    "options": {
        "dynamics": "single_integrator",
        "num_drones": 2,
        "horizon": 4,
        "observation": ["goal"],
        "weights": {"conflict": 1.0},
        "difficulty": "easy",
        "airframe": "cf2x",
        "wind": [1.0, 0.0, 0.0],
        "max_speed": 2.0,
    },
    "stages": [{}, {"num_drones": 3}],
    "curriculum": {"up": 0.8, "window": 10},
    "shared_reward": False,
    "model": {"gamma": 0.99, "policy_kwargs": {"net_arch": [8]}},
    "evaluations": 2,
    "episodes": 1,
    "evaluation": {"horizon": 5},
    "constants": 1,
}


def places(value, path=()):
    """Every place of a value, as the keys that lead to it."""
    inner = value.items() if isinstance(value, dict) else enumerate(value)
    for key, one in inner:
        yield (*path, key)
        if isinstance(one, dict | list):
            yield from places(one, (*path, key))


PLACES = list(places(OWN))
MARK = "put-it-here"


def text_with(place, scalar):
    """The file of a run in which a value is a text of YAML."""
    settings = json.loads(json.dumps(OWN))
    holder = settings
    for key in place[:-1]:
        holder = holder[key]
    holder[place[-1]] = MARK
    return yaml.safe_dump(settings, width=10**6).replace(MARK, scalar)


def require_one_clear_error(read, path, text):
    """Settings, or one error of one line with the name of the file; nothing else."""
    path.write_text(text, encoding="utf-8")
    said = ""
    try:
        read(path)
    except (ValueError, FileNotFoundError) as error:
        said = str(error)
    is_clear = not said or (str(path) in said and len(said) < 3000 and "\n" not in said)
    assert is_clear, f"{text[:300]!r}: {len(said)} characters: {said[:300]}"
    return said


def test_the_table_is_a_few_hundred():
    assert len(SCALARS) > 400
    assert len(PLACES) > 25


def test_the_settings_are_settings(tmp_path):
    assert not require_one_clear_error(RunConfig.read, tmp_path / "run.yaml", yaml.safe_dump(OWN))
    for place in PLACES:
        with_text = text_with(place, "!!float {[2001-01-01]: *a}")
        assert require_one_clear_error(RunConfig.read, tmp_path / "run.yaml", with_text)


def test_each_odd_scalar_in_some_setting(tmp_path):
    """Each setting gets each twentieth; all of them are slow."""
    for k, scalar in enumerate(SCALARS):
        for place in PLACES[k % 20 :: 20]:
            text = text_with(place, scalar)
            require_one_clear_error(RunConfig.read, tmp_path / "run.yaml", text)


@pytest.mark.slow
def test_each_odd_scalar_in_each_setting(tmp_path):
    for place, scalar in itertools.product(PLACES, SCALARS):
        text = text_with(place, scalar)
        require_one_clear_error(RunConfig.read, tmp_path / "run.yaml", text)


STUDY = """version: 1
run: {task: crossing, steps: 64, options: {dynamics: single_integrator, num_drones: 2}}
space:
  model.gamma: {low: @low, high: @high, log: @log}
  worlds: {low: 1, high: 8, step: @step}
  options.weights.conflict: {choices: [0.5, @choice]}
metric: @metric
trials: @trials
batch: @batch
"""
USUAL = {"low": 0.9, "high": 0.99, "log": "true", "step": 1, "choice": 1.0, "metric": "return"}
USUAL |= {"trials": 4, "batch": 2}


def test_each_odd_scalar_in_some_setting_of_a_study(tmp_path):
    names = list(USUAL)
    for k, scalar in enumerate(SCALARS):
        values = {**USUAL, names[k % len(names)]: scalar}
        text = STUDY
        for name in sorted(values, key=len, reverse=True):
            text = text.replace(f"@{name}", str(values[name]))
        require_one_clear_error(Study.read, tmp_path / "study.yaml", text)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("!!timestamp x", "AttributeError"),
        ("9" * 5000, "Exceeds the limit"),
        ("0x" + "f" * 500, "a whole number has 2000 bits"),
        ("[" * 20000, f"nested more than {MAX_DEPTH} deep"),
        ("[" * 150 + "]" * 150, f"nested more than {MAX_DEPTH} deep"),
        ("a: 2001-01-01", r"datetime.date\(2001, 1, 1\) is a date: a number, text"),
        ("{1: 2}", "the name 1 is no text: write it in quotes"),
        ("{[1]: 2}", "unhashable key"),
        ("{a: 1, a: 2}", "'a' is there twice"),
        ('"\\ud800"', "half a character"),
        ("!!binary aGk=", "is a bytes"),
        ("&a [*a]", "it has an alias"),
    ],
)
def test_what_is_not_plain_is_named(text, said, tmp_path):
    path = tmp_path / "own.yaml"
    path.write_text(text)
    with pytest.raises(ValueError, match=f"^{path} is not valid YAML: .*{said}"):
        read_yaml(path)


@pytest.mark.parametrize(
    "read", [read_json, lambda path: parse_json(path.read_bytes(), str(path))], ids=["file", "part"]
)
def test_json_names_come_once_in_each_object(read, tmp_path):
    path = tmp_path / "own.json"
    path.write_text('[{"a": 1}, {"a": {"b": 1, "c": 2}}]')
    assert read(path) == [{"a": 1}, {"a": {"b": 1, "c": 2}}]
    path.write_text('[{"a": 1}, {"a": {"b": 1, "c": 2, "b": 1}}]')
    with pytest.raises(
        ValueError, match=f"^{path} is not valid JSON: .*'b' is there twice: delete"
    ):
        read(path)


@pytest.mark.parametrize(
    ("read", "text"), [(read_json, '{"a": 1}'), (read_toml, "a = 1"), (read_yaml, "a: 1")]
)
def test_files_may_have_a_byte_order_mark(read, text, tmp_path):
    """Editors of Windows write one."""
    path = tmp_path / "own"
    path.write_text(text, encoding="utf-8-sig")
    assert read(path) == {"a": 1}


@pytest.mark.parametrize(
    ("read", "text"),
    [
        (read_json, "[" * 10**5),
        (read_json, "[" * 150 + "]" * 150),
        (read_json, "9" * 5000),
        (read_json, "9" * 400),
        (read_json, '{"a": "\\ud800"}'),
        (read_json, "{'a': 1}"),
        (read_json, b"\xff\xfe"),
        (read_toml, "a = 2001-01-01"),
        (read_toml, "a = 12:30:00"),
        (read_toml, "a = " + "[" * 3000),
        (read_toml, "a = " + "9" * 5000),
        (read_toml, "a = 0x" + "f" * 500),
        (read_toml, "a = 1\na = 2"),
        (read_xml, "<a>" * 5000 + "</a>" * 5000),
        (read_xml, '<?xml version="1.0" encoding="own"?><a/>'),
        (read_xml, "<a>&#xD800;</a>"),
        (read_xml, b"\xff\xfe<"),
    ],
)
def test_each_format_has_one_clear_error(read, text, tmp_path):
    path = tmp_path / "own"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ValueError, match=str(path)) as caught:
        read(path)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 1000
