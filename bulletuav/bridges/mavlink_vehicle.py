"""One MAVLink vehicle: pilot, parameters, missions and geofence."""

from collections.abc import Callable, Sequence

import numpy as np

from bulletuav.bridges.mavlink_coordinates import Site
from bulletuav.bridges.mavlink_failures import Failures
from bulletuav.bridges.mavlink_fence import Geofence, MissionItem
from bulletuav.bridges.mavlink_gimbal import Gimbal
from bulletuav.bridges.mavlink_missions import MISSION, MissionService
from bulletuav.bridges.mavlink_parameters import MavlinkParameterService, wing_parameters
from bulletuav.bridges.mavlink_pilot import Pilot
from bulletuav.bridges.mavlink_shell import Shell
from bulletuav.bridges.mavlink_wings import WingFlight
from bulletuav.vehicle.airframe import STANDARD_GRAVITY, Airframe


class MavlinkVehicle:
    """Autopilot of one vehicle, without its body and without message handling.

    Attributes:
        system_id: System ID, from 1 on.
        airframe: Airframe of the body.
        site: Start position, which is home.
        parameters: Parameters.
        pilot: Arming, flight modes and motions.
        shell: Shell.
        gimbal: Gimbal.
        wings: Flight on wings; None for a multirotor.
        throttle: Speed of the forward rotors relative to the maximum, from 0 to 1.
        acceleration: (3,) mean acceleration over the last step, m/s^2.
        missions: Mission, geofence and rally points.
        locate: Function that returns latitude and longitude (deg), altitude (m), and the attitude
            w, x, y, z from FRD body axes to NED.
    """

    def __init__(
        self,
        system_id: int,
        airframe: Airframe,
        site: Site,
        locate: Callable[[], list[float]],
        set_rotors: Callable[[Sequence[float]], None],
        row: np.record | None = None,
        get_wind: Callable[[], Sequence[float]] = lambda: (0.0, 0.0, 0.0),
    ) -> None:
        """Initialise on the ground, disarmed.

        Args:
            system_id: System ID.
            airframe: Airframe of the body.
            site: Start position.
            locate: Function that returns the geodetic pose, see the attribute `locate`.
            set_rotors: Function that sets the effectiveness (R,) of the rotors, from 0 to 1.
            row: Row of `AUTOPILOT` of an aircraft with wings; None for a multirotor.
            get_wind: Function that returns the velocity of the air at the vehicle, (3,), m/s.
        """
        self.system_id, self.airframe, self.site, self.locate = system_id, airframe, site, locate
        changed: dict[str, float] = {"MAV_SYS_ID": system_id}
        if airframe.can_hover:
            changed["MPC_THR_HOVER"] = airframe.mass * STANDARD_GRAVITY / airframe.max_thrust
        if row is not None:
            changed |= wing_parameters(airframe, row)
        self.parameters = MavlinkParameterService(**changed)
        values = self.parameters.values
        self.wings = None if row is None else WingFlight(airframe, row, values, get_wind)
        self.throttle = 0.0
        self._fence = Geofence(site, self.parameters.values)
        failures = Failures(airframe, self.parameters.values, set_rotors)
        self.pilot = Pilot(airframe, site, self.parameters, self._fence, failures, self.wings)
        self.shell, self.gimbal = Shell(self.parameters.values), Gimbal()
        self.acceleration = [0.0] * 3
        self.missions = MissionService(
            self._check_mission, self._fence, self._set_rally_points, self._update_mission
        )

    def _check_mission(self, items: tuple[MissionItem, ...]) -> None:
        """Validate an uploaded mission."""
        self.pilot.check_mission(items)

    def _set_rally_points(self, items: tuple[MissionItem, ...]) -> None:
        """Pass uploaded rally points to the pilot."""
        points = [self.site.from_global(item.frame, item.x, item.y, item.z) for item in items]
        for point in points:
            self._fence.require_inside("rally point is", point)
        self.pilot.rally_points = points

    def _update_mission(self) -> None:
        """Pass the changed mission to the pilot."""
        self.pilot.set_mission(self.missions.lists[MISSION])

    @property
    def time_boot_ms(self) -> int:
        """Time since the start, ms."""
        return round(self.pilot.now * 1000)
