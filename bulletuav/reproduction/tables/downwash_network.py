"""The wake of a quadrotor of 1.5 kg, next to that of networks trained on its flights."""

import numpy as np

from bulletuav.report.figures import blank_figure
from bulletuav.reproduction.downwash_networks import (
    NETWORK_FOLDER,
    predict_downwash,
    read_downwash_network,
)
from bulletuav.reproduction.table import Data, Reproduction, Row, Settings, TableOutcome
from bulletuav.reproduction.wake_pairs import predict_wake
from bulletuav.vehicle.airframe import STANDARD_GRAVITY
from bulletuav.vehicle.airframes import load_airframe
from bulletuav.vehicle.parameters import parameter_rows

FLOWN_NETWORK = "128-64-128_WBias_SN=4_epoch=20000_test_loss=1.0221.pkl"
"""Network of the controller (downwash_nn.py)"""
OTHER_NETWORKS = (
    "128-64-128_WBias_SN=0_epoch=20000_test_loss=0.5181.pkl",
    "128-64-128_WBias_SN=2_epoch=20000_test_loss=1.5888.pkl",
    "128-64-128_WBias_SN=8_epoch=20000_test_loss=0.4846.pkl",
)
"""Networks with other bounds of their slopes, trained on the same flights"""
QUADROTOR_MASS, QUADROTOR_ARM = 1.4844, 0.1372
"""Mass, kg, and arm, m, of the quadrotors (fhnp_params.py)"""
DROPS_BELOW = (0.5, 0.7, 0.9, 1.1, 1.3, 1.5)
"""Distances below of the pictures of the authors (nn_test.py), m"""
ASIDE = (0.0, 0.2, 0.4)
"""Horizontal distances of the rows, m"""
DIRECTIONS = 72
"""Number of directions over which forces are averaged"""


def _compute(settings: Settings) -> TableOutcome:
    """Compute the forces of law and networks, compare and draw them."""
    assert settings.data is not None  # the command checks it
    folder = settings.data / NETWORK_FOLDER
    count = settings.count(DIRECTIONS, least=4)
    distances = np.linspace(0.0, 1.0, 51)
    row = parameter_rows([load_airframe("cf2x")])[0].copy()
    # The only constant of the wake that depends on the size, see `vehicle.scaling`
    row.wake_radius = QUADROTOR_ARM
    weight = np.array(QUADROTOR_MASS * STANDARD_GRAVITY)
    ours = np.stack(
        [predict_wake(distances, np.array(drop), weight, row)[0] for drop in DROPS_BELOW]
    )
    theirs = []
    for k, name in enumerate((FLOWN_NETWORK, *OTHER_NETWORKS)):
        weights = read_downwash_network(folder / name)
        theirs.append([_average(weights, distances, drop, count) for drop in DROPS_BELOW])
        settings.progress(0.25 * (k + 1))
    networks = np.array(theirs)
    rows = []
    agreed = 0
    for i, drop in enumerate(DROPS_BELOW):
        for aside in ASIDE:
            at = int(np.argmin(np.abs(distances - aside)))
            low, high = networks[:, i, at].min(), networks[:, i, at].max()
            agreed += bool(low <= ours[i, at] <= high)
            rows.append(
                Row(
                    f"downward force {drop:g} m below, {aside:g} m aside (published: network)",
                    float(ours[i, at]),
                    float(networks[0, i, at]),
                    "N",
                    # No published force, and no known error of the network at these places
                    is_comparable=False,
                )
            )
    figure = blank_figure(12, 7)
    panels = figure.subplots(2, 3, sharex=True, sharey=True)
    for i, (axes, drop) in enumerate(zip(panels.ravel(), DROPS_BELOW, strict=True)):
        label = "networks: range of four"
        ends = networks[:, i].min(axis=0), networks[:, i].max(axis=0)
        axes.fill_between(distances, *ends, color="#dddddd", label=label)
        axes.plot(distances, networks[0, i], color="#aa3377", label="network of the controller")
        axes.plot(distances, ours[i], color="#4477aa", label="bulletuav, not fitted")
        axes.set_title(f"{drop:g} m below", fontsize=10)
        axes.grid(alpha=0.3)
    for axes in panels[1]:
        axes.set_xlabel("horizontal distance, m")
    for axes in panels[:, 0]:
        axes.set_ylabel("downward force, N")
    panels[0, 0].legend(fontsize=8)
    notes = (
        "No number is comparable. The repository has networks but no flights: the column of "
        "published numbers has forces that we compute with the weights of the network that the "
        "controller uses, at equal velocities, averaged over directions. Its error at these places "
        "is unknown, and four networks that were trained on the same flights differ by "
        f"{_spread(networks):.1f} N on the axis on average.",
        f"The law lies between the smallest and the largest force of the four networks in {agreed} "
        f"of {len(rows)} places.",
        "The law of the wake was fitted to Crazyflies of 33 g. Of its constants only the radius "
        f"changes, to the arm of {QUADROTOR_ARM} m; the thrust is the weight of {QUADROTOR_MASS} "
        "kg.",
        "The force of the network is wider: 0.7 m below it falls to half at "
        f"{_half_width(distances, networks[0, 1]):.2f} m from the axis, that of the law at "
        f"{_half_width(distances, ours[1]):.2f} m. Differences are largest there, and beyond 1.1 m "
        "below, where the networks of the repository contradict each other.",
    )
    return TableOutcome(rows, figure, notes)


def _spread(networks: np.ndarray) -> float:
    """Return the range of networks on the axis, averaged over distances below, N."""
    on_axis = networks[:, :, 0]
    return float(np.mean(on_axis.max(axis=0) - on_axis.min(axis=0)))


def _half_width(distances: np.ndarray, force: np.ndarray) -> float:
    """Return the distance from which the force is at most half of that on the axis, m."""
    return float(distances[np.argmax(force <= 0.5 * force[0])])


def _average(
    weights: list[np.ndarray], distances: np.ndarray, drop: float, count: int
) -> np.ndarray:
    """Return downward forces of a network at horizontal distances, averaged over directions."""
    angle = 2.0 * np.pi * np.arange(count) / count
    relative = np.zeros((len(distances), count, 6))
    relative[..., 0] = distances[:, None] * np.cos(angle)
    relative[..., 1] = distances[:, None] * np.sin(angle)
    relative[..., 2] = drop
    force = predict_downwash(weights, relative.reshape(-1, 6)).reshape(len(distances), count, 3)
    return np.asarray(-force[..., 2].mean(axis=1))


REPRODUCTION = Reproduction(
    title="Downwash of a quadrotor of 1.5 kg: law of the Crazyflie's wake and networks",
    publication=(
        "J. Li, L. Han, H. Yu, Y. Lin, Q. Li and Z. Ren, Nonlinear MPC for Quadrotors in "
        "Close-Proximity Flight with Neural Network Downwash Prediction, 2023"
    ),
    address="https://arxiv.org/abs/2304.07794",
    about=(
        "Downward force on a quadrotor below another: the law of the wake that was fitted to "
        "Crazyflies, scaled by thrust and arm, next to networks that were trained on flights of "
        "quadrotors 45 times as heavy."
    ),
    minutes=0.1,
    compute=_compute,
    data=Data(
        repository="https://github.com/Li-Jinjie/ndp_nmpc_qd",
        commit="6c59b0270cb729e93dd9ca8cc5f503c9c3d110d3",
        licence="GPL-3.0",
        contains=f"{NETWORK_FOLDER}/{FLOWN_NETWORK}",
    ),
)
