"""Former public names of `bulletuav.tasks.families.*`. They warn and go with the next release."""

import sys
from dataclasses import dataclass
from types import ModuleType

from bulletuav.errors import former_names
from bulletuav.tasks.goal_flight import FlightConfig
from bulletuav.tasks.parts.airspace import AirspaceOptions


@dataclass(frozen=True)
class AirspaceConfig(AirspaceOptions, FlightConfig):
    """Options of flights to goals at an altitude, as tasks now join them by themselves."""


FORMER = {
    "airspace": {"Airspace": "bulletuav.tasks.goal_flight.GoalFlight"},
    "difficulties": {
        "AIRSPACE_DIFFICULTIES": "bulletuav.tasks.parts.difficulties.AIRSPACE_DIFFICULTIES"
    },
    "flight_config": {
        "AirspaceConfig": "bulletuav.tasks.families.AirspaceConfig",
        "circle_arena": "bulletuav.tasks.parts.airspace.circle_arena",
    },
    "formations": {"off_places": "bulletuav.tasks.parts.formations.off_places"},
}
"""Present names by former modules and names"""

# An import of a submodule finds these once this module is imported.
for _module, _names in FORMER.items():
    _former = ModuleType(f"{__name__}.{_module}", __doc__)
    _former.__getattr__ = former_names(_former.__name__, _names)  # type: ignore[method-assign]
    sys.modules[_former.__name__] = _former
