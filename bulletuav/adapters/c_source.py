"""Export of trained policies as C99 for microcontrollers; the code needs only `math.h`."""

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
    Gru,
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
"""C types of the numbers"""


def write_c(policy: Deployed, path: Path, precision: str = "float") -> list[Path]:
    """Write a policy as a C source file and a header next to it.

    Args:
        policy: The policy.
        path: The C file. Its name without extension is the name of the C function.
        precision: "float" or "double".

    Returns:
        The paths of both files.

    Raises:
        ValueError: If a layer cannot be written in C, or the name is not a C identifier.
        OSError: If a file cannot be written.
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
    """Return the text of the header, which documents inputs and outputs with units and bounds."""
    guard = f"{name.upper()}_H"
    return f"""/* {_comment(policy.about)}

observation, each clipped to its bounds:
{_list(policy.inputs)}

setpoint (axes: world ENU, body FLU):
{_list(policy.outputs)}{_memory_note(policy)}
*/
#ifndef {guard}
#define {guard}

#define {name.upper()}_INPUTS {len(policy.inputs)}
#define {name.upper()}_OUTPUTS {len(policy.outputs)}
{f"#define {name.upper()}_HIDDEN {policy.memory}" if policy.memory else ""}
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
    hidden = f"{kind} hidden[{policy.memory}], " if policy.memory else ""
    return (
        f"const {kind} observation[{len(policy.inputs)}], {hidden}"
        f"{kind} setpoint[{len(policy.outputs)}]"
    )


def _memory_note(policy: Deployed) -> str:
    """Return the lines about the hidden state, if there is one."""
    if not policy.memory:
        return ""
    return "\n\nhidden: state of one drone, changed by each call; zeros before the first one"


def _list(labels: tuple[Label, ...]) -> str:
    """Return one line for each number, with name, unit and bounds."""
    return "\n".join(
        f"  [{k}] {_comment(label.name)}, {_comment(label.unit)}, "
        f"{label.low:.9g} to {label.high:.9g}"
        for k, label in enumerate(labels)
    )


def _comment(text: str) -> str:
    """Escape comment delimiters in a text, such as a label of a user."""
    return text.replace("*/", "* /").replace("/*", "/ *")


def _source(policy: Deployed, name: str, precision: str) -> str:
    """Return the text of the C file."""
    width = len(policy.inputs)
    widths = [width]
    tables: list[str] = []
    steps: list[str] = []
    # Each layer adds its tables and its code, and determines the input width of the next layer
    for k, layer in enumerate(policy.layers):
        write = LAYERS.get(type(layer))
        if write is None:
            raise ValueError(f"a layer {type(layer).__name__} cannot be written in C")
        given = width_after(layer, width)
        fields = _fields(layer, str(k), precision, tables)
        steps.append(f"    /* {type(layer).__name__} */\n{write(fields, width, given)}")
        width = given
        # The gates of a recurrent unit are three times as wide
        widths.append(3 * width if isinstance(layer, Gru) else width)
    # Both buffers have the width of the widest layer
    buffer_size = max(widths)
    is_swarm = any(isinstance(layer, SwarmLayer) for layer in policy.layers)
    suffix = "f" if precision == "float" else ""
    # Two buffers: dense layers read from one and write to the other
    return f"""/* {_comment(policy.about)}; see {name}.h */
#include "{name}.h"
#include <math.h>

typedef {precision} number;
#define F(function) function{"##f" if suffix else ""}
#define SYMLOG(scale, value) F(copysign)(F(log1p)((scale) * F(fabs)(value)), value)
#define LOGISTIC(value) ((F(tanh)((value) / 2) + 1) / 2)

{"".join(tables)}{_approach(precision) if is_swarm else ""}
void {name}({_arguments(policy, "number")})
{{
    number x[{buffer_size}], y[{buffer_size}];
    int i, j = 0{", other" if is_swarm else ""};
    for (i = 0; i < {len(policy.inputs)}; i++) x[i] = observation[i];
{"".join(steps)}    for (i = 0; i < {len(policy.outputs)}; i++) setpoint[i] = x[i];
    (void)y;
    (void)j;
}}
"""


class _Table(NamedTuple):
    """Name and shape of a constant array in C."""

    name: str
    shape: tuple[int, ...]

    def __str__(self) -> str:
        return self.name


def _fields(value: Any, name: str, precision: str, tables: list[str]) -> Any:
    """Add the arrays of a layer to the constants, and return its fields as C expressions."""
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
    """Format a number as a C literal that parses to the same bits."""
    value = float(np.float32(value)) if precision == "float" else float(value)
    if np.isinf(value):
        return "HUGE_VAL" if value > 0 else "-HUGE_VAL"
    text = f"{value:.9g}" if precision == "float" else repr(value)
    text = text if any(sign in text for sign in ".e") else f"{text}.0"
    return f"{text}f" if precision == "float" else text


Fields = dict[str, Any]
"""C names of the tables and C literals of the numbers of a layer, by field name"""


