"""Map of a city."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection

from bulletuav.city.heightfield import Heightfield
from bulletuav.city.model import GROUND, City

GROUND_COLOUR = "#f2efe9"
STREET_COLOUR = "#d98e04"
CONTOUR_COLOUR = "#9a7b55"
FINENESS = 20.0
"""Line width of a street, points, if its segments are as long as the city"""
BELOW = -0.09
"""Position of scale and legend below the map, in heights of the map"""


def draw_map(city: City, axes: Axes) -> None:
    """Draw a plan view of a city, in m: streets, and footprints coloured by building height.

    Terrain has no streets; contour lines are the heights of its ground.

    Args:
        city: The city.
        axes: Target axes; limits, labels and title are set.
    """
    # Footprints coloured by height, streets as lines
    prints = PolyCollection(city.footprints, cmap="viridis_r", edgecolors="face", linewidths=0.4)
    owner = city.building[city.building != GROUND]
    prints.set(array=city.heights[owner], clim=(0, city.heights.max(initial=1.0)))
    if city.ground is not None:
        _draw_contours(city.ground, axes)
    lines = city.streets.nodes[city.streets.edges]
    # The line width follows the mesh size of the street network.
    mesh = np.median(np.linalg.norm(np.diff(lines, axis=1), axis=-1)) if len(lines) else 0.0
    width = np.clip(FINENESS * mesh / city.side, 0.15, 0.8)
    streets = LineCollection(
        list(lines), colors=STREET_COLOUR, linewidths=width, label="centre lines of streets"
    )
    for collection in (streets, prints):
        axes.add_collection(collection)
    axes.figure.colorbar(prints, ax=axes, label="height (m)", shrink=0.85)
    # Next to the scale, below the map
    if not city.is_terrain:
        axes.legend(
            handles=[streets],
            loc="center right",
            bbox_to_anchor=(1, BELOW),
            frameon=False,
            borderaxespad=0,
        )
    _draw_scale(city.side, axes)
    half = city.sides / 2
    axes.set(
        xlim=(-half[0], half[0]),
        ylim=(-half[1], half[1]),
        aspect="equal",
        facecolor=GROUND_COLOUR,
    )
    axes.set(xlabel="x east (m)", ylabel="y north (m)")
    axes.set_title(
        f"{city.name}: {len(city.heights)} {'trees' if city.is_terrain else 'buildings'} on "
        f"{city.sides[0]:.4g} m x {city.sides[1]:.4g} m"
    )


def _draw_contours(ground: Heightfield, axes: Axes) -> None:
    """Draw contour lines of the ground, with their heights, m."""
    x, y = (
        np.linspace(-side / 2, side / 2, count)
        for side, count in zip(ground.sides, ground.corners.shape, strict=True)
    )
    lines = axes.contour(x, y, ground.corners.T, colors=CONTOUR_COLOUR, linewidths=0.8)
    axes.clabel(lines, fontsize=7)


def _draw_scale(side: float, axes: Axes) -> None:
    """Draw a scale bar of the longest round length that is at most a fifth of the side."""
    # 1, 2 or 5 times a power of ten, in m
    power = 10 ** np.floor(np.log10(side / 5))
    length = power * max(digit for digit in (1, 2, 5) if digit * power <= side / 5)
    ends = np.array([0, length]) - side / 2
    # Below the map: data coordinates along x, axes fraction along y
    below = axes.get_xaxis_transform()
    axes.plot(
        ends,
        [BELOW, BELOW],
        color="black",
        lw=4,
        solid_capstyle="butt",
        transform=below,
        clip_on=False,
    )
    axes.text(
        ends[1] + side / 80,
        BELOW,
        f"{length:g} m",
        va="center",
        transform=below,
    )
