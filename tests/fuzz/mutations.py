"""Ways to damage a file, drawn from a random generator."""

import json
import re
import zipfile
from io import BytesIO

import numpy as np
import yaml
from safetensors.numpy import load, save

NUMBERS = (
    *("nan", "inf", "-inf", "1e400", "-1e400", "1e308", "-1", "0", "-0.0", "5e-324", "1e22"),
    *("9223372036854775808", "-9223372036854775809", "4294967296", "0x10", "1_000", "1,5", "1e"),
    *(
        "9" * 400,
        "9" * 5000,
        "0." + "1" * 5000,
        "0" * 300,
        "",
        "true",
        "null",
        "~",
        "é",
        "\uff11\uff12",
    ),
)
WORDS = (
    *("", " ", "nan", "None", "null", "..", "/", "/dev/null", "a" * 5000, "\\", '"', "'", "%s"),
    *("{}", "[]", "é", "\u2028", "\U0001f600", "<", "&", "\\ud800", "\\u0000", "module:Name", "-1"),
)
INSERTS = (
    *(b"\0", b"\xff\xfe", b"\xef\xbb\xbf", b"\xed\xa0\x80", b"\n", b"\r", b"\t", b"#", b",", b":"),
    *(b"[" * 20000, b"{" * 3000, b"<a>" * 3000, b"(" * 300, b"- " * 3000, b"{a: " * 2000, b"]"),
    *(b"!!timestamp x ", b"!!int ", b"!!float ", b"!!set ", b"!!binary ", b"? ", b"&a ", b"*a"),
    *(b"<<: ", b"%YAML 9.9\n---\n", b"---\n", b"<!-- ", b"<![CDATA[", b"&lt;", b'"""', b"'''"),
)
ODD = (
    *(None, True, -1, 0, 2**31, 2**63, 10**30, 10**400, 0.5, -0.0, 1e308, 5e-324),
    *(float("nan"), float("inf"), "", "x", "nan", "1e400", "\0", "\ud800", "a" * 5000),
    *([], {}, [[]], [None], [1, "a"], {"": 0}, {"a": {"b": []}}, [[[[[]]]]], list(range(300))),
)
NUMBER = re.compile(rb"[-+]?\d[\d.eE+-]*")
WORD = re.compile(rb"[A-Za-z_][\w./:]*")


def damage(content, kind, rng):
    """The content of a file, damaged in one to three ways; `kind` is how it is structured."""
    structured = STRUCTURED.get(kind)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        if structured is not None and rng.random() < 0.6:
            try:
                content = structured(content, rng)
                continue
            except Exception:  # no longer of its format
                structured = None
        ways = BYTES if kind in BINARY else BYTES + TEXT
        content = rng.choice(ways)(content, rng)
    return content


def _span(content, rng):
    start = rng.randrange(len(content) + 1)
    return start, min(len(content), start + rng.choice((1, 1, 2, 8, 64, 1000)))


def flip(content, rng):
    if not content:
        return b"\0"
    place = rng.randrange(len(content))
    return content[:place] + bytes([content[place] ^ 1 << rng.randrange(8)]) + content[place + 1 :]


def cut(content, rng):
    start, end = _span(content, rng)
    return content[:start] + content[end:]


def repeat(content, rng):
    start, end = _span(content, rng)
    return content[:end] + content[start:end] * rng.choice((1, 3)) + content[end:]


def truncate(content, rng):
    return content[: rng.randrange(len(content) + 1)]


def insert(content, rng):
    place = rng.randrange(len(content) + 1)
    return content[:place] + rng.choice(INSERTS) + content[place:]


def empty(_, rng):
    return rng.choice((b"", b"\n", b"\0" * 100, b"\xff" * 64, b"PK\x03\x04", b"null", b"[]", b"{}"))


def recode(content, rng):
    text = content.decode("utf-8", "replace")
    return text.encode(rng.choice(("utf-16", "utf-32", "latin-1", "utf-7", "cp037")), "replace")


def _replaced(content, pattern, choices, rng):
    found = list(pattern.finditer(content))
    if not found:
        return content
    one = rng.choice(found)
    return content[: one.start()] + rng.choice(choices).encode() + content[one.end() :]


def number(content, rng):
    return _replaced(content, NUMBER, NUMBERS, rng)


def word(content, rng):
    return _replaced(content, WORD, WORDS, rng)


