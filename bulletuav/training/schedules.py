"""Default settings of training runs by task."""

import dataclasses
from collections.abc import Mapping
from typing import Any

from bulletuav.policies.recurrent import BLOCKS
from bulletuav.policies.run import (
    CONFIG,
    FAST,
    FOUNDATION,
    SCENE,
    RunConfig,
    shipped,
    shipped_tasks,
)
from bulletuav.tasks import find_task
from bulletuav.tasks.default import Default
from bulletuav.tasks.goal_flight import GoalFlight
from bulletuav.tasks.user_service import UserService
from bulletuav.training.foundation.settings import require_hover

REPLACED = {"position": None, "goal": "goal_offset", "neighbours": "intruders"}
"""Blocks of a goal flight's observation that training leaves out (None) or replaces.

Near the goal, its offset in symlog changes far more than its direction. With the direction, drones
learn to fly towards the goal, but not to hit it.
"""
GOAL_FLIGHT: dict[str, Any] = {
    "steps": 1_200_000,
    "worlds": 64,
    "staggered": True,
    "model": {"features": "swarm", "n_steps": 32, "n_epochs": 4},
}
"""Settings of runs in flights of several drones to goals"""
CLOSE_FIT: dict[str, Any] = {"batch_size": 1024, "n_epochs": 6}
"""More and smaller gradient steps, for tasks in which 0.4 million decisions teach little"""
OWN: dict[str, dict[str, Any]] = {
    "follow": {"worlds": 64, "staggered": True, "options": {"dynamics": "point_mass"}},
    "formation": {"model": CLOSE_FIT},
    "hover": {
        "steps": 600_000,
        "worlds": 128,
        "staggered": True,
        # Drones that fly away waste decisions
        "options": {"dynamics": "rigid_body", "max_distance": 5.0},
        "model": {
            "n_steps": 16,
            "batch_size": 512,
            "n_epochs": 4,
            "learning_rate": [3e-3, 1e-5],
            "gamma": 0.97,
            "policy_kwargs": {
                "net_arch": [64, 64],
                "log_std_init": -1.5,
                # Distances of some centimetres count
                "features_extractor_kwargs": {"scale": 5.0},
            },
        },
    },
    "los": {
        "steps": 1_000_000,
        "worlds": 64,
        "shared_reward": False,
        "options": {
            "decision_hz": 2,
            "horizon": 120,
            # Without lidar and room, drones touch buildings and leave through the ceiling
            "observation": [
                "position",
                "room",
                "lidar",
                "contribution_ahead",
                "all_neighbours",
                "targets",
            ],
        },
        "evaluation": {"horizon": 120},
        "model": {
            "features": "swarm",
            "n_steps": 16,
            "batch_size": 512,
            "n_epochs": 5,
            "learning_rate": [2e-3, 1e-5],
            "gamma": 0.95,
            "gae_lambda": 0.95,
            "policy_kwargs": {"net_arch": [64, 64], "log_std_init": -1.2},
        },
    },
    "navigation": {
        "steps": 1_000_000,
        # Drones cannot learn where streets are without sensing buildings
        "options": {
            "observation": ["velocity", "goal_offset", "room", "lidar", "intruders"],
            "num_neighbours": 2,
        },
        "model": {"batch_size": 1024, "n_epochs": 5},
    },
    "obstacles": {"model": CLOSE_FIT},
    "pursuit": {"model": CLOSE_FIT},
    "pursuit_evasion": {
        "worlds": 64,
        "staggered": True,
        "options": {
            # The goal is the nearest opponent
            "observation": [
                "velocity",
                "team",
                "room",
                "goal_offset",
                "goal_velocity",
                "teammates",
            ],
            "dynamics": "point_mass",
        },
        "model": {"features": "swarm", "n_steps": 32, "batch_size": 1024},
    },
    "race": {
        "worlds": 64,
        "staggered": True,
        "options": {
            # Drones that crash at their first gate never see the second
            "contact_ends": "nothing",
            "observation": ["velocity", "gate_aim", "rank", "neighbours"],
            "num_neighbours": 1,
        },
        # Fast first, without taking off, then as in evaluations
        "stages": [
            {"dynamics": "point_mass", "take_off": False},
            {"dynamics": "bullet", "take_off": True},
        ],
        "curriculum": {"up": 0.15, "down": 0.0, "window": 100},
        "model": {
            "n_steps": 32,
            "batch_size": 512,
            "gamma": 0.985,
            "learning_rate": [2e-3, 1e-5],
            "policy_kwargs": {"net_arch": [64, 64], "log_std_init": -1.5},
        },
    },
}
"""Settings of single tasks, in addition to those of their kind"""
FAST_FLIGHT: dict[str, Any] = {
    "worlds": 32,
    "evaluations": 4,
    "episodes": 10,
    "options": {"num_neighbours": 4},
    "model": {"batch_size": 1024, "n_epochs": 3, "learning_rate": [2e-3, 1e-5]},
}
"""Settings of runs with the algorithm `FAST` in flights of several drones to goals"""
WIDE = 6.0
"""Separation that training asks for, m: policies that keep it seldom fall below the task's 5 m"""
CITIES = {"num_layouts": 16, "city_seed": 77}
"""Cities of trainings, which no evaluation uses"""
STREETS = {
    "progress": 0.1,
    "goal": 3.0,
    "time": -0.01,
    "energy": -0.0002,
    "collision": -4.0,
    "conflict": -4.0,
    "out_of_bounds": -1.0,
    "warning": -0.1,
}
"""Weights of flights through streets, as in examples/streets.py"""
FAST_SERVICE: dict[str, Any] = {
    "steps": 400_000,
    "evaluations": 2,
    "options": {
        # The network does not depend on the numbers of drones and users
        "observation": ["room", "contribution_ahead", "all_neighbours", "targets"],
        "difficulty": "medium",
        **CITIES,
    },
    "model": {
        "features": "swarm",
        "batch_size": 800,
        "learning_rate": [2e-3, 1e-5],
        "policy_kwargs": {
            "net_arch": [64, 64],
            "log_std_init": -0.7,
            "features_extractor_kwargs": {"size": 16},
        },
    },
}
"""Settings of runs with the algorithm `FAST` in tasks of service to users"""
FAST_OWN: dict[str, dict[str, Any]] = {
    "converge": {"options": {"difficulty": "medium", "num_drones": [4, 12], "d_safe": WIDE}},
    # With 7 m all of 20 seeds keep 5 m; with `WIDE` seven of ten
    "crossing": {"steps": 650_000, "options": {"d_safe": 7.0}},
    "flocking": {
        "steps": 3_000_000,
        "worlds": 64,
        "evaluations": 1,
        "episodes": 2,
        "options": {
            "difficulty": "easy",
            "num_drones": 8,
            "dynamics": "rigid_body",
            "observation": ["velocity", "goal_offset", "goal_velocity", "intruders"],
            # Noise of actions is proportional to it
            "max_speed": 12.0,
            "d_safe": WIDE,
            "warning_zone": 1.7,
            # A price of the speed error would keep drones from catching up with the leader
            "weights": {
                "progress": 0.05,
                "flocking": 0.3,
                "alignment": 0.0,
                "cohesion": 0.0,
                "straying": -0.01,
                "speed_error": 0.0,
                "conflict": -6.0,
                "warning": -0.15,
                "out_of_bounds": -10.0,
                "time": 0.0,
            },
        },
        "model": {
            "n_epochs": 5,
            "gamma": 0.98,
            "learning_rate": [3e-3, 1e-5],
            "policy_kwargs": {"net_arch": [64, 64], "log_std_init": -1.5},
        },
    },
    "follow": {
        "steps": 700_000,
        "worlds": 64,
        "evaluations": 4,
        "episodes": 10,
        "options": {
            # Policies of point_mass swing around their stations in other dynamics
            "dynamics": "rigid_body",
            "difficulty": "hard",
            "observation": ["goal_offset", "velocity", "goal_velocity"],
            "max_distance": 15.0,
            "weights": {"alive": 0.6, "holding": 0.3, "distance": -0.05, "speed": -0.02},
        },
        "model": {
            "n_steps": 32,
            "batch_size": 512,
            "n_epochs": 4,
            "learning_rate": [3e-3, 1e-5],
            "gamma": 0.97,
            "policy_kwargs": {
                "net_arch": [32, 32],
                "log_std_init": -1.5,
                # Closer to linear, so that the policy flies at other speeds of the target, too
                "features_extractor_kwargs": {"scale": 0.2},
            },
        },
    },
    "formation": {
        "steps": 8_000_000,
        "options": {"difficulty": "medium", "d_safe": WIDE, "dynamics": "rigid_body"},
    },
    "free_flight": {
        "steps": 6_000_000,
        "options": {"difficulty": "medium", "num_drones": [2, 8], "d_safe": WIDE},
    },
    "landing_strip": {
        "steps": 3_000_000,
        "worlds": 48,
        "evaluations": 3,
        "episodes": 10,
        "staggered": True,
        "options": {
            "dynamics": "point_mass",
            # Speeds and descents of a safe touchdown, and none that is a loiter
            "action": "heading_speed_climb",
            "max_speed": 14.0,
            "max_climb": 1.5,
            # Few decisions, so that noise of actions moves an aircraft
            "decision_hz": 2,
            "horizon": 180,
            "observation": ["velocity", "goal_offset", "runway", "neighbours"],
            "num_neighbours": 3,
            "weights": {"waiting": -0.01},
        },
        # As long as by default, at easy and medium
        "evaluation": {"horizon": 180},
        # From a shallow path to a wide runway at first, so that some touch down by chance. Policies
        # of four aircraft miss the touchdown zone if there are only two
        "stages": [
            {
                "difficulty": "easy",
                "num_drones": [2, 4],
                "distance": 60.0,
                "glide_angle": 1.0,
                "width": 40.0,
                "bank": 60.0,
                "course": 45.0,
            },
            {
                "difficulty": "easy",
                "num_drones": [2, 4],
                "distance": 120.0,
                "glide_angle": 2.0,
                "width": 30.0,
                "bank": 40.0,
                "course": 30.0,
            },
            {
                "difficulty": "easy",
                "num_drones": [2, 4],
                "distance": 180.0,
                "glide_angle": 3.0,
                "width": 20.0,
                "bank": 30.0,
                "course": 20.0,
            },
            {"difficulty": "medium", "num_drones": [2, 4]},
        ],
        "curriculum": {"up": 0.5, "down": 0.0, "window": 200},
        "model": {
            "features": "swarm",
            "n_steps": 64,
            "gamma": 0.98,
            "gae_lambda": 0.95,
            "policy_kwargs": {
                "net_arch": [64, 64],
                "log_std_init": -1.5,
                "features_extractor_kwargs": {"size": 16},
            },
        },
    },
    "lidar_navigation": {
        "steps": 16_000_000,
        "options": {
            "observation": ["velocity", "goal", "battery", "room", "lidar"],
            "num_drones": [3, 8],
            "difficulty": "medium",
            "dynamics": "rigid_body",
            **CITIES,
            "weights": {**STREETS, "proximity": -0.02},
        },
    },
    "navigation": {
        "steps": 16_000_000,
        "worlds": 64,
        "options": {
            "difficulty": "medium",
            "num_drones": [3, 5],
            "num_neighbours": 2,
            "dynamics": "rigid_body",
            "weights": STREETS,
            **CITIES,
        },
    },
    "obstacles": {
        "steps": 6_000_000,
        "options": {"difficulty": "medium", "num_drones": [4, 12], "d_safe": WIDE},
    },
    "pad_landing": {
        "steps": 5_000_000,
        "worlds": 48,
        "evaluations": 2,
        "episodes": 10,
        "staggered": True,
        "options": {
            "dynamics": "rigid_body",
            "num_drones": 3,
            # The nearest unclaimed pad is the goal, which pictures would have to show otherwise
            "observation": ["velocity", "goal_offset", "goal_velocity", "neighbours"],
            # Above the task's 0.4 m, as in `WIDE`
            "d_safe": 0.6,
            "weights": {
                "progress": 0.6,
                "touching": 0.15,
                "waiting": -0.001,
                "conflict": -3.0,
                "collision": -1.5,
            },
        },
        # Down to a pad nearby at first
        "stages": [
            {"distance": 2.0, "start_height": [1.5, 3.0], "pad_height": [0.2, 1.0]},
            {"distance": 4.0},
            {},
            {"difficulty": "medium", "num_drones": 3},
        ],
        "curriculum": {"up": 0.4, "down": 0.0, "window": 200},
        "model": {
            "features": "swarm",
            "n_steps": 128,
            "gamma": 0.995,
            "gae_lambda": 0.97,
            "policy_kwargs": {
                "net_arch": [64, 64],
                "log_std_init": -1.0,
                "features_extractor_kwargs": {"scale": 3.0, "size": 16},
            },
        },
    },
    "pursuit": {
        "steps": 8_000_000,
        "options": {
            "difficulty": "medium",
            "num_drones": 6,
            "d_safe": 5.5,
            "weights": {"lap": 20.0},
        },
        "model": {
            "n_epochs": 4,
            "gamma": 0.985,
            "policy_kwargs": {"net_arch": [64, 64], "log_std_init": -1.5},
        },
    },
    "hover": {
        "steps": 280_000,
        "options": {
            "dynamics": "rigid_body",
            "max_distance": 3.0,
            # Each decision pays within 2.7 m; speed costs nearly nothing, so that all seeds learn
            "weights": {"alive": 0.4, "holding": 0.1, "distance": -0.15, "speed": -0.0025},
            # In body axes, the heading does not matter
            "observation": ["body_goal_offset", "body_velocity", "body_up", "rates"],
        },
        "model": {
            "n_steps": 16,
            "batch_size": 512,
            "n_epochs": 4,
            "learning_rate": [4e-3, 1e-5],
            "gamma": 0.97,
            "policy_kwargs": {
                "net_arch": [32, 32],
                "log_std_init": -1.8,
                # Distances of some centimetres count
                "features_extractor_kwargs": {"scale": 5.0},
            },
        },
    },
    "default": {
        "steps": 3_000_000,
        "evaluations": 3,
        "episodes": 10,
        "options": {
            "difficulty": "medium",
            # As fast as `point_mass`, and near the default dynamics
            "dynamics": "rigid_body",
            **CITIES,
        },
    },
    "interception": {
        "evaluations": 2,
        "worlds": 64,
        "staggered": True,
        "options": {
            "dynamics": "rigid_body",
            "observation": ["velocity", "target_track", "room", "lidar"],
        },
        "model": {"n_steps": 64, "gamma": 0.985},
    },
    "mec": {**FAST_SERVICE, "steps": 800_000},
    "mec_advanced": {**FAST_SERVICE, "steps": 2_000_000},
    "mobile_users": FAST_SERVICE,
    "pursuit_evasion": {"steps": 1_500_000, "evaluations": 2, "episodes": 10},
    "race": {
        "steps": 8_000_000,
        "evaluations": 4,
        "options": {
            "dynamics": "rigid_body",
            "num_neighbours": 3,
            # A contact ends the flight; if that cost the remaining time, too, drones would stay
            "contact_ends": "drone",
            "weights": {"time": 0.0, "collision": -1.0, "conflict": -8.0},
        },
        # A drone that flies through gates before it meets others is not stopped by conflicts
        "stages": [{"num_drones": 1}, {}],
        "curriculum": {"up": 0.5, "down": 0.0, "window": 200},
        "model": {
            # Untrained features are small, so that others do not disturb a drone at first
            "features": "swarm",
            "policy_kwargs": {
                "net_arch": [64, 64],
                "log_std_init": -1.5,
                "features_extractor_kwargs": {"size": 16},
            },
        },
    },
    "search": {
        "steps": 3_000_000,
        "evaluations": 2,
        "worlds": 64,
        "staggered": True,
        "options": {
            "dynamics": "rigid_body",
            "observation": ["velocity", "clue_offset", "sighting", "searched_cells", "lidar"],
            # With ten a second, noise of actions moves a drone too little to find victims
            "decision_hz": 2,
            "horizon": 120,
        },
        "evaluation": {"horizon": 120},
        "model": {
            "n_steps": 32,
            "gamma": 0.96,
            "policy_kwargs": {"net_arch": [64, 64], "log_std_init": -1.0},
        },
    },
    "transport": {
        "steps": 2_800_000,
        "worlds": 64,
        "evaluations": 2,
        "episodes": 5,
        "staggered": True,
        "options": {
            # Numbers of the own cable and the load, which do not depend on the number of drones
            "observation": ["velocity", "cable", "load_goal_offset", "load"],
            # A price of time would be due when a lift fails, and discounted when drones only hover
            "weights": {
                "progress": 1.0,
                "delivery": 5.0,
                "early": 5.0,
                "swing": 0.0,
                "drag": -0.1,
                "waiting": 0.0,
                "failure": -0.2,
                "conflict": -1.0,
                "collision": -0.3,
            },
        },
        "stages": [
            {"num_drones": 1, "distance": [1.0, 2.0], "place_radius": 0.4},
            {"num_drones": 2, "distance": [1.0, 2.0], "place_radius": 0.4},
            {"num_drones": 2, "distance": [2.0, 6.0], "place_radius": 0.3},
            {"difficulty": "medium"},
            # Smaller places than the task's, so that drones seldom miss those
            {"difficulty": "medium", "distance": [2.0, 9.0], "place_radius": 0.14},
        ],
        "curriculum": {"up": 0.5, "down": 0.0, "window": 200},
        "model": {
            "features": "symlog",
            "n_steps": 64,
            "policy_kwargs": {
                "net_arch": [64, 64],
                "log_std_init": -1.2,
                "features_extractor_kwargs": {"scale": 3.0},
            },
        },
    },
}
"""Settings of single tasks with the algorithm `FAST`, in addition to those of `FAST_FLIGHT`"""
ONE_FOR_ALL: dict[str, Any] = {
    "steps": 20_000_000,
    "worlds": 4,
    "options": {
        "dynamics": "rigid_body",
        "difficulty": "hard",
        # Far starts, so that drones learn to approach far goals at a constant speed
        "start_offset": 3.0,
        "spacing": 8.0,
        "max_distance": 8.0,
        "observation": list(BLOCKS),
        "action": "rotor",
        # The policy keeps its rate wherever it flies
        "decision_hz": 30,
    },
    "evaluations": 10,
    "evaluation": {
        "difficulty": "medium",
        "airframe": ["cf21B", "cf2p", "cf2x", "cf2x_L250", "hummingbird", "iris", "racer"],
    },
}
"""Settings of runs with the algorithm `FOUNDATION`"""
USERS = ("position", "all_neighbours", "targets", "sight_matrix", "sight_ahead")
"""Blocks of an observation that the network `user_sum` reads"""
SERVICE: dict[str, Any] = {
    "steps": 800_000,
    "worlds": 32,
    "shared_reward": True,
    "staggered": True,
    "model": {
        "features": "user_sum",
        "n_steps": 25,
        "batch_size": 400,
        "n_epochs": 4,
        # The service changes with each move, so that later rewards add mostly noise
        "gamma": 0.9,
        "gae_lambda": 0.9,
        "policy_kwargs": {"net_arch": [64, 64], "log_std_init": -0.7},
    },
}
"""Settings of runs in tasks of service to users, which the drones of a world share"""


