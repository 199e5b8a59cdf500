"""Trained policies as plain C99, without dependencies but `math.h`, for microcontrollers."""

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bulletuav.adapters.deployed import Deployed
from bulletuav.files import replace_file
from bulletuav.policies.layers import (
    Affine,
    Argmax,
    Clip,
    Dense,
    Layer,
    LimitNorm,
    Lookup,
    Relu,
    SquareRoot,
    SwarmLayer,
    SymlogLayer,
    Tanh,
    width_after,
)
from bulletuav.policies.swarm_features import APPROACH, LOOK_AHEAD, TINY
from bulletuav.sensors.base import Label

PRECISIONS = ("float", "double")
"""Types of numbers"""


def write_c(policy: Deployed, path: Path, precision: str = "float") -> list[Path]:
    """Write a policy as a C file, and the header beside it.

    Args:
        policy: The policy.
        path: The C file; its name without ending is that of the function.
        precision: "float" or "double".

    Returns:
        The two files.

    Raises:
        ValueError: A layer has no form in C, or the name is none that C takes.
        OSError: A file cannot be written.
    """
    if not path.stem.isidentifier() or not path.stem.isascii():
        raise ValueError(
            f"{path.name}: a name of letters, digits and _ is needed, such as policy.c"
        )
    header = path.with_suffix(".h")
    replace_file(header, _header(policy, path.stem, precision))
    replace_file(path, _source(policy, path.stem, precision))
    return [path, header]


def _header(policy: Deployed, name: str, precision: str) -> str:
    """Write the header: what goes in and out, with units and bounds."""
    guard = f"{name.upper()}_H"
    return f"""/* {_comment(policy.about)}

observation, each clipped to its bounds:
{_list(policy.inputs)}

setpoint (axes: world ENU, body FLU):
{_list(policy.outputs)}
*/
#ifndef {guard}
#define {guard}

#define {name.upper()}_INPUTS {len(policy.inputs)}
#define {name.upper()}_OUTPUTS {len(policy.outputs)}

#ifdef __cplusplus
extern "C" {{
#endif
void {name}({_arguments(policy, precision)});
#ifdef __cplusplus
}}
#endif

#endif
"""


def _arguments(policy: Deployed, kind: str) -> str:
    """Write the arguments of the function."""
    return f"const {kind} observation[{len(policy.inputs)}], {kind} setpoint[{len(policy.outputs)}]"


def _list(labels: tuple[Label, ...]) -> str:
    """List numbers with their names, units and bounds."""
    return "\n".join(
        f"  [{k}] {_comment(label.name)}, {_comment(label.unit)}, "
        f"{label.low:.9g} to {label.high:.9g}"
        for k, label in enumerate(labels)
    )


def _comment(text: str) -> str:
    """Keep a text, such as the label of a user, from ending its comment."""
    return text.replace("*/", "* /").replace("/*", "/ *")


def _source(policy: Deployed, name: str, precision: str) -> str:
    """Write the C file."""
    width = len(policy.inputs)
    widths = [width]
    tables: list[str] = []
    steps: list[str] = []
    # Each layer adds its tables and its steps, and tells the width of the next
    for k, layer in enumerate(policy.layers):
        write = LAYERS.get(type(layer))
        if write is None:
            raise ValueError(f"a layer {type(layer).__name__} has no form in C")
        given = width_after(layer, width)
        fields = _fields(layer, str(k), precision, tables)
        steps.append(f"    /* {type(layer).__name__} */\n{write(fields, width, given)}")
        width = given
        widths.append(width)
    # Both buffers are as wide as the widest layer
    room = max(widths)
    is_swarm = any(isinstance(layer, SwarmLayer) for layer in policy.layers)
    suffix = "f" if precision == "float" else ""
    # Two buffers: dense layers read one and write the other.
    return f"""/* {_comment(policy.about)}; see {name}.h */
#include "{name}.h"
#include <math.h>

typedef {precision} number;
#define F(function) function{"##f" if suffix else ""}
#define SYMLOG(scale, value) F(copysign)(F(log1p)((scale) * F(fabs)(value)), value)

{"".join(tables)}{_approach(precision) if is_swarm else ""}
void {name}({_arguments(policy, "number")})
{{
    number x[{room}], y[{room}];
    int i, j = 0{", other" if is_swarm else ""};
    for (i = 0; i < {len(policy.inputs)}; i++) x[i] = observation[i];
{"".join(steps)}    for (i = 0; i < {len(policy.outputs)}; i++) setpoint[i] = x[i];
    (void)y;
    (void)j;
}}
"""


class _Table(NamedTuple):
    """A constant array: its name in C, and its shape."""

    name: str
    shape: tuple[int, ...]

    def __str__(self) -> str:
        return self.name


