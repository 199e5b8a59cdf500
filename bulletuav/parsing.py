"""Readers of JSON, YAML, TOML and XML files, which may come from untrusted sources.

Each error of a parser becomes one ValueError of one line that contains the path. The value that a
reader returns is plain: mappings with unique string keys, lists, strings, integers of at most
`MAX_BITS` bits, floats, booleans and None, nested at most `MAX_DEPTH` deep.
"""

import json
import math
import re
import tomllib
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Callable, Hashable, Iterable
from pathlib import Path
from typing import Any

import yaml

from bulletuav.errors import read_file, reason_of, shown

MAX_DEPTH = 100
"""Maximum depth of nested values, which recursive functions can handle"""
MAX_BITS = 1000
"""Maximum number of bits of an integer; larger integers have no float"""


def read_json(path: Path, kind: str = "JSON") -> Any:
    """Read a JSON file.

    Args:
        path: The file.
        kind: Name of the format, for the message.

    Returns:
        The plain value of the file.

    Raises:
        ValueError: If the file is not valid, or its value is not plain.
    """
    return _read(path, kind, _load_json)


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file; see `read_json`."""
    tables: dict[str, Any] = _read(path, "TOML", tomllib.loads)
    return tables


def read_yaml(path: Path) -> Any:
    """Read a YAML file of plain values, without aliases; see `read_json`."""
    return _read(path, "YAML", lambda text: yaml.load(text, _Loader))


def read_xml(path: Path) -> ElementTree.Element:
    """Read an XML file.

    Returns:
        The root element.

    Raises:
        ValueError: If the file is not valid XML, or nested too deep.
    """
    root: ElementTree.Element = _parse(
        str(path), "XML", lambda: _shallow(ElementTree.parse(path).getroot())
    )
    return root


def plain_digits(text: str) -> str:
    """Check that a text is an ASCII number, for `int` or `float` to convert.

    Raises:
        ValueError: If the text has underscores or digits of other scripts, which Python accepts and
            other programs do not.
    """
    if "_" in text or not text.isascii():
        raise ValueError(f"{shown(text)} is no number in digits from 0 to 9")
    return text


def parse_number(text: str) -> float:
    """Convert a text to a finite float, in a form that other programs accept as well.

    Raises:
        ValueError: If the text is not such a number.
    """
    value = float(plain_digits(text))
    if not math.isfinite(value):
        raise ValueError(f"{shown(text)} is no finite number")
    return value


def parse_json(text: str | bytes, where: str) -> Any:
    """Parse JSON that is embedded in a file of another format.

    Args:
        text: The JSON text.
        where: Name of the file and of its part, for the message.

    Returns:
        The plain value.

    Raises:
        ValueError: If the text is not valid JSON, or its value is not plain.
    """
    return _parse(where, "JSON", lambda: require_plain(_load_json(text)))


def _load_json(text: str | bytes) -> Any:
    """Parse JSON; raise ValueError for duplicate keys, of which Python ignores the first."""
    return json.loads(text, object_pairs_hook=_mapping)


def _mapping(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    mapping = dict(pairs)
    if len(mapping) < len(pairs):
        _require_once([name for name, _ in pairs])
    return mapping


def _require_once(names: list[Any]) -> None:
    counts = Counter(names)
    if twice := [name for name, count in counts.items() if count > 1]:
        raise ValueError(f"{shown(twice[0])} is there twice: delete one")


def _read(path: Path, kind: str, parse: Callable[[str], Any]) -> Any:
    text = read_file(path)
    return _parse(str(path), kind, lambda: require_plain(parse(text)))


def _parse(where: str, kind: str, parse: Callable[[], Any]) -> Any:
    """Call a parser, and convert each of its errors to one ValueError."""
    try:
        return parse()
    except RecursionError:
        reason = f"it is nested more than {MAX_DEPTH} deep"
    # Parsers raise many types of errors: for dates, keys, numbers, encodings
    except Exception as error:
        reason = reason_of(error)
    raise ValueError(f"{where} is not valid {kind}: {reason}")


def require_plain(plain: Any) -> Any:
    """Check that a value is plain, as the module docstring defines it.

    Returns:
        The value.

    Raises:
        ValueError: If a part of the value has another type, is too large or nested too deep.
    """
    waiting = [(plain, 0)]
    while waiting:
        one, depth = waiting.pop()
        if depth > MAX_DEPTH:
            raise ValueError(f"it is nested more than {MAX_DEPTH} deep")
        inner: Iterable[Any] = ()
        if isinstance(one, dict):
            inner = one.values()
            for name in one:
                if not isinstance(name, str):
                    raise ValueError(f"the name {shown(name)} is no text: write it in quotes")
                _require_text(name)
        elif isinstance(one, list):
            inner = one
        elif isinstance(one, str):
            _require_text(one)
        elif isinstance(one, int):
            if one.bit_length() > MAX_BITS:
                raise ValueError(f"a whole number has {one.bit_length()} bits: {MAX_BITS} at most")
        elif one is not None and not isinstance(one, float):
            raise ValueError(
                f"{shown(one)} is a {type(one).__name__}: a number, text, list or names with "
                f"values are needed; write a text in quotes"
            )
        # Large files consist of lists of floats, which need no check
        waiting += [(value, depth + 1) for value in inner if type(value) is not float]
    return plain


def _require_text(text: str) -> None:
    """Raise ValueError for a lone surrogate, which cannot be encoded in UTF-8."""
    if not text.isascii() and any("\ud800" <= letter <= "\udfff" for letter in text):
        raise ValueError(f"the text {shown(text)} has half a character (a lone surrogate)")


def _shallow(root: ElementTree.Element) -> ElementTree.Element:
    """Return the root; raise RecursionError if it is nested more than `MAX_DEPTH` deep."""
    waiting = [(root, 0)]
    while waiting:
        element, depth = waiting.pop()
        if depth > MAX_DEPTH:
            raise RecursionError
        waiting += [(inner, depth + 1) for inner in element]
    return root


class _Loader(yaml.SafeLoader):  # type: ignore[misc]  # PyYAML has no types
    """Loader of plain values, which reads 1e-3 as a number; in YAML 1.1 it is a string."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Raise YAMLError for aliases, by which a short file can fill the memory."""
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("it has an alias, such as *name, and values are to be written out")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Hashable, Any]:
        """Raise ValueError for duplicate keys, of which YAML would ignore the first."""
        _require_once([key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)])
        mapping: dict[Hashable, Any] = super().construct_mapping(node, deep)
        return mapping


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+$"),
    list("-+0123456789"),
)
