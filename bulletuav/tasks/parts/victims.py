"""Detection of victims, searched ground, and what drones share of it by radio."""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import kernel


class Detection(NamedTuple):
    """Distances and times of detection.

    Attributes:
        sight_radius: Horizontal distance up to which drones see victims below them, m.
        cell_radius: Horizontal distance of a square's point within which it is searched, m.
        hover_radius: Maximum horizontal distance of a hover from the victim, m.
        hover_low: Minimum height of a hover above the victim's top, m.
        hover_high: Maximum height of a hover above the victim's top, m.
        hover_decisions: Number of decisions of a hover that finds a victim.
        sight_noise: Standard deviation of an observed offset on each axis, as a fraction of the
            distance.
        radio_range: Distance up to which drones share their knowledge, m.
    """

    sight_radius: float
    cell_radius: float
    hover_radius: float
    hover_low: float
    hover_high: float
    hover_decisions: int
    sight_noise: float
    radio_range: float


class Findings(NamedTuple):
    """What N drones found and searched, of M victims and C squares of the ground.

    Attributes:
        found_at: (W, M) time at which a victim was first found, s; 0 before.
        finds: (W, N) number of victims that a drone was the first to find.
        hover: (W, N, M) decisions for which a drone has hovered above a victim so far.
        known_found: (W, N, M) 1 for victims that a drone knows as found.
        own_cells: (W, N, C) 1 for squares that a drone searched itself.
        known_cells: (W, N, C) 1 for squares that a drone knows as searched.
        sighting: (W, N, 4) 1 if a victim is in sight, and its offset with noise, m; else zeros.
        sighted: (W, N) number of this victim from 1; 0 for none.
        newly_found: (W, N) fraction of the victims that any drone found in the decision.
        newly_searched: (W, N) fraction of the squares that a drone was the first to search in the
            decision, divided by the number of drones that searched a square together.
        approached: (W, N) decrease in the decision of the distance to the middle of the hover above
            the victim in sight, m; 0 unless it was in sight before.
    """

    found_at: np.ndarray
    finds: np.ndarray
    hover: np.ndarray
    known_found: np.ndarray
    own_cells: np.ndarray
    known_cells: np.ndarray
    sighting: np.ndarray
    sighted: np.ndarray
    newly_found: np.ndarray
    newly_searched: np.ndarray
    approached: np.ndarray


