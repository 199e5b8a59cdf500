"""Kernels as plain Python, for debuggers, prints and coverage.

Numba's own switch `NUMBA_DISABLE_JIT=1` enables it for a process, the option `debug=True` for one
environment, and `dispatcher.plain_kernels` for the calls of a thread in a `with` block. Results are
equal to those of machine code to the bit; a decision takes about a hundred times as long.

The plain function of a kernel has the code of its source file. Its constants and globals are
replaced by versions that behave as in compiled code: division by zero gives inf or NaN, functions
of `math` raise no errors, and numbers of several drones are arrays.
"""

import ast
import dis
import inspect
import math
import textwrap
import threading
import types
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numba import config
from numba.core.registry import cpu_target


class _Switch(threading.local):
    """Whether kernels that a thread calls run as plain Python."""

    is_on = bool(config.DISABLE_JIT)


SWITCH = _Switch()
"""See `bulletuav.compiled.dispatcher.plain_kernels`"""


class Intrinsic:
    """A function that generates code in compiled callers, and is plain Python elsewhere.

    Attributes:
        plain: The function in Python.
    """

    def __init__(self, compiled: Any, plain: Callable[..., Any]) -> None:
        """Combine an intrinsic with its Python version.

        Args:
            compiled: Numba's intrinsic.
            plain: Equivalent Python function.
        """
        self._compiled, self.plain = compiled, plain
        self.__name__, self.__doc__ = compiled.__name__, compiled.__doc__

    def __call__(self, *arguments: Any) -> Any:
        """Call the Python version."""
        return self.plain(*arguments)

    @property
    def _numba_type_(self) -> Any:
        """Numba type of the function for compiled callers."""
        return cpu_target.typing_context.resolve_value_type(self._compiled)


def in_python(plain: Callable[..., Any]) -> Callable[[Any], Any]:
    """Return a decorator of numba's intrinsics that adds an equivalent Python function."""
    return lambda compiled: Intrinsic(compiled, plain)


def record_type(fields: Any, align: bool = False) -> np.dtype[Any]:
    """Return the NumPy type of rows whose fields are attributes, in compiled code and in Python.

    Args:
        fields: Fields, as for `numpy.dtype`.
        align: Whether to align the fields, as for `numpy.dtype`.
    """
    return np.dtype((np.record, np.dtype(fields, align=align)))


