"""Erlang's tables of blocking and waiting probabilities."""

import numpy as np

from bulletuav.network.queueing import erlang_c
from bulletuav.report.figures import blank_figure
from bulletuav.reproduction.table import Outcome, Reproduction, Row, Settings

DELAYS = {(1, 0.5): 1 / 2, (2, 1.5): 9 / 14, (4, 3.0): 27 / 53}
"""Probability that a task waits, by servers and offered load: exact fractions"""


def _compute(settings: Settings) -> Outcome:
    """Compute the probabilities, and draw them."""
    rows = [
        Row(
            f"{servers} servers, {load:g} Erlang",
            float(erlang_c(servers, load)),
            published,
            tolerance=1e-9,
        )
        for (servers, load), published in DELAYS.items()
    ]
    figure = blank_figure(6, 4)
    axes = figure.subplots()
    for servers in (1, 2, 4):
        loads = np.linspace(0.0, servers, 101)
        axes.plot(loads / servers, erlang_c(servers, loads), label=f"{servers} servers")
    axes.set(xlabel="utilisation", ylabel="probability of waiting")
    axes.legend()
    settings.progress(1.0)
    return Outcome(rows, figure)


REPRODUCTION = Reproduction(
    title="Probability that a task waits",
    publication="A. K. Erlang, Solution of some problems in the theory of probabilities, 1917",
    address="https://en.wikipedia.org/wiki/Erlang_(unit)",
    about="Erlang's delay formula against exact fractions.",
    minutes=0.1,
    compute=_compute,
    is_scalable=False,
)
