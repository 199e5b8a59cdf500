"""Erlang's tables of blocking and waiting probabilities."""

import numpy as np
from scipy.optimize import brentq

from bulletuav.network.queueing import (
    erlang_b,
    erlang_c,
    mean_queue_length,
    mean_response,
    mean_wait,
    response_exceeds,
    wait_exceeds,
)
from bulletuav.report.figures import blank_figure
from bulletuav.reproduction.formulas import formula_row, printed_row
from bulletuav.reproduction.table import Reproduction, Row, Settings, TableOutcome

# "ERLANG-B CAPACITY TABLE", Lucent Technologies: http://garywagoner.tripod.com/traffic/ERLANG.HTML
CAPACITIES = {
    1: "0.020", 3: "0.602", 5: "1.657", 7: "2.935", 9: "4.345", 11: "5.842", 13: "7.402",
    15: "9.010", 17: "10.656", 19: "12.333", 21: "14.036", 23: "15.761", 25: "17.505",
    27: "19.265", 29: "21.039", 31: "22.827", 33: "24.628", 35: "26.435", 37: "28.254",
    39: "30.081", 41: "31.915", 43: "33.758", 45: "35.507", 47: "37.462", 49: "39.323",
    51: "41.189", 53: "43.060", 55: "44.938", 57: "46.816", 59: "48.700", 61: "50.389",
    63: "52.461", 65: "54.376", 67: "56.275", 69: "58.117", 71: "60.082", 73: "61.990",
    75: "63.900", 77: "65.814", 79: "67.729", 81: "69.647", 83: "71.568", 85: "73.490",
    87: "75.415", 89: "77.342",
}  # fmt: skip
"""Load that a number of channels carries if 2 % of the calls are blocked, Erlang, as printed"""

QUEUES = {
    (1, 0.5, 1.0): (0.3333333333333333, 0.5, 1.0),
    (2, 1.5, 1.0): (0.3103448275862069, 0.6428571428571429, 1.2857142857142858),
    (4, 3.0, 1.0): (0.20610687022900764, 0.5094339622641509, 0.5094339622641509),
    (4, 3.9, 1.0): (0.3009392901450048, 0.9451141642052627, 9.451141642052628),
    (4, 15.0, 4.0): (0.2860024066572886, 0.8650297313922494, 0.8650297313922494),
    (64, 60.0, 1.0): (0.06036273820423571, 0.5068662709757633, 0.12671656774394083),
    (500, 450.0, 1.0): (0.001234453135373451, 0.012208889634931087, 0.00024417779269862174),
}
"""Erlang B, Erlang C and mean wait (s) by servers, arrival rate and service rate (1/s)"""

LATE = {
    (4, 3.0, 1.0, 0.5): 0.7610243183186816,
    (4, 3.0, 1.0, 2.0): 0.2732240623833502,
    (4, 5.0, 4.0, 1.0): 0.01875709624552829,
    (4, 15.0, 4.0, 0.25): 0.841825011847532,
}
"""Probability that the response exceeds a time (s), by queue and time"""


def find_capacity(servers: int, blocking: float) -> float:
    """Find the load that is blocked with a probability, Erlang.

    Args:
        servers: Number of servers.
        blocking: Blocking probability, in (0, 1).
    """

    def excess(load: float) -> float:
        return float(erlang_b(servers, load)) - blocking

    # With twice as many Erlangs as servers, more than a third is blocked
    return float(brentq(excess, 0.0, 2.0 * servers, xtol=1e-12))


