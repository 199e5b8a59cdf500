"""Propulsion power of rotary-wing drones by Zeng, Xu and Zhang."""

import numpy as np
from scipy.optimize import minimize_scalar

from bulletuav.report.figures import blank_figure
from bulletuav.reproduction.formulas import formula_row, printed_row
from bulletuav.reproduction.table import Reproduction, Row, Settings, TableOutcome
from bulletuav.vehicle.power import W20, W100, RotaryWing, level_power, rotary_wing

POWERS = {
    0: (168.484217741082, 1371.321522813272),
    5: (143.59535050052614, 1284.0358901374277),
    10: (126.02306350079347, 1107.0176265903347),
    15: (138.55547393845808, 984.6626286152607),
    20: (178.33838973481926, 937.994940509087),
    25: (249.0427997200721, 947.8399996687804),
    30: (356.4450294611035, 1004.9457424482167),
    49: (1215.193638724316, 1655.08029300917),
}
"""Power of the drones of 20 N and 100 N by speed (m/s), W: their eq. 12, with their constants"""

INDUCED_AT_500 = 0.7140828483351046
"""Induced power of the drone of 20 N at 500 m/s, W, where eq. 12 as written cancels"""

BEST = (10.210043289226139, 125.99730096493388, 18.290954453360488, 8.830393082815702)
"""Speed (m/s) and power (W) of longest endurance, speed and energy (J/m) of longest range, 20 N"""


def total_power(speed: float, wing: RotaryWing) -> float:
    """Return the power of level flight, W.

    Args:
        speed: Speed, m/s.
        wing: Constants of the drone.
    """
    return sum(level_power(float(speed), wing))


def _constant_rows() -> list[Row]:
    """Compare the constants that follow from the drones' dimensions with printed ones."""
    # docs/source/digital_twins/aerodynamics.rst of https://github.com/yemenlinux/vUrbanMARL,
    # 451cc28; of 100 N: https://github.com/bharathkeshavamurthy/MAESTRO-X (arXiv:2209.07655)
    rows = [
        printed_row("20 N: blade power in hover P0", W20.blade, "79.86", "W"),
        printed_row("20 N: induced power in hover Pi", W20.induced, "88.63", "W"),
        printed_row("20 N: tip speed", W20.tip_speed, "120.0", "m/s"),
        printed_row("20 N: induced velocity v0", W20.induced_velocity, "4.03", "m/s"),
        printed_row("20 N: drag ratio d0", W20.drag_ratio, "0.60"),
        printed_row("100 N: blade power in hover P0", W100.blade, "580.65", "W"),
        printed_row("100 N: induced power in hover Pi", W100.induced, "790.6715", "W"),
        printed_row("100 N: tip speed", W100.tip_speed, "200.0", "m/s"),
        printed_row("100 N: induced velocity v0", W100.induced_velocity, "7.2", "m/s"),
        printed_row("100 N: parasite power at 1 m/s", level_power(1.0, W100)[2], "0.0073", "W"),
    ]
    # Sensors 23(15):6795 (2023), table 2
    rows += [
        printed_row("Sensors 2023, table 2: P0", W20.blade, "80", "W"),
        printed_row(
            "Sensors 2023, table 2: Pi",
            W20.induced,
            "88.5",
            "W",
            why="the weight, disc area, density and excess of the same table give 88.63 W",
        ),
    ]
    # UAVEnergy.py of https://github.com/Jae0822/TaDeLL-UAV-Device-Python, 3841789
    slow = rotary_wing(20.0, 0.4, 0.503, rotor_speed=200.0, parasite_area=0.0151)
    rows.append(
        Row(
            "20 N: tip speed with 200 rad/s, as in public code",
            slow.tip_speed,
            120.0,
            "m/s",
            tolerance=0.5,
            why="the code states 200 rad/s and 0.4 m next to 120 m/s; 300 rad/s gives 120 m/s, and "
            f"with 200 rad/s the blade power is {slow.blade:.2f} W instead of {W20.blade:.2f} W",
        )
    )
    return rows


