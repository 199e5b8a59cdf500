"""Rows of tables that compare formulas."""

from typing import Any

from bulletuav.reproduction.table import Row

RELATIVE_TOLERANCE = 1e-9
"""Difference to a formula that counts as none, divided by its value"""


ROUNDING = 1e-14
"""Relative error of a few operations in double precision"""


def printed_row(name: str, ours: float, printed: str, unit: str = "", why: str = "") -> Row:
    """Compare with a printed number: half a unit of its last digit counts as none.

    Args:
        name: Name of the number.
        ours: Number that is computed here.
        printed: Printed number, such as "4.880".
        unit: Unit.
        why: Explanation of a difference.

    Example:
        >>> printed_row("hover", 168.484, "168.5", "W").verdict
        'within'
    """
    decimals = len(printed.partition(".")[2])
    # Numbers that are printed in full also differ by the rounding of double precision
    tolerance = 0.5 * 10.0**-decimals + ROUNDING * abs(float(printed))
    return Row(name, float(ours), float(printed), unit, tolerance=tolerance, why=why)


def formula_row(name: str, ours: Any, value: float, unit: str = "") -> Row:
    """Compare with a published formula, evaluated independently with 30 digits.

    Args:
        name: Name of the number.
        ours: Number that is computed here.
        value: Value of the formula.
        unit: Unit.
    """
    tolerance = RELATIVE_TOLERANCE * abs(value)
    return Row(f"formula: {name}", float(ours), value, unit, tolerance=tolerance)
