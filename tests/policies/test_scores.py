"""Scores of the policies in the package, and the warning where a policy is of no use."""

import warnings

import pytest

import bulletuav
from bulletuav.policies import find_policy, scores
from bulletuav.policies.run import shipped_tasks
from bulletuav.tasks import find_task

SCORE = {"episodes": 40, "trained": [0.5, 0.4, 0.6], "stay": [0.3, 0.2, 0.4], "orca": [1, 1, 1]}


def make(policy, task, difficulty, **options):
    spec = find_policy(policy, task)
    aviary = bulletuav.Aviary(task, 1, **{**spec.options, "difficulty": difficulty, **options})
    spec(aviary)
    aviary.close()


def test_a_policy_that_does_not_beat_stay_warns_with_its_score_and_the_remedy(monkeypatch):
    known = {"medium": SCORE}
    monkeypatch.setattr(scores, "read_scores", lambda task: known)
    with pytest.warns(UserWarning, match="not measurably better") as found:
        make("trained", "follow", "medium")
    (warning,) = found
    text = str(warning.message)
    assert "for follow was not measurably better than 'stay' at difficulty 'medium'" in text
    assert "safe success 0.50 [0.40, 0.60] and 0.30 [0.20, 0.40]" in text
    assert text.endswith("bulletuav train follow --algo fast_ppo --difficulty medium")


def test_the_remedy_is_not_the_training_that_the_policy_had(monkeypatch):
    monkeypatch.setattr(scores, "read_scores", lambda task: {"hard": SCORE})
    with pytest.warns(UserWarning, match="was trained there, and another one needs other settings"):
        make("trained", "follow", "hard")


@pytest.mark.parametrize(
    ("policy", "difficulty", "trained"),
    [
        ("trained", "medium", [0.5, 0.41, 0.6]),  # better
        ("trained", "easy", [0.0, 0.0, 0.1]),  # not measured at easy
        ("untrained", "medium", [0.0, 0.0, 0.1]),
    ],
)
def test_other_flights_do_not_warn(policy, difficulty, trained, monkeypatch):
    known = {"medium": {**SCORE, "trained": trained}}
    monkeypatch.setattr(scores, "read_scores", lambda task: known)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        make(policy, "follow", difficulty)


def test_a_policy_without_scores_flies_without_warning(monkeypatch, tmp_path):
    monkeypatch.setattr(scores, "SHIPPED", tmp_path)
    assert scores.read_scores("follow") == {}


@pytest.mark.parametrize("task", shipped_tasks())
def test_every_policy_of_the_package_was_measured(task):
    known = scores.read_scores(task)
    assert known
    assert set(known) <= set(find_task(task).difficulties)
    assert any(map(scores.is_better, known.values()))
    for score in known.values():
        for mean, low, high in list(score.values())[1:]:
            assert 0 <= low <= mean <= high <= 1
