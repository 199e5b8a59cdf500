"""One MAVLink vehicle: who flies it, its parameters, its missions and its fence."""

from collections.abc import Callable

from bulletuav.bridges.mavlink_coordinates import Site
from bulletuav.bridges.mavlink_fence import Geofence, MissionItem
from bulletuav.bridges.mavlink_items import check_mission
from bulletuav.bridges.mavlink_missions import MISSION, MissionService
from bulletuav.bridges.mavlink_parameters import MavlinkParameterService
from bulletuav.bridges.mavlink_pilot import Pilot
from bulletuav.vehicle.airframe import STANDARD_GRAVITY, Airframe


class MavlinkVehicle:
    """One vehicle, without its body and without messages.

    Attributes:
        system: Number of the system, from 1 on.
        airframe: Of its body.
        site: Where its coordinates begin.
        parameters: Its parameters.
        pilot: Who flies it.
        missions: Lists of items.
        locate: Function that tells latitude and longitude, deg, and altitude, m; then the
            attitude w, x, y, z, from forward, right, down to north, east, down.
    """

    def __init__(
        self, system_id: int, airframe: Airframe, site: Site, locate: Callable[[], list[float]]
    ) -> None:
        """Switch it on, on the ground, disarmed.

        Args:
            system: Number of the system.
            airframe: Of its body.
            site: Where it starts.
            locate: Function that tells where it is on the Earth, see `locate`.
        """
        self.system_id, self.airframe, self.site, self.locate = system_id, airframe, site, locate
        hover = airframe.mass * STANDARD_GRAVITY / airframe.max_thrust
        self.parameters = MavlinkParameterService(MAV_SYS_ID=system_id, MPC_THR_HOVER=hover)
        self._fence = Geofence(site, self.parameters.values)
        self.pilot = Pilot(airframe, site, self.parameters, self._fence)
        self.missions = MissionService(self._check, self._fence, self._start_motion)

    def _check(self, items: tuple[MissionItem, ...]) -> None:
        """Check a mission that was uploaded."""
        check_mission(items, self.site, self._fence, self.parameters.values["MIS_DIST_1WP"])

    def _start_motion(self) -> None:
        """Give the pilot another mission; one that flies the old one holds."""
        self.pilot.set_mission(self.missions.lists[MISSION])

    @property
    def time_boot_ms(self) -> int:
        """Time since the start, ms."""
        return round(self.pilot.now * 1000)
