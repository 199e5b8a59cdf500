"""UrbanMARL, drones over cities that serve users, decision by decision.

Published numbers are what the code of version 0.3.1 gives for states made by hand; "documented"
ones follow from its documentation. Places in docstrings are files of its repository.
"""

import math

import numpy as np

from bulletuav.network.antenna import PEAK, gain_towards
from bulletuav.report.figures import blank_figure
from bulletuav.reproduction.hand_made import compare_number
from bulletuav.reproduction.table import Reproduction, Row, Settings, TableOutcome
from bulletuav.reproduction.urban_states import HOVER, USERS, WALL, fly_over, steer_to
from bulletuav.reproduction.urbanmarl_models import compare_models, their_gain
from bulletuav.reproduction.urbanmarl_offloading import compare_offloading
from bulletuav.sensors import Label
from bulletuav.tasks import Frame, block

ABOVE = (0.0, 0.0, 100.0)
"""Place above the origin, m"""
DIAGONAL = math.dist((0, 0, 0), (500, 500, 200))
"""Distance by which distances to goals are divided, m"""
LIDAR_STEP = 4.0
"""Distance between the points that a beam of theirs looks at, m"""


@block([Label("fraction of users in sight", "1", 0.0, 1.0)])
def users_in_sight(frame: Frame) -> np.ndarray:
    """Return the fraction of users that each drone sees, (W, N, 1)."""
    fraction: np.ndarray = frame.readings["sight"].mean(axis=-1, keepdims=True)
    return fraction


def _transitions() -> list[Row]:
    """Compare the motion of `process_actions` in scenarios/uav_navigation.py."""
    east = steer_to(12.0, 0.0, 0.0)
    moved = fly_over("los", [WALL], [ABOVE], USERS, actions=steer_to(12.0, 30.0, 5.0)).position[0]
    wall = fly_over("los", [WALL], [(245, 0, 100)], USERS, actions=east).position[0]
    up = steer_to(0.0, 0.0, 12.0)
    roof = fly_over("los", [WALL], [(0, 0, 195)], USERS, actions=up).position[0]
    low = fly_over("los", [WALL], [(0, 0, 3)], USERS, actions=steer_to(0.0, 0.0, -12.0))
    short = fly_over("los", [WALL], [ABOVE], USERS, actions=east, decision_hz=10).position[0]
    step = "theirs adds the velocity without the time step, and reports a speed of 120 m/s"
    ground = "theirs stops at the ground and flies on; here it is a contact"
    return [
        # 12 m/s towards 30 degrees, and 5 m/s up, for 1 s
        compare_number("position east", moved[0], 12 * math.cos(math.pi / 6), "m"),
        compare_number("position north", moved[1], 6.0, "m"),
        compare_number("position up", moved[2], 105.0, "m"),
        compare_number("position at the edge", wall[0], 250.0, "m"),
        compare_number("position at the ceiling", roof[2], 200.0, "m"),
        compare_number("collision with the ground", low.term("collision")[0], 0.0, why=ground),
        compare_number("position east with decisions of 0.1 s", short[0], 12.0, "m", step),
    ]


def _sight() -> list[Row]:
    """Compare `check_los_batch` in models/urban_map.py: 20 points along each link."""
    rows = []
    # The ray of the first user leaves the building, 40 to 60 m away, at a height of 40.9 m; the
    # last of their points within it is at 42.97 m
    missed = "theirs looks at 20 points; the last one over the roof is 2.1 m before its edge"
    for height, theirs, why in ((40.0, 1.0, ""), (42.0, 1.0, missed), (45.0, 0.0, "")):
        building = ((40, -5, 0), (60, 5, height))
        seen = fly_over("los", [building], [ABOVE], USERS, actions=HOVER).aviary.sight[0, 0, 0]
        rows.append(compare_number(f"sight over a roof of {height:g} m", seen, theirs, "", why))
    return rows


