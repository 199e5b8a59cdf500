"""Files of an identification: a URDF, a report in Markdown, and a table in JSON."""

import dataclasses
import json
import shutil
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bulletuav.errors import read_file
from bulletuav.files import replace_file
from bulletuav.identification.errors import DELAY_UNIT, LOG_PARAMETERS, TILT_UNIT
from bulletuav.identification.fitting import BLOCK
from bulletuav.identification.identify import Identification, Prediction
from bulletuav.identification.intervals import LEVEL
from bulletuav.vehicle.airframe import Airframe

KINDS = ("naive", "before", "after")
MEASURES = (
    ("position, horizontal, m", "translation", slice(0, 2), 1.0),
    ("position, vertical, m", "translation", slice(2, 3), 1.0),
    ("velocity, horizontal, m/s", "translation", slice(3, 5), 1.0),
    ("velocity, vertical, m/s", "translation", slice(5, 6), 1.0),
    ("tilt, deg", "rotation", slice(0, 2), 180 / np.pi),
    ("turn about z, deg", "rotation", slice(2, 3), 180 / np.pi),
    ("rates, roll and pitch, rad/s", "rotation", slice(3, 5), 1.0),
    ("rates, yaw, rad/s", "rotation", slice(5, 6), 1.0),
)
"""Name of an error, its field and columns in `PredictionErrors`, and its factor"""


def write_urdf(result: Identification, folder: Path) -> Path:
    """Write the fitted airframe as a URDF file.

    The file is a copy of the airframe's URDF with other numbers, and a comment on their origin.

    Args:
        result: The identification.
        folder: Folder of the file and of its meshes.

    Returns:
        The path of the file.
    """
    source = result.before.urdf
    text = read_file(source)
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    root = ElementTree.fromstring(text, parser)
    _set_numbers(root, result.airframe)
    # Comments before the root element are not part of the parsed tree
    head = text[: text.index(f"<{root.tag}")]
    path = folder / f"{result.before.name}.urdf"
    for mesh in root.iter("mesh"):
        name = mesh.get("filename", "")
        if name and (source.parent / name).is_file() and source.parent != folder:
            # A mesh outside of the URDF's folder is copied into `folder`, too
            inside = (folder / name).resolve().is_relative_to(folder.resolve())
            copy = folder / (name if inside else Path(name).name)
            mesh.set("filename", copy.relative_to(folder).as_posix())
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source.parent / name, copy)
    robot = ElementTree.tostring(root, encoding="unicode")
    replace_file(path, f"{head}<!-- {_describe_origin(result)} -->\n{robot}\n")
    return path


def _describe_origin(result: Identification) -> str:
    """Describe which constants were fitted to which logs."""
    fitted = (
        ", ".join(one.constant.name for one in result.estimates if one.is_identified) or "nothing"
    )
    if result.battery is not None:
        names = ("resistance", "capacity")
        fitted += "".join(
            f", battery {name}"
            for name, is_identified in zip(names, result.battery.is_identified, strict=True)
            if is_identified
        )
    logs = ", ".join(item.part.flight.log.path.name for item in result.fitted)
    speeds = " with measured rotor speeds" if has_measured_speeds(result) else ""
    text = f"Fitted by bulletuav identify: {fitted}. Logs{speeds}: {logs}. See report.md."
    # XML forbids two hyphens in a comment
    return text.replace("--", "-")


def has_measured_speeds(result: Identification) -> bool:
    """Return whether the rotor speeds of the logs were measured, not commanded."""
    return result.fitted[0].part.flight.measured


