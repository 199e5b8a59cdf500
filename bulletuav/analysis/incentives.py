"""Test of a task's reward: its baseline against degenerate policies, which should earn less.

In a game between teams, the degenerate policies control the first team, and the other teams are
controlled as in the baseline. Only the returns of the first team are compared: an average over both
teams would be uninformative, as the gain of one team is the loss of the other.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from bulletuav.analysis.conditions import Conditions
from bulletuav.analysis.evaluation import Evaluation, evaluate
from bulletuav.analysis.metrics import Estimate, mean_estimate
from bulletuav.analysis.metrics.teams import FIRST_RETURN, FIRST_SUCCESS
from bulletuav.policies import PolicySource
from bulletuav.policies.versus import VERSUS
from bulletuav.tasks import TaskSource, find_task

DEGENERATE_POLICIES = ("stay", "climb", "dive", "leave", "crash", "circle", "straight", "clump")
"""Policies that no task should reward; see `bulletuav.policies.scripted`"""
HOVERING_POLICY = "stay"
"""Policy that stays in place, against which the lead of the baseline is measured"""
MIN_LEAD_FRACTION = 0.1
"""Minimum margin over each degenerate policy, as a fraction of the lead over staying in place"""


class Incentive(NamedTuple):
    """Returns of a task's baseline and of a degenerate policy, in the same episodes.

    Attributes:
        task: Name of the task.
        difficulty: Difficulty of the task.
        baseline: Name of the baseline.
        degenerate_policy: Name of the degenerate policy.
        baseline_return: Return of the baseline, mean over drones; in a game, over the first team.
        success: Fraction of these drones that succeed with the baseline.
        degenerate_return: Return of the degenerate policy.
        return_difference: Baseline's return minus the degenerate policy's, episode by episode.
        lead: Baseline's mean return minus that of staying in place.
        conditions: Task, difficulty, dynamics, episodes and seeds of these returns.
    """

    task: str
    difficulty: str
    baseline: str
    degenerate_policy: str
    baseline_return: Estimate
    success: Estimate
    degenerate_return: Estimate
    return_difference: Estimate
    lead: float
    conditions: Conditions

    @property
    def holds(self) -> bool:
        """Whether the baseline earns more by a margin of at least a tenth of its lead.

        The lower end of the 95 % interval of the difference must exceed the margin.
        """
        return self.lead > 0 and self.return_difference.low > MIN_LEAD_FRACTION * self.lead


def list_degenerate_policies(task: TaskSource, baseline: PolicySource) -> list[str]:
    """List the policies that a task's baseline is compared with."""
    with_targets = not find_task(task).has_goals
    first, *opponents = _split_teams(baseline)
    left_out = {first} if with_targets else {first, "clump"}
    # In a game the goals are opponents, so that flying straight at the goal is the desired
    # behaviour.
    left_out |= {"straight"} if opponents else set()
    return [name for name in DEGENERATE_POLICIES if name not in left_out]


def _split_teams(policy: PolicySource) -> list[PolicySource]:
    """List the policies of the teams, the first team first; of other tasks, the only policy."""
    return [*policy.split(VERSUS)] if isinstance(policy, str) else [policy]


def incentives(
    task: TaskSource,
    policy: PolicySource | None = None,
    episodes: int = 20,
    seed: int = 0,
    workers: int = 1,
    progress: Callable[[int], None] | None = None,
    trust: bool = False,
    **options: Any,
) -> Iterator[Incentive]:
    """Compare a task's baseline with each degenerate policy, in the same episodes.

    Args:
        task: Name or class of the task.
        policy: The baseline; by default the task's own.
        episodes: Number of episodes of each policy.
        seed: Seed of the first episode.
        workers: Number of processes; it only affects the speed.
        progress: Callback that receives the number of newly finished episodes.
        trust: Whether to load models that can run code on loading.
        **options: Options of `parallel_env`, such as `difficulty`.

    Yields:
        A comparison for each degenerate policy, the one that stays in place first.

    Raises:
        ValueError: If an argument is invalid.
    """
    # In a game only the first team's metrics are compared
    chosen = find_task(task).baseline if policy is None else policy
    opponents = _split_teams(chosen)[1:]
    metrics = (FIRST_RETURN, FIRST_SUCCESS) if opponents else ()
    degenerate_return, success = (
        (one.name for one in metrics) if opponents else ("return", "drone_success")
    )

    def fly(name: PolicySource) -> Evaluation:
        given = (task, name, episodes, seed, workers, None, progress, trust, metrics)
        # All these policies output velocities, whatever the task's default action.
        return evaluate(*given, **{"action": "velocity", **options})

    def fly_degenerate(name: str) -> Evaluation:
        return fly(VERSUS.join([name, *map(str, opponents)]))

    # The return of staying in place is the reference of the lead
    base, standing = fly(chosen), fly_degenerate(HOVERING_POLICY)
    lead = _estimate_difference(base, standing, degenerate_return).mean
    for name in list_degenerate_policies(task, chosen):
        other = standing if name == HOVERING_POLICY else fly_degenerate(name)
        yield Incentive(
            task=base.about["task"],
            difficulty=base.about["options"]["difficulty"],
            baseline=base.about["policy"],
            degenerate_policy=name,
            baseline_return=base.estimates()[degenerate_return],
            success=base.estimates()[success],
            degenerate_return=other.estimates()[degenerate_return],
            return_difference=_estimate_difference(base, other, degenerate_return),
            lead=lead,
            conditions=base.conditions,
        )


def _estimate_difference(one: Evaluation, other: Evaluation, metric: str) -> Estimate:
    """Estimate the mean difference of a metric, paired by episode."""
    pairs = zip(one.rows, other.rows, strict=True)
    return mean_estimate([mine[metric] - yours[metric] for mine, yours in pairs])