def _observations() -> list[Row]:
    """Compare `observation` in scenarios/uav_navigation.py and scenarios/uav_mobile_ue.py."""
    names = ("position", "battery", users_in_sight, "dwell_time")
    state = ([WALL], [(10, -20, 100)], USERS)
    ten = fly_over("mobile_users", *state, decisions=10, observation=names)
    flown = fly_over("los", *state, actions=steer_to(12.0, 0.0, 5.0)).after[0]
    first, last = np.asarray(ten.steps[0].observations)[0, 0], ten.after[0]
    free = "theirs takes 0.1 % for a m/s and 0.2 % for a m/s of climb, and hovers for nothing"
    return [
        compare_number("observation: position east", last[0], 10.0, "m"),
        compare_number("observation: position north", last[1], -20.0, "m"),
        compare_number("observation: position up", last[2], 100.0, "m"),
        compare_number("observation: battery at the start", 100 * ten.before[0, 3], 100.0, "%"),
        compare_number("observation: battery after 10 s of hover", 100 * last[3], 100.0, "%", free),
        compare_number("observation: battery after 1 s of 12 m/s", 100 * flown[3], 97.8, "%", free),
        compare_number("observation: fraction of users in sight", last[4], 0.6),
        compare_number("observation: sojourn after 1 step", first[5], 0.6),
        compare_number("observation: sojourn after 10 steps", last[5], 6.0),
    ]


def _user_rewards() -> list[Row]:
    """Compare `reward` in scenarios/uav_ue_los.py, uav_mobile_ue.py and coverage.py."""
    los = fly_over("los", [WALL], [ABOVE], USERS).rewards[0]
    hit = fly_over("los", [WALL], [(-95, 0, 50)], USERS, actions=steer_to(12.0, 180.0, 0.0))
    mobile = fly_over("mobile_users", [WALL], [ABOVE], USERS, decisions=10)
    near = fly_over("coverage", [WALL], [ABOVE, (50, 0, 100), (0, 50, 100)]).term("close")
    summed = "a sum depends on the number of users; the code has the mean, as here"
    once = "theirs charges the first of two near drones alone; the documentation has both"
    return [
        compare_number("uav_ue_los, 3 of 5 users", los, 0.6),
        compare_number("uav_ue_los, documented: the sum", los, 3.0, why=summed),
        compare_number("uav_ue_los: collision", hit.term("collision")[0], -1.0),
        compare_number(
            "uav_mobile_ue, step 1", mobile.steps[0].rewards[0, 0], 0.6 + 0.5 * math.tanh(0.06)
        ),
        compare_number("uav_mobile_ue, step 10", mobile.rewards[0], 0.6 + 0.5 * math.tanh(0.6)),
        compare_number("coverage: two near drones, first drone", near[0], -10.0),
        compare_number("coverage: two near drones, second drone", near[1], -5.0, why=once),
        compare_number("coverage: two near drones, third drone", near[2], 0.0, why=once),
        compare_number("coverage: two near drones, third drone, documented", near[2], -10.0),
    ]


def _goal_rewards() -> list[Row]:
    """Compare rewards of scenarios/uav_lidar_navigation.py, and documented ones of navigation."""
    facade, far = ((6, -5, 0), (26, 5, 60)), ((20, -5, 0), (40, 5, 60))
    place = (0, 0, 30)
    names = ("goal_offset", "lidar")
    close = fly_over("lidar_navigation", [facade], [place], goals=[(0, -100, 30)])
    ranged = {"goals": [(0, -100, 30)], "observation": names, "normalise": False}
    seen = [
        fly_over("lidar_navigation", [box], [place], **ranged).after[0] for box in (facade, far)
    ]
    there = fly_over("lidar_navigation", [], [place], goals=[(0, -3, 30)]).rewards[0]
    paid = {
        "goals": [(100, 0, 30)],
        "actions": steer_to(10.0, 0.0, 0.0),
        "weights": {"progress": 1.0},
    }
    ahead = fly_over("navigation", [], [place], **paid).rewards[0]
    coarse = "theirs looks every 4 m and reports the middle: 17 to 20 m all read 18 m"
    sign = "theirs would charge coming nearer; its code has no target, and pays sight of users"
    return [
        # -d / 734.8 m, minus 0.25 - 0.1
        compare_number(
            "uav_lidar_navigation, 6 m from a facade", close.rewards[0], -100 / DIAGONAL - 0.15
        ),
        compare_number("uav_lidar_navigation, goal reached, documented", there, 5 - 3 / DIAGONAL),
        compare_number("observation: goal north / 250 m", seen[0][1] / 250, -0.4),
        compare_number("observation: beam of 6 m / 60 m", seen[0][3] / 60, 0.1),
        compare_number("observation: beam of 20 m / 60 m", seen[1][3] / 60, 0.3, why=coarse),
        compare_number("observation: beam without a hit / 60 m", seen[0][5] / 60, 1.0),
        compare_number("uav_navigation, 10 m nearer, documented", ahead, -10.0, why=sign),
    ]