def default_run(task: str, algo: str = "ppo") -> RunConfig:
    """Return the default settings of a training run.

    They are the schedule `GOAL_FLIGHT` in goal flights and in `default`, those of the policy of the
    package in `mec`, `SERVICE` in other tasks with users, and otherwise those of `RunConfig` with
    the task's weights for training. Settings in `OWN` replace them. The difficulty, the other
    options of `SCENE` and the options of evaluations are the defaults of the task, as in
    `evaluate`, except the horizon in `los`.

    Args:
        task: Name of the task.
        algo: Algorithm, "ppo", `FOUNDATION`, or `FAST`, whose settings are those of "ppo", replaced
            by `FAST_FLIGHT` in goal flights, and by `FAST_OWN`.

    Raises:
        ValueError: If there is no such task.
    """
    if algo == FOUNDATION:
        require_hover(task)
        return RunConfig(task, algo, **ONE_FOR_ALL)
    if algo == FAST:
        run = dataclasses.replace(default_run(task), algo=FAST)
        if issubclass(find_task(task), GoalFlight):
            run = _replace_settings(run, FAST_FLIGHT)
        return _replace_settings(run, FAST_OWN.get(task, {}))
    kind = find_task(task)
    options: dict[str, Any] = {"reward": "training"}
    if issubclass(kind, GoalFlight | Default):
        # run.yaml has names of blocks, and no blocks that only the task's module names
        own = kind.observation
        named = [REPLACED.get(one, one) for one in own if isinstance(one, str)]
        observed = own if isinstance(own, Mapping) else [one for one in named if one]
        options |= {"observation": observed, "num_neighbours": 6}
        # It is fast, and policies that learn in it fly in dynamics with rotors, too
        options["dynamics"] = "point_mass"
        return _with_own(RunConfig(task, options=options, **GOAL_FLIGHT))
    if kind.name in shipped_tasks() and kind.name not in OWN and shipped_run(task).algo != FAST:
        known = shipped_run(task)
        options = {name: value for name, value in known.options.items() if name not in SCENE}
        return dataclasses.replace(known, options=options, evaluation={})
    if issubclass(kind, UserService):
        # It is fast, and policies choose places, which hardly depend on the dynamics
        options |= {"observation": list(USERS), "dynamics": "single_integrator"}
        return _with_own(RunConfig(task, options=options, **SERVICE))
    return _with_own(RunConfig(task, options=options))


def _with_own(run: RunConfig) -> RunConfig:
    """Replace settings of a run by those of its task in `OWN`."""
    return _replace_settings(run, OWN.get(run.task, {}))


def _replace_settings(run: RunConfig, own: Mapping[str, Any]) -> RunConfig:
    """Replace settings of a run; single options, and single settings of the algorithm."""
    merged = {name: {**getattr(run, name), **own.get(name, {})} for name in ("options", "model")}
    return dataclasses.replace(run, **{**own, **merged})


def shipped_run(task: str) -> RunConfig:
    """Return the settings of the policy of the package for a task, with seed 0."""
    return dataclasses.replace(RunConfig.read(shipped(task) / CONFIG), seed=0)
