"""Arguments of `bulletuav identify`."""

import argparse
from pathlib import Path

from bulletuav.commands.parsers.deferred import DeferredHelp

ABOUT = {
    "help": "fit an airframe's constants to flight logs and write its URDF",
    "description": (
        "Fit constants of an airframe to flight logs. Print them with 95 % intervals, and the "
        "errors of predictions of held-out data. Write a URDF, a report and a picture."
    ),
    "epilog": """examples:
  bulletuav identify --example flight.csv --airframe cf2x
  bulletuav identify flight.csv --airframe cf2x --out fitted
  bulletuav identify flight.csv --airframe cf2x --fit thrust,drag,lag --mass 0.0312""",
}


EXAMPLE_SECONDS = 20.0
"""Duration of the example flight, s"""


@DeferredHelp
def _airframes() -> str:
    from bulletuav.vehicle.airframes import available_airframes

    return f"airframe of the logs: {', '.join(available_airframes())}, or the path of a URDF"


@DeferredHelp
def _constants() -> str:
    from bulletuav.identification.constants import BATTERY, CONSTANTS, GROUPS, MOTOR_GAINS

    return (
        f"groups ({', '.join((*GROUPS, BATTERY, MOTOR_GAINS))}) or constants "
        f"({', '.join(constant.name for constant in CONSTANTS)}) (default: all identifiable)"
    )


@DeferredHelp
def _factors() -> str:
    from bulletuav.identification.logs import FACTORS

    return (
        f"column of a quantity, if its name or unit differs, as NAME=COLUMN[*FACTOR][+OFFSET]; a "
        f"factor is a number or one of {', '.join(FACTORS)}, with a minus sign for a reversed "
        f"axis, such as t=time*ms q=gyro_y*-deg z=altitude*mm-0.03"
    )


@DeferredHelp
def _window() -> str:
    from bulletuav.identification.identify import WINDOW

    return f"duration of the predicted windows (default: {WINDOW:g})"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add logs, airframe, constants to fit, and output folder."""
    # Data: logs and airframe
    parser.add_argument(
        "logs",
        nargs="*",
        type=Path,
        metavar="LOG",
        help="CSV files with named columns, ULog files (PX4), ROS bags, logs of Crazyflie's "
        "micro-SD deck, or recordings of AirSim",
    )
    parser.add_argument(
        "--example",
        type=Path,
        metavar="FILE",
        help=f"only write the log of a simulated flight of {EXAMPLE_SECONDS:g} s, as an example of "
        "the format of logs",
    )
    parser.add_argument(
        "--airframe",
        required=True,
        help=_airframes,
    )
    parser.add_argument(
        "--fit",
        default="",
        metavar="A,B",
        help=_constants,
    )
    parser.add_argument(
        "--map",
        nargs="+",
        action="extend",
        default=[],
        metavar="NAME=COLUMN",
        help=_factors,
    )
    parser.add_argument(
        "--measured",
        action="store_true",
        help="rotor speeds of the logs (w1 ..., rpm1 ...) are measured, not commanded: the motors' "
        "lag is not applied",
    )
    parser.add_argument(
        "--clocks",
        action="store_true",
        help="fit the delays of positions and velocities behind the attitude, too, for logs in "
        "which their clocks differ",
    )
    parser.add_argument(
        "--mass", type=float, metavar="KG", help="take-off mass (default: that of the airframe)"
    )
    parser.add_argument(
        "--window",
        type=float,
        metavar="S",
        help=_window,
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("identified"),
        metavar="DIR",
        help="folder for the files (default: identified)",
    )