def _ends() -> list[Row]:
    """Compare `done` in scenarios/uav_navigation.py."""
    drones = [(-95, 0, 50), ABOVE, (50, 0, 100)]
    hit = fly_over("los", [WALL], drones, USERS, actions=[steer_to(12.0, 180.0, 0.0), HOVER, HOVER])
    empty = fly_over("los", [WALL], drones, USERS, given={"charge": [1e-9, 1.0, 1.0]})
    late = fly_over("los", [WALL], drones, USERS, decisions=3, horizon=3).steps
    lasted = 1 + next(k for k, step in enumerate(late) if step.truncated.all())
    alone = "theirs ends the episodes of all; here the drone's own"
    return [
        compare_number(
            "drones that a collision of one of three ends", hit.steps[0].terminated.sum(), 3.0
        ),
        compare_number(
            "drones that an empty battery of one of three ends",
            empty.steps[0].terminated.sum(),
            3.0,
            why=alone,
        ),
        compare_number("decisions of an episode with max_steps 3", lasted, 3.0),
    ]


def _compute(settings: Settings) -> TableOutcome:
    """Compute all rows, and draw ranges and antenna gains."""
    parts = (
        _transitions,
        _sight,
        _observations,
        _user_rewards,
        _goal_rewards,
        _ends,
        compare_offloading,
        compare_models,
    )
    rows = []
    for k, part in enumerate(parts, start=1):
        rows += part()
        settings.progress(k / (len(parts) + 1))
    figure = blank_figure(9, 4)
    left, right = figure.subplots(1, 2)
    # Drones side by side at different distances from one long facade
    distances = np.linspace(2.0, 58.0, 24)
    drones = np.column_stack([60 - distances, np.linspace(-230, 230, 24), np.full(24, 30.0)])
    ours = fly_over(
        "lidar_navigation",
        [((60, -250, 0), (100, 250, 60))],
        drones,
        goals=np.tile((-200.0, 0.0, 30.0), (24, 1)),
        observation=("lidar",),
        normalise=False,
    ).after[:, 0]
    theirs = (np.ceil(distances / LIDAR_STEP) - 0.5) * LIDAR_STEP
    left.plot(distances, theirs - distances, "s", ms=4, label="UrbanMARL")
    left.plot(distances, ours - distances, "k.", label="bulletuav")
    left.set(xlabel="distance to a facade (m)", ylabel="range of the beam minus distance (m)")
    left.legend()
    easts = np.linspace(-100.0, 100.0, 401)
    for label, gains in (
        ("UrbanMARL", [their_gain(east, 0.0, -50.0) for east in easts]),
        ("bulletuav (TR 38.901)", [gain_towards(east, 0.0, -50.0, PEAK) for east in easts]),
    ):
        right.plot(easts, gains, label=label)
    right.set(xlabel="user east of a drone 50 m above (m)", ylabel="antenna gain (dBi)")
    right.legend()
    settings.progress(1.0)
    return TableOutcome(rows, figure, NOTES)


NOTES = (
    "Published numbers follow by hand from the code of UrbanMARL 0.3.1; the wheel on PyPI was run "
    "outside of this repository, and gives them.",
    "Defects that are not copied, beyond the explained rows: `seed` is accepted, but the city is "
    "that of seed 0 in all, and resets continue torch's global random numbers.",
    "uav_navigation has no target; default, uav_ue_los and it are one scenario.",
    "uav_lidar_navigation draws a new target before it computes the reward of the reached one, so "
    "that reaching a goal costs the distance to the next.",
    "Speeds may be negative, so that each velocity has two actions; up to 49 m/s, here 20 m/s.",
    "uavmec_offloading gives every user one task in every step, whatever the arrival rate, and "
    "lets all users send at the same time in one band. Here its reward is a term of its own, which "
    "counts users whose task of mean size meets the deadline.",
    "uavmec_advanced_physics has cores that need 0.5 s for a task of 0.2 s, so that none "
    "completes.",
    "The manhattan users turn anywhere, the random waypoint has no waypoints, and headings near "
    "180 degrees are averaged as numbers, to their opposite.",
)
"""Protocol, and defects"""

REPRODUCTION = Reproduction(
    title="UrbanMARL: transitions, observations, rewards, ends and models",
    publication="B. Raddwan, UrbanMARL 0.3.1, 2026",
    address="https://github.com/yemenlinux/vUrbanMARL",
    about="States made by hand are flown for decisions with the preset `urbanmarl`, and every "
    "number is compared with the one that the code gives: motion, line of sight, observations, "
    "rewards and ends, then the models of radio, servers, power, users and cities.",
    minutes=0.2,
    compute=_compute,
    is_scalable=False,
)
