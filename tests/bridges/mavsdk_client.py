"""Fly a vehicle of MAVLink with MAVSDK 4, unmodified, as its users do.

    python mavsdk_client.py 14540

Needs a server that sends to this port.
"""

import sys
import time

from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.action import Action
from mavsdk.plugins.geofence import Circle, FenceType, Geofence, GeofenceData, Point
from mavsdk.plugins.mission import Mission, MissionItem, MissionPlan
from mavsdk.plugins.offboard import Offboard, PositionNedYaw, VelocityBodyYawspeed, VelocityNedYaw
from mavsdk.plugins.param import Param
from mavsdk.plugins.telemetry import FlightMode, LandedState, Telemetry

NAN = float("nan")
started = time.time()


def say(text):
    print(f"{time.time() - started:5.1f} s  {text}", flush=True)


def until(happens, seconds=40.0):
    end = time.time() + seconds
    while not happens():
        assert time.time() < end, "waited for too long"
        time.sleep(0.05)


def refused(call, *arguments):
    """Tell how a call was refused."""
    try:
        call(*arguments)
    except Exception as error:
        return str(error).splitlines()[0]
    raise AssertionError("this should have been refused")


port = sys.argv[1]
mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
drone = mavsdk.first_autopilot(10.0)
telemetry, action, offboard = Telemetry(drone), Action(drone), Offboard(drone)
mission, geofence, param = Mission(drone), Geofence(drone), Param(drone)
until(telemetry.health_all_ok)
say(f"connected to system {drone.get_system_id()}, all is well")
telemetry.set_rate_position_velocity_ned(50.0)
action.set_takeoff_altitude(3.0)
assert action.get_takeoff_altitude() == 3.0
param.set_param_int("GF_ACTION", 2)
assert param.get_param_int("GF_ACTION") == 2


def place():
    told = telemetry.position_velocity_ned().position
    return told.north_m, told.east_m, told.down_m


def near(wanted, tolerance):
    gap = max(abs(a - b) for a, b in zip(place(), wanted, strict=True))
    assert gap < tolerance, (place(), wanted)


action.arm()
action.takeoff()
until(lambda: telemetry.flight_mode() == FlightMode.HOLD and place()[2] < -2.5)
near((0, 0, -3), 0.2)
say("took off")
say(f"offboard without a setpoint: {refused(offboard.start)}")
offboard.set_position_ned(PositionNedYaw(4.0, 0.0, -4.0, 90.0))
offboard.start()
time.sleep(6.0)
near((4, 0, -4), 0.15)
offboard.set_velocity_ned(VelocityNedYaw(0.0, 1.0, 0.0, 90.0))
time.sleep(1.0)
offboard.set_velocity_body(VelocityBodyYawspeed(1.0, 0.0, 0.0, 0.0))
time.sleep(1.0)
assert abs(place()[0] - 4) < 0.3, place()
assert 1.0 < place()[1] < 2.5, place()
offboard.stop()
say(f"flew offboard, to {', '.join(f'{one:.1f}' for one in place())}")

home = telemetry.home()
spot = (home.latitude_deg, home.longitude_deg)
away = 1e-4  # deg: 11 m north
action.goto_location(*spot, home.absolute_altitude_m + 5, 0.0)
time.sleep(7.0)
near((0, 0, -5), 0.3)
say("flew to a location")


def plan(*places):
    rest = (NAN, NAN, 0, NAN, NAN, NAN, NAN, NAN, 0)
    items = [MissionItem(*one, 3.0, True, *rest) for one in places]
    return MissionPlan(items)


circle = Circle(Point(*spot), 30.0, FenceType.INCLUSION)
geofence.upload_geofence(GeofenceData([], [circle]))
outside = plan((spot[0] + 5 * away, spot[1], 5.0))
say(f"a mission outside the fence: {refused(mission.upload_mission, outside)}")
time.sleep(0.5)  # until MAVSDK has forgotten the upload
two = ((spot[0] + away, spot[1], 5.0), (spot[0] + away, spot[1] + away, 6.0))
mission.upload_mission(plan(*two))
assert len(mission.download_mission().mission_items) == 2
mission.start_mission()
until(mission.is_mission_finished)
until(lambda: telemetry.flight_mode() == FlightMode.HOLD)
assert abs(place()[0] - 11.1) < 0.5, place()
say("flew the mission")
action.set_return_to_launch_altitude(8.0)
action.return_to_launch()
until(lambda: telemetry.landed_state() == LandedState.ON_GROUND)
near((0, 0, 0), 0.3)
until(lambda: not telemetry.armed())
say("returned, landed, disarmed")
