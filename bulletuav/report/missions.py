"""Figure of a flown mission."""

from pathlib import Path

import numpy as np

from bulletuav.report.figures import blank_figure, save_figure


def plot_mission(
    time: np.ndarray, position: np.ndarray, waypoints: np.ndarray, title: str, path: Path
) -> None:
    """Plot the track of a mission from above, and its height over time, as a PNG file.

    Args:
        time: (n,) s.
        position: (n, 3) position of the drone, m.
        waypoints: (M, 3) positions of the items, m.
        title: Title of the figure.
        path: The file.
    """
    figure = blank_figure(11, 5)
    above, height = figure.subplots(1, 2)
    above.plot(position[:, 0], position[:, 1], color="#4477aa")
    above.plot(waypoints[:, 0], waypoints[:, 1], "o", color="#ee6677", fillstyle="none")
    above.set(xlabel="east of home, m", ylabel="north of home, m", title="from above")
    above.set_aspect("equal", adjustable="datalim")
    height.plot(time, position[:, 2], color="#4477aa")
    height.set(xlabel="time, s", ylabel="height above ground, m", title="height")
    figure.suptitle(title)
    save_figure(figure, path)
