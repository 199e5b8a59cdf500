"""Path loss, line of sight and antenna of 3GPP TR 38.901 and TR 36.777."""

import numpy as np

from bulletuav.network import antenna, tr36777, tr38901
from bulletuav.report.figures import blank_figure
from bulletuav.reproduction.formulas import formula_row, printed_row
from bulletuav.reproduction.table import Reproduction, Row, Settings, TableOutcome

LAWS = {
    "UMa LoS": tr38901.uma_los,
    "UMa NLoS": tr38901.uma_nlos,
    "UMi LoS": tr38901.umi_los,
    "UMi NLoS": tr38901.umi_nlos,
}
BASES = {"UMa": 25.0, "UMi": 10.0}
"""Heights of base stations, m"""

# src/propagation/test/three-gpp-propagation-loss-model-test-suite.cc of
# https://gitlab.com/nsnam/ns-3-dev, commit 0a0222c: users at 1.5 m, 5 GHz
DISTANCES = (10, 100, 1000, 5000)
NS3 = {
    "UMa LoS": ("72.9380", "86.2362", "109.7252", "137.6794"),
    "UMa NLoS": ("82.5131", "106.1356", "144.7641", "172.0753"),
    "UMi LoS": ("69.8591", "88.4122", "119.3114", "147.2696"),
    "UMi NLoS": ("76.7563", "107.9432", "143.1886", "167.8617"),
}
"""Path loss in the tests of ns-3, dB, by distance"""

LOSSES = {
    ("UMi LoS", 100, 10, 1.5, 29): 103.68078817347494,
    ("UMi LoS", 1000, 10, 1.5, 29): 124.64828941272904,
    ("UMi LoS", 4000, 10, 1.5, 2): 142.97794625548403,
    ("UMi LoS", 50, 10, 22.5, 6): 83.91784895531393,
    ("UMi NLoS", 100, 10, 1.5, 29): 124.20426002224788,
    ("UMi NLoS", 1000, 10, 1.5, 29): 159.44963115299407,
    ("UMi NLoS", 4000, 10, 1.5, 2): 155.96469121505123,
    ("UMi NLoS", 50, 10, 22.5, 6): 93.11296855468254,
    ("UMa LoS", 100, 25, 1.5, 29): 101.50475574782598,
    ("UMa LoS", 1000, 25, 1.5, 29): 123.25059746016979,
    ("UMa LoS", 4000, 25, 1.5, 2): 132.98957677787425,
    ("UMa LoS", 50, 25, 22.5, 6): 80.95229329727971,
    ("UMa NLoS", 100, 25, 1.5, 29): 121.40412266103438,
    ("UMa NLoS", 1000, 25, 1.5, 29): 160.03264512096143,
    ("UMa NLoS", 4000, 25, 1.5, 2): 160.32939727285626,
    ("UMa NLoS", 50, 25, 22.5, 6): 82.91996158757446,
}
"""Path loss by table 7.4.1-1, dB: law, distance, heights of base and user (m), frequency (GHz)"""

UMI_SIGHT = {10: 1.0, 50: 0.5195854136174696, 100: 0.23098474969813537, 200: 0.09351798732692025}
"""Line-of-sight probability of UMi by table 7.4.2-1, by distance (m)"""
UMA_SIGHT = {
    (50, 1.5): 0.6494021903337922,
    (100, 1.5): 0.3476708368442312,
    (200, 22.5): 0.4405822426070137,
    (1000, 22.5): 0.044514073908939064,
}
"""Line-of-sight probability of UMa by table 7.4.2-1, by distance and height of the user (m)"""

AERIAL = {
    (100, 50): (
        (80.41134699153399, 99.97240209177545, 0.9256523389171482),
        (78.31021823922546, 89.62579535926461, 0.9948046142533703),
    ),
    (300, 100): (
        (89.95708311669158, 108.3039660165989, 0.7711704591873534),
        (88.80688584305804, 100.65151526991508, 0.9838434834169268),
    ),
    (500, 50): (
        (94.70959440388778, 120.20849724647186, 0.37893616134362207),
        (93.40986820288646, 113.03520134920876, 0.8887485122408123),
    ),
    (3000, 23): (
        (111.91918937815828, 152.6471867733507, 0.006078700007907946),
        (110.51726964032919, 147.76570372362403, 0.23694703065948255),
    ),
}
"""TR 36.777, tables B-1 and B-2, at 2 GHz, by distance and height of the drone (m): path loss with
and without line of sight (dB) and line-of-sight probability, of UMi-AV and UMa-AV"""


BORESIGHTS = ((90, 0, 0, 0), (90, 90, 90, 0), (135, 0, 0, 45), (180, 0, 0, 90), (0, 0, 0, -90))
"""Zenith and azimuth of directions, bearing and downtilt of antennas, degrees, in the tests of ns-3

src/antenna/test/test-uniform-planar-array.cc, commit 2cfcebe: 8.0 dBi in all of them.
"""
GAINS = {
    (90, 32.5, 0, 0): 5.0,
    (60, 45, 0, 0): -0.3076923076923077,
    (140, 90, 0, 0): -22.0,
    (170, 90, 0, 90): 7.715976331360947,
    (135, 37, 0, 90): 1.905775874637413,
    (120, 200, 30, 90): -2.5241989964085803,
}
"""Antenna gain by table 7.3-1 and eq. 7.1-7 and 7.1-8, dBi, by the same angles"""


