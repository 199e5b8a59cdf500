"""Whether a task pays for what it wants: its baseline against policies that shirk.

Of a game between teams the shirkers fly the first team, and the others fly as in the baseline: what
the first team earns is compared. Averages over opponents would tell nothing, as gains of one are
losses of the other.
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
"""Policies that no task should pay; see `bulletuav.policies.scripted`"""
HOVERING_POLICY = "stay"
"""The one from which leads are measured"""
MIN_LEAD_FRACTION = 0.1
"""Share of its lead over standing still by which the baseline is to out-earn each of them"""


class Incentive(NamedTuple):
    """What a task pays its baseline and a policy that shirks, in the same episodes.

    Attributes:
        task: Name of the task.
        difficulty: Its difficulty.
        baseline: Name of the baseline.
        shirker: Name of the other policy.
        earned: Return of the baseline, mean of the drones; of a game, of the first team's.
        success: Share of these drones that succeed with the baseline.
        gained: Return of the other.
        gap: By how much the baseline earns more in the same episode.
        lead: By how much it earns more than standing still, in the mean.
        conditions: Dynamics, episodes and seeds of all these, with task and difficulty.
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
        """Whether the baseline out-earns the other by more than a tenth of its lead.

        That is of the lower end of the 95 % interval of the gap.
        """
        return self.lead > 0 and self.return_difference.low > MIN_LEAD_FRACTION * self.lead


def list_degenerate_policies(task: TaskSource, baseline: PolicySource) -> list[str]:
    """List the policies to compare a task's baseline with."""
    with_targets = not find_task(task).has_goals
    first, *opponents = _split_teams(baseline)
    left_out = {first} if with_targets else {first, "clump"}
    # In a game, whose goals are opponents, who flies straight at its goal does what is wanted.
    left_out |= {"straight"} if opponents else set()
    return [name for name in DEGENERATE_POLICIES if name not in left_out]


def _split_teams(policy: PolicySource) -> list[PolicySource]:
    """List what flies each team, the first one first; a policy of all drones alone."""
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
    """Compare a task's baseline with each policy that shirks, in the same episodes.

    Args:
        task: The task: a name or a class.
        policy: The baseline; the task's own when left out.
        episodes: How many each flies.
        seed: Seed of the first.
        workers: Processes, which change nothing but the time.
        progress: Told how many more episodes are done.
        trust: Whether a model may be read that can run code meanwhile.
        **options: Those of `parallel_env`, such as `difficulty`.

    Yields:
        A comparison for each policy that shirks, standing still first.

    Raises:
        ValueError: An argument is none that can be.
    """
    # Against opponents only the first team's part counts
    chosen = find_task(task).baseline if policy is None else policy
    opponents = _split_teams(chosen)[1:]
    metrics = (FIRST_RETURN, FIRST_SUCCESS) if opponents else ()
    degenerate_return, success = (
        (one.name for one in metrics) if opponents else ("return", "drone_success")
    )

    def fly(name: PolicySource) -> Evaluation:
        given = (task, name, episodes, seed, workers, None, progress, trust, metrics)
        # All of them ask for velocities, whatever the task's usual action.
        return evaluate(*given, **{"action": "velocity", **options})

    def shirk(name: str) -> Evaluation:
        return fly(VERSUS.join([name, *map(str, opponents)]))

    # Who stands still is the measure of what flying earns
    base, standing = fly(chosen), shirk(HOVERING_POLICY)
    lead = _estimate_difference(base, standing, degenerate_return).mean
    for name in list_degenerate_policies(task, chosen):
        other = standing if name == HOVERING_POLICY else shirk(name)
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
    """Estimate by how much returns differ, episode by episode."""
    pairs = zip(one.rows, other.rows, strict=True)
    return mean_estimate([mine[metric] - yours[metric] for mine, yours in pairs])
