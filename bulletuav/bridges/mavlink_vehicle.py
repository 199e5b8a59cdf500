"""One MAVLink vehicle: pilot, parameters, missions and geofence."""

from collections.abc import Callable

from bulletuav.bridges.mavlink_coordinates import Site
from bulletuav.bridges.mavlink_fence import Geofence, MissionItem
from bulletuav.bridges.mavlink_items import check_mission
from bulletuav.bridges.mavlink_missions import MISSION, MissionService
from bulletuav.bridges.mavlink_parameters import MavlinkParameterService
from bulletuav.bridges.mavlink_pilot import Pilot
from bulletuav.vehicle.airframe import STANDARD_GRAVITY, Airframe


class MavlinkVehicle:
    """Autopilot of one vehicle, without its body and without message handling.

    Attributes:
        system_id: System ID, from 1 on.
        airframe: Airframe of the body.
        site: Start position, which is home.
        parameters: Parameters.
        pilot: Arming, flight modes and motions.
        missions: Mission and geofence lists.
        locate: Function that returns latitude and longitude (deg), altitude (m), and the attitude
            w, x, y, z from FRD body axes to NED.
    """

    def __init__(
        self, system_id: int, airframe: Airframe, site: Site, locate: Callable[[], list[float]]
    ) -> None:
        """Initialise on the ground, disarmed.

        Args:
            system_id: System ID.
            airframe: Airframe of the body.
            site: Start position.
            locate: Function that returns the geodetic pose, see the attribute `locate`.
        """
        self.system_id, self.airframe, self.site, self.locate = system_id, airframe, site, locate
        hover = airframe.mass * STANDARD_GRAVITY / airframe.max_thrust
        self.parameters = MavlinkParameterService(MAV_SYS_ID=system_id, MPC_THR_HOVER=hover)
        self._fence = Geofence(site, self.parameters.values)
        self.pilot = Pilot(airframe, site, self.parameters, self._fence)
        self.missions = MissionService(self._check_mission, self._fence, self._update_mission)

    def _check_mission(self, items: tuple[MissionItem, ...]) -> None:
        """Validate an uploaded mission."""
        check_mission(items, self.site, self._fence, self.parameters.values["MIS_DIST_1WP"])

    def _update_mission(self) -> None:
        """Pass the changed mission to the pilot."""
        self.pilot.set_mission(self.missions.lists[MISSION])

    @property
    def time_boot_ms(self) -> int:
        """Time since the start, ms."""
        return round(self.pilot.now * 1000)