def point_antenna(zenith: float, azimuth: float, bearing: float, downtilt: float) -> float:
    """Return the gain of a turned antenna element in a direction, dBi; angles in degrees."""
    direction = (float(zenith), float(azimuth), float(bearing), float(downtilt))
    local = (antenna.local_zenith(*direction), antenna.local_azimuth(*direction))
    return float(antenna.element_gain(*local, antenna.PEAK))


def name_antenna(angles: tuple[float, float, float, float]) -> str:
    """Name a gain by its angles: zenith, azimuth, bearing and downtilt, degrees."""
    zenith, azimuth, bearing, downtilt = angles
    return f"antenna towards {zenith}/{azimuth}, turned by {bearing}/{downtilt} degrees"


def _printed_rows() -> list[Row]:
    """Compare with numbers of ns-3."""
    rows = [
        printed_row(f"ns-3: {name_antenna(angles)}", point_antenna(*angles), "8.0", "dBi")
        for angles in BORESIGHTS
    ]
    return rows + [
        printed_row(
            f"ns-3: {law} at {distance} m",
            LAWS[law](float(distance), BASES[law[:3]], 1.5, 5.0),
            loss,
            "dB",
        )
        for law, losses in NS3.items()
        for distance, loss in zip(DISTANCES, losses, strict=True)
    ]


def _formula_rows() -> list[Row]:
    """Compare with the tables of the standards."""
    rows = [
        formula_row(
            f"{law}, {d} m, user at {user} m, {f} GHz", LAWS[law](d, base, user, f), loss, "dB"
        )
        for (law, d, base, user, f), loss in LOSSES.items()
    ]
    rows += [
        formula_row(f"LoS probability of UMi, {d} m", tr38901.umi_los_probability(d), chance)
        for d, chance in UMI_SIGHT.items()
    ]
    rows += [
        formula_row(
            f"LoS probability of UMa, {d} m, user at {user} m",
            tr38901.uma_los_probability(d, user),
            chance,
        )
        for (d, user), chance in UMA_SIGHT.items()
    ]
    rows += [
        formula_row(name_antenna(angles), point_antenna(*angles), gain, "dBi")
        for angles, gain in GAINS.items()
    ]
    for (d, height), (micro, macro) in AERIAL.items():
        link, name = (d, height, 10.0, 2.0), f"{d} m, drone at {height} m"
        high = (d, height, 25.0, 2.0)
        rows += [
            formula_row(f"UMi-AV LoS, {name}", tr36777.umi_av_los(*link), micro[0], "dB"),
            formula_row(f"UMi-AV NLoS, {name}", tr36777.umi_av_nlos(*link), micro[1], "dB"),
            formula_row(f"UMi-AV P, {name}", tr36777.umi_av_los_probability(d, height), micro[2]),
            formula_row(f"UMa-AV LoS, {name}", tr36777.uma_av_los(*high), macro[0], "dB"),
            formula_row(f"UMa-AV NLoS, {name}", tr36777.uma_av_nlos(*high), macro[1], "dB"),
            formula_row(f"UMa-AV P, {name}", tr36777.uma_av_los_probability(d, height), macro[2]),
        ]
    return rows


def _compute(settings: Settings) -> TableOutcome:
    """Compute losses and probabilities, and draw the losses."""
    rows = _printed_rows() + _formula_rows()
    figure = blank_figure(9, 4)
    distances = np.geomspace(10.0, 5000.0, 200)
    for axes, place in zip(figure.subplots(1, 2, sharey=True), ("UMa", "UMi"), strict=True):
        for law, losses in NS3.items():
            if law.startswith(place):
                (line,) = axes.semilogx(
                    distances,
                    LAWS[law](distances, BASES[place], 1.5, 5.0),
                    label=f"{law}, bulletuav",
                )
                axes.plot(
                    DISTANCES, [float(x) for x in losses], "o", color=line.get_color(), label="ns-3"
                )
        axes.set(xlabel="horizontal distance (m)", ylabel="path loss (dB)", title=f"{place}, 5 GHz")
        axes.grid(alpha=0.3)
        axes.legend()
    settings.progress(1.0)
    return TableOutcome(
        rows,
        figure,
        [
            'Rows that begin with "formula" are tables 7.3-1, 7.4.1-1 and 7.4.2-1 of TR 38.901, '
            "and B-1 and B-2 of TR 36.777, evaluated with 30 digits; no printed values were found.",
            "Six of the eight losses of UMi in that file of ns-3 never enter its own test: they "
            "are right nevertheless.",
            "The effective environment height of UMa is 1 m: the standard draws it for users "
            "above 13 m.",
            "The bracket of the line-of-sight probability, (1 - d1 / d), multiplies the "
            "exponential. Several public codes have it in the exponent.",
        ],
    )


REPRODUCTION = Reproduction(
    title="Path loss, line of sight and antenna of 3GPP",
    publication="3GPP TR 38.901, Study on channel model for frequencies from 0.5 to 100 GHz, "
    "tables 7.3-1, 7.4.1-1 and 7.4.2-1; 3GPP TR 36.777, Enhanced LTE support for "
    "aerial vehicles, annex B",
    address="https://portal.3gpp.org/desktopmodules/Specifications/SpecificationDetails.aspx"
    "?specificationId=3173",
    about="Losses of UMa and UMi and antennas against test values of the simulator ns-3, and "
    "losses and line-of-sight probabilities on both sides of the breakpoint, for users on the "
    "ground and drones, against the standards' formulas, evaluated with 30 digits.",
    minutes=0.1,
    compute=_compute,
    is_scalable=False,
)
