"""Fly an aircraft with wings by MAVSDK 3 (gRPC), unmodified, as its users do.

    python mavsdk_wings_client.py 14540

Needs a server of a `trainer` or a `quadplane` that sends to this port. Times are simulated.
"""

import asyncio
import math
import sys

from mavsdk import System
from mavsdk.mission import MissionItem, MissionPlan
from mavsdk.telemetry import FlightMode, LandedState, VtolState

NAN = float("nan")
METRE = 180 / math.pi / 6371000
WAYPOINTS = ((200.0, 0.0, 30.0), (200.0, 200.0, 40.0), (0.0, 200.0, 35.0), (0.0, 50.0, 30.0))
"""North, east and height of the waypoints of the mission, m"""


async def first(stream, wanted=lambda value: True):
    """Wait for a value of telemetry."""
    async for value in stream:
        if wanted(value):
            return value


class Aircraft:
    def __init__(self, drone):
        self.drone = drone

    async def say(self, text):
        time = (await first(self.drone.telemetry.unix_epoch_time())) / 1e6
        north, east, down = await self.place()
        metrics = await first(self.drone.telemetry.fixedwing_metrics())
        print(
            f"{time:6.1f} s  {text} (at {north:.0f} m north, {east:.0f} m east, "
            f"{-down:.1f} m high, airspeed {metrics.airspeed_m_s:.1f} m/s)",
            flush=True,
        )

    async def place(self):
        found = (await first(self.drone.telemetry.position_velocity_ned())).position
        return found.north_m, found.east_m, found.down_m

    async def until_mode(self, mode):
        await first(self.drone.telemetry.flight_mode(), lambda found: found == mode)

    async def circle(self, north, east, samples):
        """Return the least and the greatest distance from a point."""
        distances, count = [], 0
        async for found in self.drone.telemetry.position_velocity_ned():
            place = found.position
            distances.append(math.hypot(place.north_m - north, place.east_m - east))
            count += 1
            if count == samples:
                return min(distances), max(distances)

    async def nearest(self, flown):
        """Return the least distance to each waypoint until an event."""
        least = [math.inf] * len(WAYPOINTS)
        async for found in self.drone.telemetry.position_velocity_ned():
            place = found.position
            for k, (north, east, _) in enumerate(WAYPOINTS):
                distance = math.hypot(place.north_m - north, place.east_m - east)
                least[k] = min(least[k], distance)
            if flown.is_set():
                return least


def item(home, north, east, height):
    latitude = home.latitude_deg + north * METRE
    longitude = home.longitude_deg + east * METRE / math.cos(math.radians(home.latitude_deg))
    rest = (NAN, NAN, MissionItem.CameraAction.NONE, NAN, NAN, NAN, NAN, NAN)
    return MissionItem(
        latitude, longitude, height, NAN, True, *rest, MissionItem.VehicleAction.NONE
    )


async def fly(port):
    drone = System(port=port + 40000)
    await drone.connect(system_address=f"udpin://127.0.0.1:{port}")
    await first(drone.core.connection_state(), lambda state: state.is_connected)
    await first(drone.telemetry.health_all_ok(), bool)
    aircraft = Aircraft(drone)
    await drone.telemetry.set_rate_position_velocity_ned(20)
    await drone.telemetry.set_rate_fixedwing_metrics(20)
    state = await first(drone.telemetry.vtol_state())
    is_vtol = state != VtolState.UNDEFINED
    home = await first(drone.telemetry.home())
    await drone.action.set_takeoff_altitude(30.0)
    await aircraft.say("VTOL" if is_vtol else "fixed wing")
    await drone.action.arm()
    await drone.action.takeoff()
    await aircraft.until_mode(FlightMode.TAKEOFF)
    await aircraft.until_mode(FlightMode.HOLD)
    await aircraft.say("took off")
    if is_vtol:
        await drone.action.transition_to_fixedwing()
        await first(drone.telemetry.vtol_state(), lambda found: found == VtolState.FW)
        await aircraft.say("flies on its wings")

    await drone.mission.upload_mission(MissionPlan([item(home, *one) for one in WAYPOINTS]))
    assert len((await drone.mission.download_mission()).mission_items) == len(WAYPOINTS)
    await drone.mission.start_mission()
    flown = asyncio.Event()
    nearest = asyncio.create_task(aircraft.nearest(flown))
    async for progress in drone.mission.mission_progress():
        await aircraft.say(f"mission {progress.current} of {progress.total}")
        if progress.current == progress.total:
            break
    flown.set()
    least = await nearest
    print(f"least distances to the waypoints: {', '.join(f'{one:.1f}' for one in least)} m")
    assert max(least) < 10.5
    await aircraft.until_mode(FlightMode.HOLD)
    await aircraft.say("loiters after the mission")

    height = home.absolute_altitude_m + 45.0
    await drone.action.set_current_speed(14.0)
    goal = item(home, 0.0, 100.0, 45.0)
    await drone.action.goto_location(goal.latitude_deg, goal.longitude_deg, height, NAN)
    await first(
        drone.telemetry.position(), lambda found: abs(found.relative_altitude_m - 45.0) < 1.0
    )
    await aircraft.circle(0.0, 100.0, 300)
    low, high = await aircraft.circle(0.0, 100.0, 400)
    await aircraft.say(f"loiters {low:.1f} to {high:.1f} m from the place it went to")
    assert high - low < 3.0
    metrics = await first(drone.telemetry.fixedwing_metrics())
    assert abs(metrics.airspeed_m_s - 14.0) < 1.0

    if is_vtol:
        await drone.action.transition_to_multicopter()
        await first(drone.telemetry.vtol_state(), lambda found: found == VtolState.MC)
        await aircraft.say("flies on its rotors")
        await drone.action.transition_to_fixedwing()
        await first(drone.telemetry.vtol_state(), lambda found: found == VtolState.FW)
    await drone.action.return_to_launch()
    await aircraft.until_mode(FlightMode.RETURN_TO_LAUNCH)
    if not is_vtol:
        await first(
            drone.telemetry.position(), lambda found: abs(found.relative_altitude_m - 30.0) < 1.5
        )
        await aircraft.say("circles home")
        await drone.action.land()
    await first(drone.telemetry.landed_state(), lambda found: found == LandedState.ON_GROUND)
    await aircraft.say("landed")
    await first(drone.telemetry.armed(), lambda is_armed: not is_armed)
    await aircraft.say("disarmed")
    print("flew")


asyncio.run(fly(int(sys.argv[1])))
