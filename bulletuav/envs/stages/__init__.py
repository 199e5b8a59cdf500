"""Stages of a decision, and of a step of an airspace, in their order."""

from bulletuav.envs.stages.admit import Admit
from bulletuav.envs.stages.airspace import CountStep, FlyCommands, MeasureAll, MoveAndTurn, ShowLive
from bulletuav.envs.stages.base import Stage
from bulletuav.envs.stages.energy import DrainBatteries
from bulletuav.envs.stages.events import ApplyEvents
from bulletuav.envs.stages.fly import Fly
from bulletuav.envs.stages.hold import HoldActions
from bulletuav.envs.stages.judge import Judge
from bulletuav.envs.stages.keep_before import KeepBefore
from bulletuav.envs.stages.leave import EndEpisodes
from bulletuav.envs.stages.move_scene import MoveScene
from bulletuav.envs.stages.observe import Observe
from bulletuav.envs.stages.remember import Remember
from bulletuav.envs.stages.report import WriteInfos
from bulletuav.envs.stages.respawn import Respawn
from bulletuav.envs.stages.reward import Reward
from bulletuav.envs.stages.sense import Sense
from bulletuav.envs.stages.separate import Separate
from bulletuav.envs.stages.setpoints import MakeSetpoints
from bulletuav.envs.stages.wind import SampleWind

__all__ = ["Stage", "airspace_stages", "decision_stages"]


def decision_stages(has_events: bool = False, has_rates: bool = False) -> tuple[Stage, ...]:
    """Return the stages of a decision; the options `events` and `decision_every` add one each."""
    return (
        *((HoldActions(),) if has_rates else ()),
        Admit(),
        Respawn(),
        *((ApplyEvents(),) if has_events else ()),
        SampleWind(),
        KeepBefore(),
        MoveScene(),
        MakeSetpoints(),
        Fly(),
        DrainBatteries(),
        Sense(),
        Separate(),
        Remember(),
        Judge(),
        EndEpisodes(),
        Observe(),
        Reward(),
        WriteInfos(),
    )


def airspace_stages() -> tuple[Stage, ...]:
    """Return the stages of a step of an airspace."""
    return (SampleWind(), MoveAndTurn(), FlyCommands(), CountStep(), MeasureAll(), ShowLive())
