"""Flights of gym-pybullet-drones: its examples, and fixed actions of its learning environment."""

import tempfile
from pathlib import Path

import numpy as np

from bulletuav.report.figures import blank_figure
from bulletuav.reproduction.gym_pybullet_drones import (
    RESTART,
    compare_controllers,
    fly_like_peer,
    fly_peer_examples,
    read_peer_airframe,
)
from bulletuav.reproduction.gym_pybullet_drones_child import ACTIONS, EXAMPLES
from bulletuav.reproduction.table import Data, Reproduction, Row, Settings, TableOutcome

SECONDS = 5
"""Duration of the flights, s"""
SHIFT = 1e-9
"""Shift of the starts in the flight that measures how sensitive a flight is, m and rad"""
MAX_DISTANCE, MAX_SPEED_DIFFERENCE = 0.01, 1.0
"""Differences of positions, m, and of rotor speeds, rpm, that count as none"""
TITLES = {name: f"{name}.py" for name in EXAMPLES} | {
    kind: f"hover, {kind.lower()}" for kind in ACTIONS
}
"""Titles of the flights"""


def distances(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the distance (T,) between two flights of the farthest of the drones, by name, m."""
    return {
        name: np.sqrt(((one[name][..., :3] - other[name][..., :3]) ** 2).sum(-1)).max(axis=1)
        for name in one
    }


def _compute(settings: Settings) -> TableOutcome:
    """Fly both, and compare."""
    assert settings.data is not None
    seconds = settings.count(SECONDS)
    peer = fly_peer_examples(settings.data, seconds)
    settings.progress(0.2)
    moved = distances(peer, fly_peer_examples(settings.data, seconds, SHIFT))
    settings.progress(0.4)
    with tempfile.TemporaryDirectory() as place:
        airframe = read_peer_airframe(settings.data, Path(place))
        speeds = compare_controllers(airframe, peer, seconds)
        settings.progress(0.5)
        apart = {}
        for k, manner in enumerate(("closed", "open", "plain")):
            apart[manner] = distances(peer, fly_like_peer(airframe, peer, seconds, manner))
            settings.progress(0.65 + 0.15 * k)
    rows = []
    for name, title in TITLES.items():
        own = float(moved[name].max())
        why = (
            f"chaotic: gym-pybullet-drones' own flight moves by {own:.3f} m if its start is "
            f"shifted by {SHIFT:g} m and rad"
        )
        furthest, restarted = (float(apart[manner][name].max()) for manner in ("closed", "open"))
        # A flight that leaves further than its own noise is not explained by it
        is_chaotic = MAX_DISTANCE < furthest < 2.0 * own
        again = f"distance in {RESTART:g} s with its rotor speeds"
        rows += [
            Row(f"{title}: {kind}", found, 0.0, unit, tolerance=tolerance, why=reason)
            for kind, found, unit, tolerance, reason in (
                (f"distance over {seconds} s", furthest, "m", MAX_DISTANCE, why * is_chaotic),
                (again, restarted, "m", MAX_DISTANCE, ""),
                ("rotor speeds in its states", speeds[name], "rpm", MAX_SPEED_DIFFERENCE, ""),
            )
        ]
    figure = blank_figure(10, 6)
    for axes, name in zip(figure.subplots(2, 4, sharey=True).flat, TITLES, strict=True):
        time = seconds * np.arange(1, len(moved[name]) + 1) / len(moved[name])
        for label, track in (
            ("bulletuav", apart["closed"][name]),
            (f"bulletuav, its rotor speeds, {RESTART:g} s", apart["open"][name]),
            (f"itself, start shifted by {SHIFT:g}", moved[name]),
        ):
            axes.semilogy(time, np.maximum(track, 1e-12), label=label, linewidth=1)
        axes.axhline(MAX_DISTANCE, color="0.6", linestyle="--", linewidth=1)
        axes.set_title(TITLES[name], fontsize=9)
    for axes in figure.axes[4:]:
        axes.set_xlabel("time (s)")
    for axes in figure.axes[::4]:
        axes.set_ylabel("distance (m)")
    lines = figure.axes[0].get_legend_handles_labels()
    figure.legend(*lines, loc="outside lower center", ncols=3, fontsize=8)
    plain = {TITLES[name]: round(float(one.max()), 6) for name, one in apart["plain"].items()}
    notes = (
        "Distances are those of the farthest drone at any time; the dashed line is 1 cm.",
        "Bullet integrates by semi-implicit Euler steps, damps motion by 0.04 / s, and "
        "gym-pybullet-drones' thrusts have the direction of the physics step before. These three "
        "are emulated; without the first and the last the vertical flights differ by up to "
        f"{max(plain['hover, one_d_rpm'], plain['hover, one_d_pid']):.1g} m.",
        "No trained policy comes with gym-pybullet-drones: the five kinds of actions of its "
        "learn.py fly fixed sequences.",
    )
    extra = {"distance with the steps of rigid_body, m": plain}
    extra["distance of its own flight with a shifted start, m"] = {
        TITLES[name]: float(one.max()) for name, one in moved.items()
    }
    settings.progress(1.0)
    return TableOutcome(rows, figure, notes, extra)


REPRODUCTION = Reproduction(
    title="Flights of gym-pybullet-drones",
    publication=(
        "J. Panerati et al., Learning to fly: a gym environment with PyBullet physics for "
        "reinforcement learning of multi-agent quadcopter control, IROS 2021"
    ),
    address="https://github.com/learnsyslab/gym-pybullet-drones",
    about=(
        "Its scripts pid.py, pid_velocity.py and downwash.py, and fixed actions of its learning "
        "environment, run in a subprocess of the same Python; the same flights follow here with "
        "its constants. Published are the trajectories that its code computes."
    ),
    minutes=1.0,
    compute=_compute,
    data=Data(
        repository="https://github.com/learnsyslab/gym-pybullet-drones",
        commit="90b178aba69b09085dd70e7a1e88bb58ca00b4c9",
        licence="MIT",
        contains="gym_pybullet_drones/assets/cf2x.urdf",
    ),
)