def _printed_rows() -> list[Row]:
    """Compare with printed numbers."""
    rows = []
    for servers, printed in CAPACITIES.items():
        ours = find_capacity(servers, 0.02)
        rows.append(
            printed_row(f"load at 2 % blocking, {servers} channels", ours, printed, "Erlang")
        )
    rows += [
        # https://erlang.com/calculatormanual/howmuchtrafficcanatrunkgrouphandle.htm
        printed_row("load at 1 % blocking, 15 lines", find_capacity(15, 0.01), "8.108", "Erlang"),
        # https://rdocumentation.org/packages/ErlangC/versions/0.1.0: 100 calls in 30 min of 180 s
        printed_row("probability of waiting, 14 agents", erlang_c(14, 10.0), "0.1741319"),
        printed_row("probability of waiting, 11 agents", erlang_c(11, 10.0), "0.6821182"),
        printed_row(
            "answered within 20 s, 14 agents",
            1 - wait_exceeds(14, 10 / 180, 1 / 180, 20.0),
            "0.88835",
        ),
        printed_row(
            "mean wait, 14 agents", mean_wait(14, 10 / 180, 1 / 180), "7.83593701177724", "s"
        ),
        # inst/qsmmm.m of https://github.com/mmarzolla/queueing, f36e01c: 9 tasks/s, servers of 5/s
        printed_row("waiting tasks, 2 servers", mean_queue_length(2, 9.0, 5.0), "7.674"),
        printed_row("mean response, 2 servers", mean_response(2, 9.0, 5.0), "1.053", "s"),
        printed_row("waiting tasks, 4 servers", mean_queue_length(4, 9.0, 5.0), "0.105"),
        printed_row("mean response, 4 servers", mean_response(4, 9.0, 5.0), "0.212", "s"),
    ]
    return rows


def _formula_rows() -> list[Row]:
    """Compare with the formulas."""
    rows = []
    for (servers, arrivals, service), (blocked, waiting, wait) in QUEUES.items():
        load = arrivals / service
        name = f"{servers} servers, {load:g} Erlang"
        rows += [
            formula_row(f"Erlang B, {name}", erlang_b(servers, load), blocked),
            formula_row(f"Erlang C, {name}", erlang_c(servers, load), waiting),
            formula_row(f"mean wait, {name}", mean_wait(servers, arrivals, service), wait, "s"),
        ]
    for (servers, arrivals, service, time), late in LATE.items():
        name = f"response over {time:g} s, {servers} servers, {arrivals / service:g} Erlang"
        rows.append(formula_row(name, response_exceeds(servers, arrivals, service, time), late))
    return rows


def _compute(settings: Settings) -> TableOutcome:
    """Compute the probabilities, and draw them."""
    rows = _printed_rows() + _formula_rows()
    figure = blank_figure(9, 4)
    left, right = figure.subplots(1, 2)
    for servers in sorted({servers for servers, _, _ in QUEUES}):
        loads = np.linspace(0.0, servers, 201)
        left.plot(
            loads / servers,
            erlang_c(servers, loads),
            label=f"{servers} server{'s' * (servers > 1)}",
        )
    for (servers, arrivals, service), (_, waiting, _) in QUEUES.items():
        left.plot(arrivals / service / servers, waiting, "k.")
    left.set(xlabel="utilisation", ylabel="probability of waiting for one of c servers")
    left.plot([], [], "k.", label="formula, 30 digits")
    left.legend()
    differences = [row.ours - row.published for row in rows[: len(CAPACITIES)] if row.published]
    right.stem(list(CAPACITIES), differences, basefmt="k-")
    right.set(xlabel="channels", ylabel="bulletuav minus printed table (Erlang)")
    right.set_title("load at 2 % blocking: one digit differs in seven rows", fontsize=10)
    settings.progress(1.0)
    return TableOutcome(
        rows,
        figure,
        [
            'Rows that begin with "formula" have no printed number: there, Erlang\'s formulas are '
            "evaluated with 30 digits.",
            "The printed table of capacities is Lucent Technologies', in the copy at "
            "garywagoner.tripod.com. Seven numbers differ from the formula, each in one digit; "
            "whether in the table or in the copy is unknown.",
            "The worked examples are those of the manual of erlang.com, the R package ErlangC and "
            "the Octave package queueing.",
        ],
    )


REPRODUCTION = Reproduction(
    title="Probabilities that tasks are blocked or wait",
    publication="A. K. Erlang, Solution of some problems in the theory of probabilities of "
    "significance in automatic telephone exchanges, 1917",
    address="https://en.wikipedia.org/wiki/Erlang_(unit)",
    about="Erlang's loss and delay formulas against a printed table of capacities, worked examples "
    "of others, and the formulas evaluated with 30 digits.",
    minutes=0.1,
    compute=_compute,
    is_scalable=False,
)