def _power_rows() -> list[Row]:
    """Compare powers with the formula, and with printed ones."""
    rows = []
    for speed, (light, heavy) in POWERS.items():
        rows += [
            formula_row(f"20 N: power at {speed} m/s", total_power(speed, W20), light, "W"),
            formula_row(f"100 N: power at {speed} m/s", total_power(speed, W100), heavy, "W"),
        ]
    rows.append(
        formula_row(
            "20 N: induced power at 500 m/s", level_power(500.0, W20)[1], INDUCED_AT_500, "W"
        )
    )
    endurance = minimize_scalar(total_power, bounds=(1, 60), args=(W20,), method="bounded")
    farthest = minimize_scalar(
        lambda speed: total_power(speed, W20) / speed, bounds=(1, 60), method="bounded"
    )
    # A minimum is flat: rounding moves its speed by about 1e-8 of it at least
    rows += [
        Row(
            "formula: 20 N: speed of longest endurance", endurance.x, BEST[0], "m/s", tolerance=1e-3
        ),
        formula_row("20 N: power at that speed", endurance.fun, BEST[1], "W"),
        Row("formula: 20 N: longest range", farthest.x, BEST[2], "m/s", tolerance=1e-3),
        formula_row("20 N: energy at that speed", farthest.fun, BEST[3], "J/m"),
    ]
    rows += [
        printed_row("UrbanMARL's documentation: hover", total_power(0, W20), "168.5", "W"),
        printed_row(
            "UrbanMARL's documentation: 10 m/s",
            total_power(10, W20),
            "155.2",
            "W",
            why="its own formula and constants give 126.03 W",
        ),
        printed_row(
            "UrbanMARL's documentation: 25 m/s",
            total_power(25, W20),
            "310.8",
            "W",
            why="its own formula and constants give 248.96 W",
        ),
    ]
    return rows


def _compute(settings: Settings) -> TableOutcome:
    """Compute constants and powers, and draw the powers."""
    rows = _constant_rows() + _power_rows()
    figure = blank_figure(9, 4)
    speeds = np.linspace(0.0, 30.0, 121)
    for axes, wing, place, name in zip(
        figure.subplots(1, 2), (W20, W100), (0, 1), ("20 N", "100 N"), strict=True
    ):
        parts = np.array([level_power(float(speed), wing) for speed in speeds])
        for part, label in zip(parts.T, ("blade", "induced", "parasite"), strict=True):
            axes.plot(speeds, part, lw=1, label=label)
        axes.plot(speeds, parts.sum(axis=1), "k", label="total")
        drawn = [speed for speed in POWERS if speed <= speeds[-1]]
        axes.plot(drawn, [POWERS[speed][place] for speed in drawn], "ro", label="eq. 12, 30 digits")
        axes.set(xlabel="speed (m/s)", ylabel="power (W)", title=f"drone of {name}")
    figure.axes[0].legend(loc="upper center")
    settings.progress(1.0)
    return TableOutcome(
        rows,
        figure,
        [
            "The article itself is not quoted: printed constants are those of works that use it; "
            'rows that begin with "formula" are its eq. 12, evaluated with 30 digits.',
            "Constants of the drones of 20 N and 100 N must not be mixed. Public code does, with "
            "the powers of 100 N and the induced velocity of a drone of 1.3 kg.",
            "The formula is for level flight. It says nothing of climb and descent.",
        ],
    )


REPRODUCTION = Reproduction(
    title="Propulsion power of rotary-wing drones",
    publication="Y. Zeng, J. Xu, R. Zhang, Energy Minimization for Wireless Communication with "
    "Rotary-Wing UAV, IEEE Transactions on Wireless Communications 18(4), 2019",
    address="https://arxiv.org/abs/1804.02238",
    about="Constants from the dimensions of two drones against printed ones, and the power of "
    "level flight from hover to 49 m/s against the formula, evaluated with 30 digits.",
    minutes=0.1,
    compute=_compute,
    is_scalable=False,
)