def _fields(value: Any, name: str, precision: str, tables: list[str]) -> Any:
    """Add arrays as constants, and give what stands for a layer or a part of one in C."""
    if hasattr(value, "_asdict"):
        parts = value._asdict().items()
        return {field: _fields(one, f"{field}_{name}", precision, tables) for field, one in parts}
    if isinstance(value, tuple):
        return [_fields(one, f"{name}_{k}", precision, tables) for k, one in enumerate(value)]
    if not isinstance(value, np.ndarray):
        return _number(value, precision)
    if value.dtype.kind == "i":
        kind, numbers = "int", ", ".join(map(str, value.ravel()))
    else:
        kind, numbers = "number", ", ".join(_number(one, precision) for one in value.ravel())
    if value.size:
        tables.append(f"static const {kind} {name}[{value.size}] = {{{numbers}}};\n")
    return _Table(name, value.shape)


def _number(value: float, precision: str) -> str:
    """Write a number so that it is read back to the last bit."""
    value = float(np.float32(value)) if precision == "float" else float(value)
    if np.isinf(value):
        return "HUGE_VAL" if value > 0 else "-HUGE_VAL"
    text = f"{value:.9g}" if precision == "float" else repr(value)
    text = text if any(sign in text for sign in ".e") else f"{text}.0"
    return f"{text}f" if precision == "float" else text


Fields = dict[str, Any]
"""A layer's tables and numbers in C, and parts of it, by the names of its fields"""


def _each(body: str, width: int) -> str:
    """Write a loop over the numbers."""
    return f"    for (i = 0; i < {width}; i++) {body}\n"


def _clip(f: Fields, width: int, given: int) -> str:
    low, high = f["low"], f["high"]
    return _each(f"x[i] = x[i] < {low}[i] ? {low}[i] : x[i] > {high}[i] ? {high}[i] : x[i];", width)


def _affine(f: Fields, width: int, given: int) -> str:
    return _each(f"x[i] = {f['scale']}[i] * x[i] + {f['offset']}[i];", width)


def _symlog(f: Fields, width: int, given: int) -> str:
    return _each(f"x[i] = SYMLOG({f['scale']}, x[i]);", width)


def _dense(f: Fields, width: int, given: int) -> str:
    return f"""    for (i = 0; i < {given}; i++) {{
        y[i] = {f["bias"]}[i];
        for (j = 0; j < {width}; j++) y[i] += {f["weight"]}[{width} * i + j] * x[j];
    }}
{_each("x[i] = y[i];", given)}"""


def _tanh(f: Fields, width: int, given: int) -> str:
    return _each("x[i] = F(tanh)(x[i]);", width)


def _relu(f: Fields, width: int, given: int) -> str:
    return _each("x[i] = x[i] > 0 ? x[i] : 0;", width)


def _square_root(f: Fields, width: int, given: int) -> str:
    return _each("x[i] = F(sqrt)(x[i] > 0 ? x[i] : 0);", width)


def _limit_norm(f: Fields, width: int, given: int) -> str:
    return f"""    y[0] = 0;
{_each("y[0] += x[i] * x[i];", width)}    y[0] = F(sqrt)(y[0]);
    if (y[0] > {f["max_norm"]}) {{
    {_each(f"x[i] *= {f['max_norm']} / y[0];", width)}    }}
"""


def _choose(f: Fields, width: int, given: int) -> str:
    return f"""    j = 0;
{_each("if (x[i] > x[j]) j = i;", width)}    x[0] = (number)j;
"""


def _lookup(f: Fields, width: int, given: int) -> str:
    return "    j = (int)x[0];\n" + _each(f"x[i] = {f['rows']}[{given} * j + i];", given)


def _approach(precision: str) -> str:
    """Write the function that tells where another comes closest if both fly straight on."""
    tiny, ahead = (_number(value, precision) for value in (TINY, LOOK_AHEAD))
    return f"""
/* Give {APPROACH} features of the closest approach: place (3), distance, time. */
static void approach(const number *x, const int *columns, const int *motion, number *given)
{{
    number along = 0, square = 0, time, distance = {tiny};
    int k;
    for (k = 0; k < 3; k++) {{
        along += x[columns[motion[k]]] * x[columns[motion[3 + k]]];
        square += x[columns[motion[3 + k]]] * x[columns[motion[3 + k]]];
    }}
    time = -along / (square + {tiny});
    time = time < 0 ? 0 : time > {ahead} ? {ahead} : time;
    for (k = 0; k < 3; k++) {{
        number place = x[columns[motion[k]]] + x[columns[motion[3 + k]]] * time;
        distance += place * place;
        given[k] = SYMLOG(1, place);
    }}
    given[3] = F(log1p)(F(sqrt)(distance));
    given[4] = time / ({ahead} / 2);
}}
"""