def _set_numbers(root: ElementTree.Element, airframe: Airframe) -> None:
    """Write an airframe's constants into its URDF, including omitted ones."""
    x, y, z = airframe.inertia
    place = root.find("link/inertial")
    assert place is not None  # as the airframe was read from this file
    _set(place, "mass", value=airframe.mass)
    _set(place, "inertia", ixx=x, iyy=y, izz=z)
    own = root.find("airframe")
    assert own is not None
    _set(own, "thrust_coefficient", value=airframe.thrust_coefficient)
    _set(own, "torque_ratio", value=airframe.torque_ratio)
    _set(own, "motor_lag", up=airframe.lag_up, down=airframe.lag_down)
    drag = {"xy": airframe.drag_xy, "z": airframe.drag_z, "height": airframe.drag_height}
    _set(own, "rotor_drag", **drag)
    x, y, z = airframe.damping
    _set(own, "rate_damping", x=x, y=y, z=z)
    gain = airframe.ground_effect_gain
    _set(own, "ground_effect", gain=gain, reach=airframe.ground_effect_reach)
    wake = {"share": airframe.wake_share, "spread": airframe.wake_spread}
    _set(own, "wake", radius=airframe.wake_radius, **wake)
    _set(own, "body_drag", xy=airframe.body_drag[0], z=airframe.body_drag[1])
    _set(own, "power", efficiency=airframe.efficiency, electronics=airframe.electronics)
    if airframe.pack is not None:
        pack = airframe.pack
        numbers = {"capacity": pack.capacity, "resistance": pack.resistance}
        _set(own, "battery", **numbers, voltage=pack.voltage)


def _set(parent: ElementTree.Element, tag: str, **numbers: float) -> None:
    """Set attributes of an element, which is created if missing; equal values keep their text."""
    element = parent.find(tag)
    if element is None:
        element = ElementTree.SubElement(parent, tag)
        element.tail = "\n    "
    for name, number in numbers.items():
        if name not in element.attrib or float(element.attrib[name]) != number:
            element.set(name, repr(float(number)))


def compute_rms(predictions: Sequence[Prediction], kind: str) -> list[float]:
    """Return the RMS of the errors at the ends of legs, for each of `MEASURES`.

    Args:
        predictions: Predictions in several logs.
        kind: One of `KINDS`.
    """
    found = []
    for _, field, columns, factor in MEASURES:
        ends = [getattr(getattr(one, kind), field) for one in predictions]
        # Final states of the guided leg of a window, or of its two free legs
        final = [values[:, [-1]] if field == "translation" else values[:, 4::5] for values in ends]
        joined = np.concatenate([values[..., columns].reshape(-1) for values in final])
        size = columns.stop - columns.start
        found.append(factor * float(np.sqrt(size * np.mean(joined**2))))
    return found


def summarize(result: Identification) -> dict[str, Any]:
    """Return the identification as a dict for JSON; missing values are None."""
    constants = {
        one.constant.name: {
            "unit": one.constant.unit,
            "before": one.before,
            "after": one.after,
            "low": one.low if one.is_identified else None,
            "high": one.high if one.is_identified else None,
            "told": one.is_identified,
        }
        for one in result.estimates
    }
    if result.battery is not None:
        pairs = (("resistance", "ohm"), ("capacity", "W h"))
        for (name, unit), is_identified in zip(pairs, result.battery.is_identified, strict=True):
            value, low, high = getattr(result.battery, name)
            before = getattr(result.before.pack, name)
            constants[f"battery_{name}"] = {
                "unit": unit,
                "before": before,
                "after": value if is_identified else before,
                "low": low if is_identified else None,
                "high": high if is_identified else None,
                "told": is_identified,
            }
    names = [name for name, *_ in MEASURES]
    errors = {
        part: {
            kind: dict(zip(names, compute_rms(predictions, kind), strict=True)) for kind in KINDS
        }
        for part, predictions in (("fitted", result.fitted), ("kept", result.kept))
    }
    return {
        "airframe": result.before.name,
        "level": LEVEL,
        "window": result.window,
        "measured": has_measured_speeds(result),
        "constants": constants,
        "errors": errors,
        "logs": [*_describe_logs("fitted", result.fitted), *_describe_logs("kept", result.kept)],
        "clocks": [dataclasses.asdict(offset) for offset in result.clocks],
        "note": result.note,
    }