def _each(body: str, width: int) -> str:
    """Return a C loop over the numbers of the buffer."""
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


def _gru(f: Fields, width: int, given: int) -> str:
    gates = 3 * given
    return f"""    {{
        number parts[{gates}];
        for (i = 0; i < {gates}; i++) {{
            y[i] = {f["bias_in"]}[i];
            parts[i] = {f["bias_hidden"]}[i];
            for (j = 0; j < {width}; j++) y[i] += {f["weight_in"]}[{width} * i + j] * x[j];
            for (j = 0; j < {given}; j++)
                parts[i] += {f["weight_hidden"]}[{given} * i + j] * hidden[j];
        }}
        for (i = 0; i < {given}; i++) {{
            const number reset = LOGISTIC(y[i] + parts[i]);
            const number update = LOGISTIC(y[{given} + i] + parts[{given} + i]);
            x[i] = F(tanh)(y[{2 * given} + i] + reset * parts[{2 * given} + i]);
            hidden[i] = x[i] = (1 - update) * x[i] + update * hidden[i];
        }}
    }}
"""


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
    """Return the C function of the closest approach to another drone on straight paths."""
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
    """Return code that writes sum and maximum over the others of one kind to y[place:]."""
    columns, motion = kind["columns"], kind["motion"]
    count, width = columns.shape
    size = kind["layers"][-1]["bias"].shape[0]
    # Inputs for one other: its columns and, if they include its motion, the closest approach
    known = width + (APPROACH if motion.shape[0] else 0)
    # Longest vector between the layers, for the size of the C arrays
    buffer_size = max(layer["weight"].shape[1] for layer in kind["layers"])
    buffer_size = max(buffer_size, *(layer["bias"].shape[0] for layer in kind["layers"]))
    column = f"x[{columns}[{width} * other + i]]"
    # An absent drone is encoded as zeros, and left out of sum and maximum
    steps = f"""    for (i = 0; i < {2 * size}; i++) y[{place} + i] = 0;
    for (other = 0; other < {count}; other++) {{
        number here[{buffer_size}], next[{buffer_size}];
        int there = 0;
        for (i = 0; i < {width}; i++) {{
            there |= {column} != 0;
            here[i] = SYMLOG({scale}, {column});
        }}
        if (!there) continue;
"""
    if motion.shape[0]:
        steps += f"        approach(x, {columns} + {width} * other, {motion}, here + {width});\n"
    # The layers take the drone's own features after those of the other
    if own:
        steps += f"        for (i = 0; i < {own}; i++) here[{known} + i] = y[i];\n"
    # Dense layers, each followed by a ReLU
    for layer in kind["layers"]:
        outputs, inputs = layer["weight"].shape
        steps += f"""        for (i = 0; i < {outputs}; i++) {{
            next[i] = {layer["bias"]}[i];
            for (j = 0; j < {inputs}; j++) next[i] += {layer["weight"]}[{inputs} * i + j] * here[j];
        }}
        for (i = 0; i < {outputs}; i++) here[i] = next[i] > 0 ? next[i] : 0;
"""
    # The sum is halved, as in the trained network; after a ReLU all features are at least 0
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
    Gru: _gru,
    Tanh: _tanh,
    Relu: _relu,
    SquareRoot: _square_root,
    LimitNorm: _limit_norm,
    Argmax: _choose,
    Lookup: _lookup,
    SwarmLayer: _swarm,
}
"""Functions that write the C code of each type of layer, from fields, input and output width"""


def find_compiler() -> str | None:
    """Return the path of a C compiler, or None if none is installed."""
    return shutil.which("gcc") or shutil.which("cc")


def run_c(path: Path, rows: np.ndarray, policy: Deployed, precision: str) -> np.ndarray:
    """Compile a C file of `write_c`, and run it on observations.

    Args:
        path: The C file.
        rows: (M, D) observations; with a hidden state, consecutive ones of one drone.
        policy: The policy that the file was written from.
        precision: Precision of the file, "float" or "double".

    Returns:
        (M, S) setpoints.

    Raises:
        ValueError: If no compiler is installed, or the file does not compile.
    """
    found = find_compiler()
    if found is None:
        raise ValueError("no C compiler is installed (gcc or cc)")
    kind: Any = ctypes.c_float if precision == "float" else ctypes.c_double
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "policy.so"
        # Strict C99, and warnings are errors, as for code of a microcontroller
        strict = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
        done = subprocess.run(
            [found, *strict, str(path), "-o", str(library), "-lm"],
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            raise ValueError(f"{path} does not compile: {done.stderr}")
        # One call for each observation, as on a drone
        function = getattr(ctypes.CDLL(str(library)), path.stem)
        given = np.empty((len(rows), len(policy.outputs)))
        hidden = [(kind * policy.memory)()] if policy.memory else []
        for row, out in zip(rows, given, strict=True):
            setpoint = (kind * len(out))()
            function((kind * len(row))(*map(float, row)), *hidden, setpoint)
            out[:] = list(setpoint)
    return given