def line(content, rng):
    """Take a line out, put it in twice, or exchange it with another one."""
    lines = content.split(b"\n")
    one, two = rng.randrange(len(lines)), rng.randrange(len(lines))
    way = rng.randrange(3)
    if way == 0:
        del lines[one]
    elif way == 1:
        lines.insert(two, lines[one])
    else:
        lines[one], lines[two] = lines[two], lines[one]
    return b"\n".join(lines)


BYTES = (flip, flip, cut, repeat, truncate, insert, empty)
TEXT = (number, number, number, word, word, line, recode)


def change(value, rng):
    """A value of dicts and lists with one entry changed, taken out or put in; in place."""
    holders = [value]
    for one in holders:
        inner = one.values() if isinstance(one, dict) else one
        holders += [entry for entry in inner if isinstance(entry, dict | list) and entry]
    holder = rng.choice(holders)
    if not isinstance(holder, dict | list) or not holder:
        return rng.choice(ODD)
    key = rng.choice(list(holder) if isinstance(holder, dict) else range(len(holder)))
    way = rng.random()
    if way < 0.15:
        del holder[key]
    elif way < 0.25 and isinstance(holder, dict):
        holder[rng.choice(("x", "", "é", key + key))] = holder[key]
    elif way < 0.3:
        for _ in range(rng.choice((3, 150, 5000))):
            holder[key] = [holder[key]]
    else:
        holder[key] = rng.choice(ODD)
    return value


def change_json(content, rng):
    deep = change(json.loads(content), rng)
    return json.dumps(deep).encode()


def change_yaml(content, rng):
    return yaml.safe_dump(change(yaml.safe_load(content), rng), sort_keys=False).encode()


def change_array(array, rng):
    """An array of another shape, type or content."""
    way = rng.randrange(7)
    if way == 0:
        return array.reshape(-1)
    if way == 1:
        return array[:-1] if array.ndim else array[None]
    if way == 2:
        return array[None]
    if way == 3:
        return array.astype(rng.choice((np.int8, np.uint64, np.float16, np.complex64, "U9", "?")))
    if way == 4:
        return np.zeros((0,) * rng.randrange(4), array.dtype)
    if way == 5:
        return array[..., :0] if array.ndim else array
    changed = array.copy()
    if changed.size and changed.dtype.kind in "iuf":
        odd = (0, 1) if changed.dtype.kind == "u" else (0, -1, 127)
        more = (np.nan, np.inf, -np.inf, 1e300, 1e-300) if changed.dtype.kind == "f" else ()
        with np.errstate(all="ignore"):
            changed.reshape(-1)[rng.randrange(changed.size)] = rng.choice((*odd, *more))
    elif changed.dtype.kind == "U" and not changed.ndim:
        return np.array(change_json(str(changed).encode(), rng).decode())
    return changed


def _change_arrays(arrays, rng):
    name = rng.choice(sorted(arrays))
    way = rng.random()
    if way < 0.15:
        del arrays[name]
    elif way < 0.25:
        arrays[f"{name}x"] = arrays[name]
    else:
        with np.errstate(all="ignore"):
            arrays[name] = change_array(arrays[name], rng)
    return arrays


def change_npz(content, rng):
    with np.load(BytesIO(content)) as file:
        arrays = {name: file[name] for name in file.files}
    out = BytesIO()
    np.savez(out, **_change_arrays(arrays, rng))
    return out.getvalue()


def change_zip(content, rng):
    """A zip file whose members are damaged, and whose sums of them are right."""
    out = BytesIO()
    with zipfile.ZipFile(BytesIO(content)) as old, zipfile.ZipFile(out, "w") as new:
        names = old.namelist()
        chosen = rng.choice(names)
        for name in names:
            member = old.read(name)
            new.writestr(name, rng.choice(BYTES)(member, rng) if name == chosen else member)
    return out.getvalue()


def change_safetensors(content, rng):
    if rng.random() < 0.3:  # its header is JSON
        size = int.from_bytes(content[:8], "little")
        header = change_json(content[8 : 8 + size], rng)
        return len(header).to_bytes(8, "little") + header + content[8 + size :]
    arrays = _change_arrays(load(content), rng)
    return save({name: np.ascontiguousarray(array) for name, array in arrays.items()})


STRUCTURED = {
    "json": change_json,
    "yaml": change_yaml,
    "npz": lambda content, rng: rng.choice((change_npz, change_npz, change_zip))(content, rng),
    "safetensors": change_safetensors,
}
BINARY = ("npz", "safetensors", "parquet", "bytes")
