"""Line of sight and path loss between drones and the ground by Al-Hourani et al."""

import math

import numpy as np

from bulletuav.city.sight_probability import SIGMOIDS, elevation_los, fitted_sigmoid, p1410_los
from bulletuav.city.statistics import KINDS
from bulletuav.network.propagation import EXCESS, mean_path_loss
from bulletuav.report.figures import blank_figure
from bulletuav.reproduction.formulas import formula_row, printed_row
from bulletuav.reproduction.table import Reproduction, Row, Settings, TableOutcome

# envs/common.py of https://github.com/zhangxiaochen95/uav_bs_ctrl, commit 0f3128e
PRINTED = {
    "suburban": ("4.88", "0.43"),
    "urban": ("9.61", "0.16"),
    "dense": ("12.08", "0.11"),
    "high_rise": ("27.23", "0.08"),
}
"""Printed parameters a (degrees) and b (1/degree)"""

ELEVATIONS = (5, 15, 30, 45, 60, 90)
SIGHT = {
    "suburban": (
        0.17747556982785964,
        0.9408359547580221,
        0.9999006194527954,
        0.9999998429112551,
        0.9999999997517177,
        0.9999999999999993,
    ),
    "urban": (
        0.04740761507384633,
        0.19775197519401722,
        0.7309790961454965,
        0.9676918999472424,
        0.9969803670004501,
        0.999975074537903,
    ),
    "dense": (
        0.03660244226166797,
        0.10244473685000506,
        0.37277011680056615,
        0.7557740819386457,
        0.9415661250677834,
        0.9977162470810939,
    ),
    "high_rise": (
        0.006164777922543536,
        0.013617085942024721,
        0.04382572131392672,
        0.1320768404904893,
        0.3356546520067012,
        0.8477782407924896,
    ),
}
"""Line-of-sight probability by their eq. 5, by kind of area, at `ELEVATIONS` (degrees)"""

RAYS = ((100, 50), (200, 100), (500, 100), (500, 200))
P1410 = {
    "suburban": (1.0, 0.9999999981748106, 0.7747345158651593, 0.9955237340099179),
    "urban": (0.7708714827667688, 0.780562910103613, 0.1447943205253863, 0.513323542739054),
    "dense": (0.5634394188927809, 0.5734542491928165, 0.05635549364294687, 0.3214884675890804),
    "high_rise": (
        0.12419559943126837,
        0.08663648388367536,
        0.00020052290459315853,
        0.017985227292688793,
    ),
}
"""Line-of-sight probability by Rec. ITU-R P.1410, for the distances and heights (m) of `RAYS`"""

MEAN_LOSS = {
    ("urban", 45): 83.09253699280521,
    ("suburban", 30): 84.5910601018792,
    ("dense", 60): 82.56825542479544,
    ("high_rise", 45): 111.2918472482543,
}
"""Mean path loss at 2 GHz from 100 m height, dB, by kind of area and elevation (degrees)"""


def _fitted_rows() -> list[Row]:
    """Compare the parameters that the surfaces of table I give with printed ones."""
    rows = []
    for kind, (a, b) in PRINTED.items():
        fitted = fitted_sigmoid(KINDS[kind])
        rows += [
            printed_row(f"{kind}: a", fitted.a, a, "degrees"),
            printed_row(f"{kind}: b", fitted.b, b, "1/degree"),
        ]
    return rows


def _formula_rows() -> list[Row]:
    """Compare probabilities and losses with the formulas."""
    rows = []
    for kind in SIGMOIDS:
        for elevation, chance in zip(ELEVATIONS, SIGHT[kind], strict=True):
            sight = elevation_los(np.array(elevation), SIGMOIDS[kind])
            name = f"{kind}: LoS probability at {elevation} degrees"
            rows.append(formula_row(name, sight, chance))
    for kind in KINDS:
        for (distance, height), chance in zip(RAYS, P1410[kind], strict=True):
            clear = p1410_los(KINDS[kind], np.array(distance), np.array(height))
            rows.append(formula_row(f"{kind}: P.1410, {distance} m from {height} m", clear, chance))
    for (kind, elevation), loss in MEAN_LOSS.items():
        probability = float(elevation_los(np.array(elevation), SIGMOIDS[kind]))
        away = 100.0 / math.sin(math.radians(elevation))
        mean = mean_path_loss(away, 2.0, probability, *EXCESS[kind])
        rows.append(formula_row(f"{kind}: mean path loss at {elevation} degrees", mean, loss, "dB"))
    return rows


def _compute(settings: Settings) -> TableOutcome:
    """Compute parameters, probabilities and losses, and draw the probabilities."""
    rows = _fitted_rows() + _formula_rows()
    figure = blank_figure(7, 4.5)
    axes = figure.subplots()
    elevations = np.linspace(0.0, 90.0, 181)
    for kind, sigmoid in SIGMOIDS.items():
        (line,) = axes.plot(elevations, elevation_los(elevations, sigmoid), label=kind)
        fitted = fitted_sigmoid(KINDS[kind])
        axes.plot(elevations, elevation_los(elevations, fitted), "--", color=line.get_color(), lw=1)
        axes.plot(ELEVATIONS, SIGHT[kind], "o", color=line.get_color(), ms=4)
    axes.plot([], [], "k--", lw=1, label="from the surfaces of table I")
    axes.plot([], [], "ko", ms=4, label="eq. 5, 30 digits")
    axes.set(xlabel="elevation (degrees)", ylabel="probability of line of sight")
    axes.grid(alpha=0.3)
    axes.legend()
    settings.progress(1.0)
    return TableOutcome(
        rows,
        figure,
        [
            "The printed parameters are those of the program uav_bs_ctrl, which states Al-Hourani "
            "as its source.",
            'Rows that begin with "formula" have no printed number: the formulas are evaluated '
            "with 30 digits.",
            "The elevation of eq. 5 is in degrees. Public code that inserts radians finds a "
            "probability that hardly changes with the elevation.",
            "In table I, the first index is the power of alpha beta, the second that of gamma. "
            "Exchanged, as in public code, the urban parameters are a = 55.5 and b = -25.9.",
            "P.1410 ignores the wall next to the user: a city of blocks has fewer lines of sight. "
            "gamma is the mode of the heights, not their mean.",
        ],
    )


REPRODUCTION = Reproduction(
    title="Line of sight and path loss between drones and the ground",
    publication="A. Al-Hourani, S. Kandeepan, S. Lardner, Optimal LAP Altitude for Maximum "
    "Coverage, IEEE Wireless Communications Letters 3(6), 2014; Rec. ITU-R P.1410",
    address="https://doi.org/10.1109/LWC.2014.2342736",
    about="The parameters that the polynomial surfaces give for four kinds of areas against "
    "printed ones, and line-of-sight probabilities and mean path loss against the formulas, "
    "evaluated with 30 digits.",
    minutes=0.1,
    compute=_compute,
    is_scalable=False,
)