@kernel
def update_findings(
    before: np.ndarray,
    position: np.ndarray,
    alive: np.ndarray,
    time: np.ndarray,
    seen: np.ndarray,
    top: np.ndarray,
    cell: np.ndarray,
    has_ground: np.ndarray,
    heard: np.ndarray,
    noise: np.ndarray,
    detection: Detection,
    findings: Findings,
    previous_found: np.ndarray,
    previous_cells: np.ndarray,
) -> None:
    """Update the findings of all drones after a decision.

    Args:
        before: (W, N, 3) positions before the decision, m.
        position: (W, N, 3) positions after it, m.
        alive: (W, N) bool, drones that flew the decision.
        time: (W,) time since the reset, s.
        seen: (W, N, M + C) bool, victims and points of squares in line of sight.
        top: (W, M, 3) tops of the victims, m.
        cell: (W, C, 3) points of the squares, m.
        has_ground: (W, C) 1 for squares to search.
        heard: (W, N, N) bool, which drones each drone hears.
        noise: (W, N, 3) standard normal numbers.
        detection: Distances and times.
        findings: Updated.
        previous_found: (W, N, M) copy of `known_found` before the decision.
        previous_cells: (W, N, C) copy of `known_cells` before the decision.
    """
    worlds, drones = alive.shape
    victims, cells = top.shape[1], cell.shape[1]
    middle = 0.5 * (detection.hover_low + detection.hover_high)
    for w in range(worlds):
        # Squares to search, and those that drones search first in this decision
        to_search = 0
        for c in range(cells):
            if has_ground[w, c] > 0.0:
                to_search += 1
        for i in range(drones):
            findings.newly_found[w, i] = 0.0
            findings.newly_searched[w, i] = 0.0
            findings.approached[w, i] = 0.0
        for c in range(cells):
            if has_ground[w, c] == 0.0:
                continue
            was_searched = False
            for i in range(drones):
                was_searched = was_searched or findings.own_cells[w, i, c] > 0.0
            together = 0
            for i in range(drones):
                if not (alive[w, i] and seen[w, i, victims + c]):
                    continue
                x = cell[w, c, 0] - position[w, i, 0]
                y = cell[w, c, 1] - position[w, i, 1]
                if x * x + y * y <= detection.cell_radius * detection.cell_radius:
                    findings.own_cells[w, i, c] = 1.0
                    findings.known_cells[w, i, c] = 1.0
                    together += 1
            if not was_searched:
                for i in range(drones):
                    if findings.own_cells[w, i, c] > 0.0:
                        findings.newly_searched[w, i] += 1.0 / (together * to_search)
        # Hovers and finds
        num_found = 0
        for j in range(victims):
            is_new = False
            for i in range(drones):
                if not alive[w, i]:
                    continue
                x = top[w, j, 0] - position[w, i, 0]
                y = top[w, j, 1] - position[w, i, 1]
                up = position[w, i, 2] - top[w, j, 2]
                is_above = detection.hover_low <= up <= detection.hover_high
                is_near = x * x + y * y <= detection.hover_radius * detection.hover_radius
                if not (is_above and is_near):
                    findings.hover[w, i, j] = 0.0
                    continue
                findings.hover[w, i, j] += 1.0
                if findings.hover[w, i, j] >= detection.hover_decisions:
                    findings.known_found[w, i, j] = 1.0
                    if findings.found_at[w, j] == 0.0 or is_new:
                        findings.found_at[w, j] = time[w]
                        findings.finds[w, i] += 1.0
                        is_new = True
            if is_new:
                num_found += 1
        for i in range(drones):
            findings.newly_found[w, i] = num_found / victims
        # Radio: each drone learns what the others in range knew before the decision
        for i in range(drones):
            for k in range(drones):
                if i == k or not (alive[w, i] and alive[w, k] and heard[w, i, k]):
                    continue
                square = 0.0
                for axis in range(3):
                    square += (position[w, k, axis] - position[w, i, axis]) ** 2
                if square > detection.radio_range * detection.radio_range:
                    continue
                for j in range(victims):
                    if previous_found[w, k, j] > 0.0:
                        findings.known_found[w, i, j] = 1.0
                for c in range(cells):
                    if previous_cells[w, k, c] > 0.0:
                        findings.known_cells[w, i, c] = 1.0
        # The nearest victim in sight that the drone does not know as found
        for i in range(drones):
            if not alive[w, i]:
                continue
            nearest, best = -1, math.inf
            for j in range(victims):
                x = top[w, j, 0] - position[w, i, 0]
                y = top[w, j, 1] - position[w, i, 1]
                z = top[w, j, 2] - position[w, i, 2]
                flat = x * x + y * y
                is_hidden = findings.known_found[w, i, j] > 0.0 or not seen[w, i, j] or z >= 0.0
                if is_hidden or flat > detection.sight_radius * detection.sight_radius:
                    continue
                if flat + z * z < best:
                    nearest, best = j, flat + z * z
            for k in range(4):
                findings.sighting[w, i, k] = 0.0
            was_sighted = findings.sighted[w, i] == nearest + 1.0
            findings.sighted[w, i] = nearest + 1.0
            if nearest < 0:
                continue
            spread = detection.sight_noise * math.sqrt(best)
            findings.sighting[w, i, 0] = 1.0
            now, earlier = 0.0, 0.0
            for axis in range(3):
                away = top[w, nearest, axis] - position[w, i, axis]
                findings.sighting[w, i, axis + 1] = away + spread * noise[w, i, axis]
                goal = top[w, nearest, axis] + (middle if axis == 2 else 0.0)
                now += (goal - position[w, i, axis]) ** 2
                earlier += (goal - before[w, i, axis]) ** 2
            if was_sighted:
                findings.approached[w, i] = math.sqrt(earlier) - math.sqrt(now)
