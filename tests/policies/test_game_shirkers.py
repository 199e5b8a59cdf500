"""Chasers that avoid `pursuit_evasion` do what their names say."""

import numpy as np
import pytest

import bulletuav
from bulletuav.analysis.evaluation import evaluate
from bulletuav.analysis.metrics.teams import FIRST_SUCCESS
from bulletuav.policies import find_policy


def fly(name, decisions=150):
    """Fly both teams; return the aviary and the positions of each decision, (T, N, 3)."""
    options = {"dynamics": "single_integrator", "difficulty": "medium", "teams": (2, 2)}
    aviary = bulletuav.Aviary("pursuit_evasion", 1, **options)
    policy = find_policy(f"{name} vs stay", "pursuit_evasion")(aviary)
    observations, positions = aviary.reset(seeds=0), []
    policy.reset(np.ones(1, dtype=bool))
    for _ in range(decisions):
        positions.append(aviary.swarm.position[0].copy())
        if not aviary.alive.any():
            break
        observations = aviary.step(policy.act(observations, aviary.swarm)).observations
    return aviary, np.array(positions)


def test_a_shadow_comes_near_but_captures_nobody():
    aviary, positions = fly("chase_shadow")
    chasers, evaders = aviary.task.team == 0, aviary.task.team == 1
    gaps = np.linalg.norm(positions[-1, chasers][:, None] - positions[-1, evaders], axis=-1)
    radius = aviary.task.config.capture_radius
    assert aviary.scene.memory["captures"].sum() == 0
    assert gaps.min(axis=1) == pytest.approx(3 * radius, abs=1.5)


def test_free_riders_stay_where_they_start():
    aviary, positions = fly("chase_free_ride", 40)
    chasers = np.flatnonzero(aviary.task.team == 0)
    moved = np.linalg.norm(positions[-1] - positions[0], axis=-1)
    assert moved[0] > 10.0
    assert moved[chasers[1:]].max() < 0.1


def test_work_ends_with_the_first_capture():
    aviary, positions = fly("chase_once")
    chasers = np.flatnonzero(aviary.task.team == 0)
    assert aviary.scene.memory["captures"].sum() in (1, 2)
    # The two chasers may capture in the same decision, else one evader is left
    assert np.linalg.norm(positions[-1, chasers] - positions[-2, chasers], axis=-1).max() < 0.1


def test_one_chaser_captures_less_often_than_three():
    """Of 16 evaders that flee from walls, too, three chasers capture all but one at most."""
    success = {}
    for name in ("lead", "chase_free_ride"):
        versus = f"{name} vs flee_weighted"
        options = {"dynamics": "point_mass", "difficulty": "medium"}
        result = evaluate("pursuit_evasion", versus, 16, metrics=(FIRST_SUCCESS,), **options)
        success[name] = result.estimates()[FIRST_SUCCESS.name].mean
    assert success["lead"] >= 15 / 16
    assert success["chase_free_ride"] <= 10 / 16