def _describe_logs(use: str, predictions: Sequence[Prediction]) -> list[dict[str, Any]]:
    """Describe the logs and their per-log parameters."""
    found = []
    for one in predictions:
        flight = one.part.flight
        tilt = np.degrees(TILT_UNIT * one.log_parameters[1:3])
        found.append(
            {
                "log": flight.log.path.name,
                "use": use,
                "windows": len(one.part.windows),
                "command_delay": DELAY_UNIT
                * float(one.log_parameters[LOG_PARAMETERS.index("delay")]),
                "gyro_delay": flight.gyro_delay,
                "gyro_bias": [float(rate) for rate in flight.gyro_bias],
                "tilt_deg": [float(angle) for angle in tilt],
                "gain": 1 + 0.01 * float(one.log_parameters[LOG_PARAMETERS.index("gain")]),
                "filled": dict(flight.log.filled),
                "columns": dict(flight.log.used),
                "unused": list(flight.log.unused),
            }
        )
    return found


def format_report(result: Identification) -> str:
    """Format the report in Markdown: constants, prediction errors, and logs."""
    table = summarize(result)
    window = result.window
    motors = "measured speeds" if table["measured"] else "commands"
    lines = [
        f"# {result.before.name}, fitted to {len({row['log'] for row in table['logs']})} log(s)",
        "",
        f"Intervals are of {100 * LEVEL:.0f} %. Mass: {result.airframe.mass:g} kg, as given: "
        f"forces and inertia scale with it. Motors: {motors}.",
        "",
        "| constant | unit | before | after | interval |",
        "|---|---|---|---|---|",
    ]
    for name, row in table["constants"].items():
        interval = f"{row['low']:.4g} to {row['high']:.4g}" if row["told"] else "not identified"
        lines.append(
            f"| {name} | {row['unit']} | {row['before']:.5g} | {row['after']:.5g} | {interval} |"
        )
    if result.note:
        lines += ["", result.note]
    kept = (
        "every other log" if result.whole_logs else f"every other {BLOCK * window:g} s of the log"
    )
    lines += [
        "",
        "## Errors of predictions",
        "",
        f"RMS after {window:g} s of position and velocity, with the attitude as measured, and "
        f"after {window / 2:g} s of attitude and rates. Kept: {kept}. Naive: velocity and rates "
        "are constant.",
        "",
        "| | fitted: naive | before | after | kept: naive | before | after |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, *_ in MEASURES:
        cells = [
            f"{table['errors'][part][kind][name]:.4g}"
            for part in ("fitted", "kept")
            for kind in KINDS
        ]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    lines += [
        "",
        "## Logs",
        "",
        f"Delays of {motors} and gyroscope against the attitude, which were compensated. Tilt: of "
        "the body whose attitude was measured. Gain: thrust relative to that of all logs.",
        "",
        f"| log | use | windows | {motors}, ms | gyro, ms | tilt x, y, deg | gain | filled in |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in table["logs"]:
        tilt = ", ".join(f"{angle:.2f}" for angle in row["tilt_deg"])
        filled = ", ".join(f"{name}: {count}" for name, count in row["filled"].items()) or "none"
        lines.append(
            f"| {row['log']} | {row['use']} | {row['windows']} | "
            f"{1e3 * row['command_delay']:.1f} | {1e3 * row['gyro_delay']:.1f} | {tilt} | "
            f"{row['gain']:.3f} | {filled} |"
        )
    if result.clocks:
        lines += [
            "",
            "## Clocks",
            "",
            "Delays behind the attitude in the fitted logs, which were compensated. Those of "
            "held-out logs were fitted to half of their windows.",
            "",
            "| log | quantity | delay, ms | interval |",
            "|---|---|---|---|",
        ]
        for offset in result.clocks:
            delay, low, high = (1e3 * time for time in (offset.delay, offset.low, offset.high))
            lines.append(
                f"| {offset.log} | {offset.quantity} | {delay:.2f} | {low:.2f} to {high:.2f} |"
            )
    return "\n".join(lines) + "\n"


def write_report(result: Identification, folder: Path) -> list[Path]:
    """Write report.md and report.json.

    Returns:
        The files.
    """
    files = [folder / "report.md", folder / "report.json"]
    replace_file(files[0], format_report(result))
    replace_file(files[1], json.dumps(summarize(result), indent=1) + "\n")
    return files
