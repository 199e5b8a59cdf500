"""Fly vehicles of MAVLink with MAVSDK 3 (gRPC), unmodified, as its users do.

    python mavsdk_grpc_client.py 14540 14541

Needs a server of as many vehicles that sends to these ports. They fly at the same time.
"""

import asyncio
import sys
import time

from mavsdk import System
from mavsdk.geofence import Circle, FenceType, GeofenceData, Point
from mavsdk.mission import MissionItem, MissionPlan
from mavsdk.offboard import Attitude, OffboardError, PositionNedYaw, VelocityBodyYawspeed
from mavsdk.telemetry import FlightMode, LandedState

NAN = float("nan")
started = time.time()


def say(port, text):
    print(f"{time.time() - started:5.1f} s  {port}: {text}", flush=True)


async def first(stream, wanted=lambda value: True):
    """Wait for something that telemetry tells."""
    async for value in stream:
        if wanted(value):
            return value


async def place(drone):
    told = (await first(drone.telemetry.position_velocity_ned())).position
    return told.north_m, told.east_m, told.down_m


async def near(drone, wanted, tolerance):
    found = await place(drone)
    gap = max(abs(a - b) for a, b in zip(found, wanted, strict=True))
    assert gap < tolerance, (found, wanted)


def item(latitude, longitude, height, speed=3.0):
    rest = (NAN, NAN, MissionItem.CameraAction.NONE, NAN, NAN, NAN, NAN, NAN)
    return MissionItem(
        latitude, longitude, height, speed, True, *rest, MissionItem.VehicleAction.NONE
    )


async def fly(port):
    drone = System(port=port + 40000)
    await drone.connect(system_address=f"udpin://127.0.0.1:{port}")
    await first(drone.core.connection_state(), lambda state: state.is_connected)
    await first(drone.telemetry.health_all_ok(), bool)
    say(port, "connected, all is well")
    version = await drone.info.get_version()
    say(port, f"flight stack {version.flight_sw_major}.{version.flight_sw_minor}")
    await drone.telemetry.set_rate_position_velocity_ned(50)
    await drone.action.set_takeoff_altitude(3.0)
    assert await drone.action.get_takeoff_altitude() == 3.0
    parameters = await drone.param.get_all_params()
    say(port, f"{len(parameters.float_params) + len(parameters.int_params)} parameters")

    await drone.action.arm()
    await drone.action.takeoff()
    await first(drone.telemetry.flight_mode(), lambda mode: mode == FlightMode.HOLD)
    await near(drone, (0, 0, -3), 0.2)
    say(port, "took off")
    try:
        await drone.offboard.start()
        raise AssertionError("offboard without a setpoint")
    except OffboardError:
        pass
    await drone.offboard.set_position_ned(PositionNedYaw(4.0, 0.0, -4.0, 90.0))
    await drone.offboard.start()
    await asyncio.sleep(6)
    await near(drone, (4, 0, -4), 0.15)
    await drone.offboard.set_velocity_body(VelocityBodyYawspeed(1.0, 0.0, 0.0, 0.0))
    await asyncio.sleep(2.0)
    north, east, down = await place(drone)
    assert abs(north - 4) < 0.2, north
    assert 1.0 < east < 2.2, east
    await drone.offboard.set_attitude(Attitude(0.0, 0.0, 90.0, await hover(drone)))
    await asyncio.sleep(1.0)
    assert abs((await place(drone))[2] - down) < 0.5
    await drone.offboard.stop()
    say(port, f"flew offboard, to {north:.1f}, {east:.1f}, {down:.1f}")

    home = await first(drone.telemetry.home())
    spot = (home.latitude_deg, home.longitude_deg)
    away = 1e-4  # deg: 11 m north
    await drone.action.goto_location(*spot, home.absolute_altitude_m + 5, 0.0)
    await asyncio.sleep(6)
    await near(drone, (0, 0, -5), 0.3)
    say(port, "flew to a location")
    circle = Circle(Point(*spot), 30.0, FenceType.INCLUSION)
    await drone.geofence.upload_geofence(GeofenceData([], [circle]))
    await drone.mission.set_return_to_launch_after_mission(False)
    outside = MissionPlan([item(spot[0] + 5 * away, spot[1], 5.0)])
    try:
        await drone.mission.upload_mission(outside)
        raise AssertionError("a mission outside the fence")
    except Exception as error:
        say(port, f"a mission outside the fence: {str(error).partition(chr(59))[0]}")
    await asyncio.sleep(0.5)  # until MAVSDK has forgotten the upload
    plan = [item(spot[0] + away, spot[1], 5.0), item(spot[0] + away, spot[1] + away, 6.0)]
    await drone.mission.upload_mission(MissionPlan(plan))
    assert len((await drone.mission.download_mission()).mission_items) == 2
    await drone.mission.start_mission()
    async for progress in drone.mission.mission_progress():
        say(port, f"mission {progress.current} of {progress.total}")
        if progress.current == progress.total:
            break
    assert await drone.mission.is_mission_finished()
    await first(drone.telemetry.flight_mode(), lambda mode: mode == FlightMode.HOLD)
    assert abs((await place(drone))[0] - 11.1) < 0.5

    await drone.action.set_return_to_launch_altitude(8.0)
    await drone.action.return_to_launch()
    await first(drone.telemetry.landed_state(), lambda state: state == LandedState.ON_GROUND)
    await near(drone, (0, 0, 0), 0.3)
    await first(drone.telemetry.armed(), lambda armed: not armed)
    say(port, "returned, landed, disarmed")


async def hover(drone):
    return await drone.param.get_param_float("MPC_THR_HOVER")


async def main():
    await asyncio.gather(*(fly(int(port)) for port in sys.argv[1:]))
    print("all flew")


asyncio.run(main())