def _swarm(f: Fields, width: int, given: int) -> str:
    (own,) = f["own"].shape
    lines = _each(f"y[i] = SYMLOG({f['scale']}, x[{f['own']}[i]]);", own) if own else ""
    place = own
    for kind in f["kinds"]:
        lines += _others(kind, own, f["scale"], place)
        place += 2 * kind["layers"][-1]["bias"].shape[0]
    return f"{lines}{_each('x[i] = y[i];', given)}"


def _others(kind: Fields, own: int, scale: str, place: int) -> str:
    """Write the sum and the largest over others of one kind to y, from a place on."""
    columns, motion = kind["columns"], kind["motion"]
    count, told = columns.shape
    size = kind["layers"][-1]["bias"].shape[0]
    # Numbers of another: its columns, and where it comes closest if its motion is among them
    known = told + (APPROACH if motion.shape[0] else 0)
    # Longest vector on the way through the layers, for the C arrays
    room = max(layer["weight"].shape[1] for layer in kind["layers"])
    room = max(room, *(layer["bias"].shape[0] for layer in kind["layers"]))
    column = f"x[{columns}[{told} * other + i]]"
    # Who is not there is told as zeros, and left out of sum and largest
    steps = f"""    for (i = 0; i < {2 * size}; i++) y[{place} + i] = 0;
    for (other = 0; other < {count}; other++) {{
        number here[{room}], next[{room}];
        int there = 0;
        for (i = 0; i < {told}; i++) {{
            there |= {column} != 0;
            here[i] = SYMLOG({scale}, {column});
        }}
        if (!there) continue;
"""
    if motion.shape[0]:
        steps += f"        approach(x, {columns} + {told} * other, {motion}, here + {told});\n"
    # The drone's own features, which layers take beside those of the other
    if own:
        steps += f"        for (i = 0; i < {own}; i++) here[{known} + i] = y[i];\n"
    # Dense layers with a ReLU after each
    for layer in kind["layers"]:
        outputs, inputs = layer["weight"].shape
        steps += f"""        for (i = 0; i < {outputs}; i++) {{
            next[i] = {layer["bias"]}[i];
            for (j = 0; j < {inputs}; j++) next[i] += {layer["weight"]}[{inputs} * i + j] * here[j];
        }}
        for (i = 0; i < {outputs}; i++) here[i] = next[i] > 0 ? next[i] : 0;
"""
    # The sum is halved, as in the trained network; features after a ReLU are at least 0
    return f"""{steps}        for (i = 0; i < {size}; i++) {{
            y[{place} + i] += here[i] / 2;
            if (here[i] > y[{place + size} + i]) y[{place + size} + i] = here[i];
        }}
    }}
"""


LAYERS: dict[type[Layer], Callable[[Fields, int, int], str]] = {
    Clip: _clip,
    Affine: _affine,
    SymlogLayer: _symlog,
    Dense: _dense,
    Tanh: _tanh,
    Relu: _relu,
    SquareRoot: _square_root,
    LimitNorm: _limit_norm,
    Argmax: _choose,
    Lookup: _lookup,
    SwarmLayer: _swarm,
}
"""What writes each kind of layer: of its fields, and of how many numbers it takes and gives"""


def compiler() -> str | None:
    """Find a C compiler; None where there is none."""
    return shutil.which("gcc") or shutil.which("cc")


def run_c(path: Path, rows: np.ndarray, policy: Deployed, precision: str) -> np.ndarray:
    """Compile a file of `write_c` and call it.

    Args:
        path: The C file.
        rows: (M, D) observations.
        policy: What it was written of.
        precision: That of the file.

    Returns:
        (M, S) setpoints.

    Raises:
        ValueError: There is no compiler, or it refuses the file.
    """
    # Without a compiler nothing can be compared
    found = compiler()
    if found is None:
        raise ValueError("no C compiler is installed (gcc or cc)")
    kind: Any = ctypes.c_float if precision == "float" else ctypes.c_double
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "policy.so"
        # C99 without a single warning, as code for a microcontroller should be
        strict = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
        done = subprocess.run(
            [found, *strict, str(path), "-o", str(library), "-lm"],
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            raise ValueError(f"{path} does not compile: {done.stderr}")
        # One call for each row, as the drone would do it
        function = getattr(ctypes.CDLL(str(library)), path.stem)
        given = np.empty((len(rows), len(policy.outputs)))
        for row, out in zip(rows, given, strict=True):
            setpoint = (kind * len(out))()
            function((kind * len(row))(*map(float, row)), setpoint)
            out[:] = list(setpoint)
    return given
