"""Check of tasks: what do policies earn that do not do the task, and who can do it?

Each policy flies the same episodes as the task's baseline and has a role:

- the oracle, which knows the whole state, shows that the task can be done;
- blind policies observe nothing, and should not succeed;
- policies that shirk try to be paid without doing the task, and should earn less;
- others, such as learned policies, should not earn more than the baseline at less success.

Success is safe success: the purpose of the task without conflict or collision. In a game between
teams the policies control the first team, and the other teams are controlled as in the baseline.
Return and success are those of the first team then: an average over both teams would be
uninformative, as the gain of one team is the loss of the other. Oracles and blind policies of games
are not judged by their success, as it depends on the opponents.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Literal, NamedTuple

from bulletuav.analysis.conditions import Conditions
from bulletuav.analysis.evaluation import Evaluation, evaluate
from bulletuav.analysis.metrics import Estimate, mean_estimate
from bulletuav.analysis.metrics.teams import FIRST_RETURN, FIRST_SUCCESS
from bulletuav.policies import PolicySource
from bulletuav.policies.versus import VERSUS
from bulletuav.tasks import TaskSource, find_task

BLIND_POLICIES = ("stay", "climb", "spread")
"""Policies that observe nothing; see `bulletuav.policies.scripted`"""
DEGENERATE_POLICIES = ("dive", "leave", "crash", "circle", "straight", "clump")
"""Policies that no task should reward; see `bulletuav.policies.scripted`"""
HOVERING_POLICY = "stay"
"""Policy that stays in place, against which the lead of the baseline is measured"""
MIN_LEAD_FRACTION = 0.1
"""Minimum margin over each degenerate policy, as a fraction of the lead over staying in place"""
MIN_ORACLE_SUCCESS = 0.9
"""Minimum safe success of an oracle"""
MAX_BLIND_SUCCESS = 0.1
"""Maximum safe success of a policy that observes nothing"""

Role = Literal["baseline", "oracle", "blind", "shirker", "other"]


class Incentive(NamedTuple):
    """Safe success and return of a policy, in the same episodes as the task's baseline.

    Attributes:
        task: Name of the task.
        difficulty: Difficulty of the task.
        policy: Name of the policy.
        role: Its role; see the module.
        success: Fraction of drones that succeed safely; in a game, of the first team.
        earned: Return, mean over drones; in a game, over the first team.
        success_gap: Baseline's safe success minus the policy's, episode by episode.
        gap: Baseline's return minus the policy's, episode by episode.
        lead: Baseline's mean return minus that of staying in place.
        is_game: Whether the task is a game between teams.
        conditions: Task, difficulty, dynamics, episodes and seeds of these returns.
    """

    task: str
    difficulty: str
    policy: str
    role: Role
    success: Estimate
    earned: Estimate
    success_gap: Estimate
    gap: Estimate
    lead: float
    is_game: bool
    conditions: Conditions

    @property
    def margin(self) -> float:
        """Lower end of the 95 % interval of `gap`, as a fraction of `lead`; NaN without a lead."""
        return self.gap.low / self.lead if self.lead > 0 else float("nan")

    @property
    def fault(self) -> str:
        """What is wrong with the task, "" if nothing is."""
        if self.lead <= 0:
            return "staying earns as much as the baseline"
        if self.role == "oracle":
            return "" if self.is_game or self.success.mean >= MIN_ORACLE_SUCCESS else "too hard"
        is_seeing = self.is_game or self.role != "blind"
        if not is_seeing and self.success.mean > MAX_BLIND_SUCCESS:
            return "done blindly"
        if self.role in ("blind", "shirker"):
            # A policy that succeeds as often as the baseline does the task
            does_it = self.role == "shirker" and self.success_gap.low <= 0 < self.success.mean
            return "" if does_it or self.margin > MIN_LEAD_FRACTION else "pays to avoid the task"
        if self.role == "other" and self.success_gap.low > 0 and self.gap.high < 0:
            return "pays more for less success"
        return ""


def list_policies(task: TaskSource, baseline: PolicySource) -> dict[str, Role]:
    """List the policies that a task's baseline is compared with, and their roles."""
    kind = find_task(task)
    first, *opponents = _split_teams(baseline)
    left_out = {first, kind.oracle, *(("clump",) if kind.has_goals else ())}
    # In a game the goals are opponents, so that flying straight at the goal is the desired
    # behaviour.
    left_out |= {"straight"} if opponents else set()
    roles: dict[str, Role] = {}
    if not kind.is_game:
        roles[kind.oracle or str(first)] = "oracle"
    roles |= dict.fromkeys(BLIND_POLICIES, "blind")
    for name in (*DEGENERATE_POLICIES, *kind.shirkers):
        roles.setdefault(name, "shirker")  # a baseline among them keeps its role
    return {name: role for name, role in roles.items() if role == "oracle" or name not in left_out}


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
    others: Sequence[str] = (),
    **options: Any,
) -> Iterator[Incentive]:
    """Compare a task's baseline with oracle, blind and shirking policies, in the same episodes.

    Args:
        task: Name or class of the task.
        policy: The baseline; by default the task's own.
        episodes: Number of episodes of each policy.
        seed: Seed of the first episode.
        workers: Number of processes; it only affects the speed.
        progress: Callback that receives the number of newly finished episodes.
        trust: Whether to load models that can run code on loading.
        others: Further policies, which should not earn more than the baseline at less success.
        **options: Options of `parallel_env`, such as `difficulty`.

    Yields:
        The baseline, then each policy of `list_policies`, then the others.

    Raises:
        ValueError: If an argument is invalid.
    """
    kind = find_task(task)
    chosen = kind.baseline if policy is None else policy
    first, *opponents = _split_teams(chosen)
    # In a game only the first team's metrics are compared
    metrics = (FIRST_RETURN, FIRST_SUCCESS) if opponents else ()
    earned, success = (one.name for one in metrics) if opponents else ("return", "safe_success")

    def fly(name: PolicySource) -> Evaluation:
        given = (task, name, episodes, seed, workers, None, progress, trust, metrics)
        # All these policies output velocities, whatever the task's default action.
        return evaluate(*given, **{"action": "velocity", **options})

    base = fly(chosen)
    flown = {first: base} if isinstance(first, str) else {}
    roles = {**list_policies(task, chosen), **dict.fromkeys(others, "other")}
    # The return of staying in place is the reference of the lead
    for name in (HOVERING_POLICY, *roles):
        if name not in flown:
            flown[name] = fly(VERSUS.join([name, *map(str, opponents)]))
    lead = _estimate_difference(base, flown[HOVERING_POLICY], earned).mean
    pairs: Iterable[tuple[str, Any, Evaluation]] = [
        (base.about["policy"], "baseline", base),
        *((name, role, flown[name]) for name, role in roles.items()),
    ]
    for name, role, other in pairs:
        yield Incentive(
            task=base.about["task"],
            difficulty=base.about["options"]["difficulty"],
            policy=name,
            role=role,
            success=other.estimates()[success],
            earned=other.estimates()[earned],
            success_gap=_estimate_difference(base, other, success),
            gap=_estimate_difference(base, other, earned),
            lead=lead,
            is_game=bool(opponents),
            conditions=base.conditions,
        )


def find_reversals(found: Iterable[Incentive]) -> list[str]:
    """List the difficulties at which an oracle succeeds more often than at an easier one.

    Args:
        found: Results of several difficulties, from easy to hard.

    Returns:
        A sentence for each reversal that the 95 % intervals do not explain.
    """
    last: dict[str, Incentive] = {}
    reversals = []
    for one in found:
        if one.role != "oracle" or one.is_game:
            continue
        easier = last.get(one.task)
        if easier is not None and one.success.low > easier.success.high:
            reversals.append(
                f"{one.task}: the oracle succeeds more often at {one.difficulty} "
                f"({one.success.mean:.2f}) than at {easier.difficulty} ({easier.success.mean:.2f})"
            )
        last[one.task] = one
    return reversals


def _estimate_difference(one: Evaluation, other: Evaluation, metric: str) -> Estimate:
    """Estimate the mean difference of a metric, paired by episode."""
    pairs = zip(one.rows, other.rows, strict=True)
    return mean_estimate([mine[metric] - yours[metric] for mine, yours in pairs])