def plain_function(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a kernel as a plain Python function, with the files and lines of its source."""
    scope, cells = function.__globals__, function.__closure__
    code = _with_products(function)
    read = [one.argval for one in dis.get_instructions(code) if one.opname == "LOAD_GLOBAL"]
    used = {name: _plain_value(scope[name]) for name in read if name in scope}
    made = types.FunctionType(
        code.replace(co_consts=as_compiled(code.co_consts)),
        {**scope, **_BUILTINS, **used},
        function.__name__,
        as_compiled(function.__defaults__),
        cells and tuple(types.CellType(_plain_value(cell.cell_contents)) for cell in cells),
    )
    made.__qualname__, made.__module__ = function.__qualname__, function.__module__
    return made


def _with_products(function: Callable[..., Any]) -> types.CodeType:
    """Return a function's code with integer powers replaced by products, as in compiled code.

    Python computes powers by the C library, whose last bit may differ. The code of a function
    without source is returned unchanged.
    """
    code = function.__code__
    if not any(one.argrepr == "**" for one in dis.get_instructions(code)):
        return code
    # The outer function defines the closure variables
    outer = ast.parse(f"def outer({', '.join(code.co_freevars)}):\n    return {function.__name__}")
    # Python 3.13 gives lines of `python -c` as the source of functions that `exec` defines
    try:
        source = textwrap.dedent(inspect.getsource(function))
        found = _Products().visit(ast.parse(source)).body
        for definition in found:
            definition.decorator_list = []
        outer.body[0].body[:0] = found  # type: ignore[attr-defined]
        ast.increment_lineno(ast.fix_missing_locations(outer), code.co_firstlineno - 1)
        (frame,) = _codes(compile(outer, code.co_filename, "exec"))
    except (OSError, SyntaxError):
        return code
    return next((one for one in _codes(frame) if one.co_name == code.co_name), code)


def _codes(code: types.CodeType) -> Iterator[types.CodeType]:
    """Yield the codes of the functions that a code defines."""
    return (one for one in code.co_consts if isinstance(one, types.CodeType))


class _Products(ast.NodeTransformer):
    """Replaces integer powers such as `x ** 2` by calls of `_product`."""

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        """Replace an integer power."""
        self.generic_visit(node)
        exponent = node.right
        is_whole = isinstance(exponent, ast.Constant) and isinstance(exponent.value, int)
        if not (isinstance(node.op, ast.Pow) and is_whole):
            return node
        call = ast.Call(ast.Name(_product.__name__, ast.Load()), [node.left, exponent], [])
        return ast.copy_location(call, node)


def _product(x: Any, exponent: int) -> Any:
    """Return an integer power, multiplied in the order of compiled code."""
    result, square = 1.0, x
    while exponent:
        if exponent % 2:
            result = result * square
        square, exponent = square * square, exponent // 2
    return result


def as_compiled(value: Any) -> Any:
    """Convert floats, also in tuples, to NumPy's, which divide by zero as compiled code does."""
    if type(value) is float:
        return np.float64(value)
    if isinstance(value, tuple):
        parts = [as_compiled(part) for part in value]
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    return value


def _plain_value(value: Any) -> Any:
    """Return the plain Python counterpart of a global that a kernel uses."""
    if value is math:
        return MATH
    return as_compiled(getattr(value, "plain", value))


class LaneNumbers(np.ndarray):
    """Array of numbers of several drones; in-place operators return a new array, as for floats."""

    __iadd__ = np.ndarray.__add__  # type: ignore[assignment]
    __isub__ = np.ndarray.__sub__  # type: ignore[assignment]
    __imul__ = np.ndarray.__mul__  # type: ignore[assignment]
    __itruediv__ = np.ndarray.__truediv__  # type: ignore[assignment]


def select_lanes(condition: Any, one: Any, other: Any) -> Any:
    """Return `one` where a condition holds, else `other`, for numbers or in each lane."""
    if isinstance(condition, np.ndarray):
        return np.where(condition, one, other).view(LaneNumbers)
    return one if condition else other


def _lane_max(first: Any, *others: Any) -> Any:
    """Return the maximum in each lane, as Python's `max` does."""
    for other in others:
        first = select_lanes(other > first, other, first)
    return first


def _lane_min(first: Any, *others: Any) -> Any:
    """Return the minimum in each lane, as Python's `min` does."""
    for other in others:
        first = select_lanes(other < first, other, first)
    return first


_BUILTINS = {"max": _lane_max, "min": _lane_min, "float": np.float64, _product.__name__: _product}


def _without_errors(function: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap a function of `math` to return inf or NaN instead of raising.

    The signs are those of compiled code, such as -inf for `sinh(-1000)` and `log(0)`. Functions
    that NumPy does not have return NaN.
    """
    in_numpy = getattr(np, function.__name__, None)

    def wrapped(*numbers: Any) -> Any:
        try:
            return as_compiled(function(*numbers))
        except (OverflowError, ValueError):
            with np.errstate(all="ignore"):
                return np.float64(math.nan if in_numpy is None else in_numpy(*numbers))

    return wrapped


def _sqrt(x: Any) -> Any:
    return np.sqrt(x) if isinstance(x, np.ndarray) else np.sqrt(np.float64(x))


def _floor(x: Any) -> Any:
    return np.floor(x) if isinstance(x, np.ndarray) else _without_errors(math.floor)(x)


def _make_math() -> types.SimpleNamespace:
    """Return a namespace with the functions of `math` as they behave in compiled code."""
    names = {name: value for name, value in vars(math).items() if not name.startswith("_")}
    wrapped = {
        name: _without_errors(value) if callable(value) else as_compiled(value)
        for name, value in names.items()
    }
    return types.SimpleNamespace(**{**wrapped, "sqrt": _sqrt, "floor": _floor})


MATH = _make_math()
