"""Missions of ground stations are read, flown, and reported where they are not."""

import json
import math
import re

import numpy as np
import pytest

from bulletuav.bridges.mission_files import NO_CHANGE, read_mission
from bulletuav.bridges.mission_flight import MissionFlight
from bulletuav.cli import main

LATITUDE, LONGITUDE = 47.397742, 8.545594
NORTH, EAST = 1 / 111173.4, 1 / 75498.0
"""Degrees a metre there: meridian 111,173.4 m and parallel 75,498 m a degree (WGS 84)"""


def place(east, north):
    return LATITUDE + north * NORTH, LONGITUDE + east * EAST


def simple(command, params, frame=3, jump_id=None):
    """An item as QGroundControl saves it."""
    item = {"type": "SimpleItem", "command": command, "frame": frame, "autoContinue": True}
    return item | {"params": params, "doJumpId": jump_id}


def waypoint(east, north, height, wait=0):
    return simple(16, [wait, 0, 0, None, *place(east, north), height])


TAKE_OFF = simple(22, [0, 0, 0, None, LATITUDE, LONGITUDE, 2])
LAND = simple(21, [0, 0, 0, None, 0, 0, 0])
RETURN = simple(20, [0] * 7, 2)


def plan(*items, fence=None, **mission):
    mission = {"plannedHomePosition": [LATITUDE, LONGITUDE, 488], "hoverSpeed": 3} | mission
    whole = {"fileType": "Plan", "version": 1, "groundStation": "QGroundControl"}
    return whole | {"mission": {"version": 2, "items": list(items), **mission}, "geoFence": fence}


@pytest.fixture
def save(tmp_path):
    def write(content, name="mission.plan"):
        path = tmp_path / name
        path.write_text(content if isinstance(content, str) else json.dumps(content))
        return path

    return write


def fly(mission, **options):
    with MissionFlight(mission, dynamics="rigid_body", **options) as flight:
        flight.fly()
    return flight


# Reading


def test_plan_becomes_items_and_waypoints(save):
    mission = read_mission(save(plan(TAKE_OFF, waypoint(10, 20, 5, 3), LAND)))
    assert [item.command for item in mission.items] == [22, 16, 21]
    assert mission.home == (LATITUDE, LONGITUDE, 488)
    assert mission.speed == 3
    assert mission.items[1].params[0] == 3
    assert math.isnan(mission.items[1].params[3])
    expected = [[0, 0, 2], [10, 20, 5], [10, 20, 0]]
    np.testing.assert_allclose(mission.waypoints(), expected, atol=0.02)
    assert mission.notes == ()


SURVEY = {
    "type": "ComplexItem",
    "complexItemType": "survey",
    "version": 5,
    "angle": 0,
    "polygon": [place(0, 0), place(9, 0), place(9, 9)],
    "TransectStyleComplexItem": {
        "version": 2,
        "CameraShots": 14,
        "Items": [
            waypoint(3, 3, 4),
            simple(206, [2, 0, 1, 0, 0, 0, 0], 2),
            waypoint(3, 6, 4),
            simple(206, [0, 0, 1, 0, 0, 0, 0], 2),
        ],
    },
}


def test_surveys_are_flown_by_their_stored_items(save):
    mission = read_mission(save(plan(TAKE_OFF, SURVEY, RETURN)))
    assert [item.command for item in mission.items if item is not NO_CHANGE] == [22, 16, 16, 20]
    np.testing.assert_allclose(mission.waypoints()[1:], [[3, 3, 4], [3, 6, 4]], atol=0.01)
    camera = "command 206 (DO_SET_CAM_TRIGG_DIST) is not flown"
    assert mission.notes == (f"item 2: {camera}", f"item 4: {camera}")


def test_what_is_not_flown_is_listed(save):
    scan = {"type": "ComplexItem", "complexItemType": "StructureScan", "layers": 3}
    loiter = simple(18, [3, 0, 20, None, *place(5, 0), 4])
    terrain = simple(16, [0, 0, 0, None, *place(5, 0), 4], frame=10)
    content = plan(scan, loiter, terrain, simple(201, [0] * 7, 3), simple(31999, [0] * 7, 2))
    content["rallyPoints"] = {"points": [[LATITUDE, LONGITUDE, 10]], "version": 2}
    content["geoFence"] = {"breachReturn": [LATITUDE, LONGITUDE, 10]}
    mission = read_mission(save(content))
    assert [note.split(":")[0] for note in mission.notes] == [
        *(f"item {k}" for k in range(5)),
        "geofence",
        "1 rally points are not used",
    ]
    assert "'StructureScan' has no stored items" in mission.notes[0]
    assert "without circles" in mission.notes[1]
    assert mission.items[1].params[0] == 0
    assert mission.items[2].frame == 3
    assert "command 201 (DO_SET_ROI)" in mission.notes[3]
    assert "command 31999 (unknown)" in mission.notes[4]


def test_jumps_go_to_the_item_of_an_identifier(save):
    items = [TAKE_OFF | {"doJumpId": 1}, SURVEY, simple(177, [9, 2, 0, 0, 0, 0, 0], 2)]
    mission = read_mission(save(plan(*items, waypoint(1, 1, 2) | {"doJumpId": 9})))
    assert mission.items[5].params[:2] == (6, 2)


def rows(*lines):
    return "\n".join(["QGC WPL 110", *("\t".join(map(str, line)) for line in lines), ""])


HOME_ROW = (0, 1, 0, 16, 0, 0, 0, 0, LATITUDE, LONGITUDE, 488, 1)


def test_waypoint_files_have_home_as_item_0(save):
    text = rows(
        HOME_ROW,
        (1, 0, 3, 22, 0, 0, 0, 0, 0, 0, "2.000000", 1),
        (2, 0, 3, 16, "1.5", 0, 0, 0, *place(3, 4), 2, 1),
        (3, 0, 3, 20, 0, 0, 0, 0, 0, 0, 0, 1),
    )
    mission = read_mission(save(text.replace("\n", "\r\n"), "field.waypoints"))
    assert mission.home == (LATITUDE, LONGITUDE, 488)
    assert mission.speed is None
    assert [item.command for item in mission.items[1:]] == [22, 16, 20]
    np.testing.assert_allclose(mission.waypoints(), [[0, 0, 2], [3, 4, 2]], atol=0.01)


def test_given_home_replaces_that_of_the_file(save):
    path = save(plan(waypoint(0, 0, 5)))
    moved = read_mission(path, home=(*place(0, -30), 0))
    np.testing.assert_allclose(moved.waypoints(), [[0, 30, 5]], atol=0.03)


PLAIN = plan(waypoint(1, 1, 2))
BROKEN = {
    "": "begins with ''",
    "t,x,y,z\n1,2,3,4\n": "neither a plan",
    '{"fileType": "Plan", "mission": {': "not valid JSON",
    '{"a":' * 3000 + "1" + "}" * 3000: "nested more than",
    "{}": "fileType is None",
    json.dumps(PLAIN | {"mission": [1]}): "mission is [1]",
    json.dumps(PLAIN | {"version": 2}): "version of the plan is 2: 1 is needed",
    json.dumps(plan(waypoint(1, 1, 2), version=3)): "version of the mission is 3",
    json.dumps(plan(*[waypoint(1, 1, 2) | {"doJumpId": 1}] * 2, simple(177, [1] * 7))): "2 items",
    json.dumps(PLAIN | {"geoFence": [1]}): "geoFence is [1]",
    json.dumps(plan()): "no item can be flown (it has no items)",
    json.dumps(plan(simple(206, [0] * 7))): "no item can be flown (item 0: command 206",
    json.dumps(plan(7)): "item 0 is 7",
    json.dumps(plan({})): "command of item 0 is None",
    json.dumps(plan(simple(16, [0] * 6))): "params of item 0",
    json.dumps(plan(simple(16, [math.nan] * 7))): "parameter 1 of item 0 is nan",
    json.dumps(plan(simple(16, [0] * 7, frame=1))): "item 0 has frame 1",
    json.dumps(plan(simple(16.5, [0] * 7))): "command of item 0 is 16.5",
    json.dumps(plan(simple(177, [5, 1, 0, 0, 0, 0, 0]))): "jumps to doJumpId 5, which 0 items have",
    json.dumps(plan({"type": "ComplexItem", "Items": [SURVEY]})): "are not simple items",
    json.dumps(plan(*[RETURN] * 10_001)): "more than 10000 items",
    json.dumps(plan(waypoint(1, 1, 2), plannedHomePosition=None)): "--home",
    json.dumps(plan(waypoint(1, 1, 2), plannedHomePosition=[91, 0, 0])): "latitude of planned",
    json.dumps(plan(waypoint(1, 1, 2), hoverSpeed=-1)): "hoverSpeed is -1",
    json.dumps(plan(waypoint(1, 1, 2), fence={"polygons": [{"polygon": [[0, 0]]}]})): "1 points",
    json.dumps(plan(waypoint(1, 1, 2), fence={"circles": [{"circle": 3}]})): "circle is 3",
    "QGC WPL 120\n": "version 110",
    rows((0, 1, 0, 16)): "line 2 has 4 columns",
    rows((0, 1, 0, "x", *[0] * 8)): "line 2",
    rows(HOME_ROW, (7, 0, 3, 16, *[0] * 8)): "line 3 has the index 7: 1 is next",
    rows((0, 1, 3, 16, *[0] * 4, *place(1, 1), 2, 1)): "--home",
}


@pytest.mark.parametrize("text", BROKEN)
def test_broken_files_give_one_error(save, text):
    path = save(text)
    with pytest.raises(ValueError, match=re.escape(BROKEN[text])) as caught:
        read_mission(path)
    assert str(path) in str(caught.value)


def test_large_and_missing_files_and_bytes(tmp_path):
    path = tmp_path / "large.plan"
    path.write_bytes(b"{" + b" " * 10_000_000)
    with pytest.raises(ValueError, match="10000001 bytes"):
        read_mission(path)
    path.write_bytes(b"\xff\x00")
    with pytest.raises(ValueError, match="UTF-8"):
        read_mission(path)
    with pytest.raises(FileNotFoundError, match="no mission file"):
        read_mission(tmp_path / "none.plan")


# Flying


def test_mission_is_flown_with_speed_wait_jump_and_landing(save):
    mission = read_mission(
        save(
            plan(
                TAKE_OFF,
                waypoint(4, 0, 2, 2),
                waypoint(4, 6, 2) | {"doJumpId": 3},
                waypoint(4, 0, 2),
                simple(177, [3, 1, 0, 0, 0, 0, 0], 2),
                simple(178, [1, 1, -1, 0, 0, 0, 0], 2),
                waypoint(4, 6, 2),
                LAND,
            )
        )
    )
    flight = fly(mission)
    assert flight.outcome == "disarmed after landing"
    assert [one.number for one in flight.reached] == [0, 1, 2, 3, 4, 2, 3, 4, 5, 6, 7]
    assert max(one.distance for one in flight.reached if one.number in (1, 2, 3, 6)) < 0.15
    times = {one.number: one.time for one in flight.reached}
    # 6 m with 2 m/s^2 and at most 3 or 1 m/s take 6 / v + v / 2 seconds
    assert times[3] - times[2] == pytest.approx(6 / 3 + 3 / 2, abs=0.2)
    assert times[6] - times[5] == pytest.approx(6 / 1 + 1 / 2, abs=0.2)
    # 4 m there take 4 / 2.83 * 2 s, as the speed is not reached, and then it waits 2 s
    assert times[1] - times[0] == pytest.approx(2 * math.sqrt(2) + 2, abs=0.3)
    np.testing.assert_allclose(flight.airspace.swarm.position[0, :2], (4, 6), atol=0.15)


def test_breach_of_the_fence_stops_the_mission(save):
    circle = {"center": place(5, 0), "radius": 2}
    fence = {"circles": [{"circle": circle, "inclusion": False, "version": 1}], "polygons": []}
    flight = fly(read_mission(save(plan(TAKE_OFF, waypoint(10, 0, 2), LAND, fence=fence))))
    assert flight.outcome == "mission stopped: vehicle is in an exclusion area of the fence"
    assert flight.airspace.swarm.position[0, 0] == pytest.approx(3, abs=0.2)
    assert [text for _, text in flight.texts] == ["vehicle is in an exclusion area of the fence"]


def test_item_outside_the_fence_is_an_error(save):
    square = [place(-9, -9), place(9, -9), place(9, 9), place(-9, 9)]
    fence = {"polygons": [{"polygon": square, "inclusion": True, "version": 1}]}
    path = save(plan(TAKE_OFF, waypoint(20, 0, 2), fence=fence))
    with pytest.raises(ValueError, match="item 1 is outside the fence") as caught:
        fly(read_mission(path))
    assert str(path) in str(caught.value)


def test_loops_without_motion_and_endless_loops_end(save):
    loop = simple(177, [1, -1, 0, 0, 0, 0, 0], 2, 1)
    flight = fly(read_mission(save(plan(loop, simple(22, [0, 0, 0, None, 0, 0, 1])))))
    assert flight.outcome == "mission complete: holds at its last item"
    there = waypoint(2, 0, 1) | {"doJumpId": 1}
    endless = plan(there, waypoint(0, 0, 1), loop | {"doJumpId": 3})
    flight = fly(read_mission(save(endless)), max_duration=20)
    assert flight.outcome.startswith("flight ended after 20 s, at item")
    assert sum(one.number == 2 for one in flight.reached) > 1


def test_unlimited_loiter_ends_the_flight(save):
    flight = fly(read_mission(save(plan(TAKE_OFF, simple(17, [0, 0, 0, None, *place(3, 0), 2])))))
    assert flight.outcome == "mission complete: loiters at item 1"


def test_command_flies_and_reports(save, tmp_path, capsys):
    path, out = save(plan(TAKE_OFF, simple(206, [0] * 7, 2), waypoint(3, 0, 2))), tmp_path / "out"
    options = ["--dynamics", "rigid_body", "--speed", "1", "--wind", "1", "0", "0"]
    main(["fly", "--mission", str(path), *options, "--html", "--out", str(out)])
    printed = capsys.readouterr().out
    assert "item 1: command 206 (DO_SET_CAM_TRIGG_DIST) is not flown" in printed
    assert "outcome: mission complete: holds at its last item" in printed
    report = json.loads((out / "mission.json").read_text())
    assert [one["item"] for one in report["reached"]] == [0, 2]
    assert len(report["notes"]) == 1
    assert (out / "mission.png").stat().st_size > 5000
    assert (out / "replay.html").stat().st_size > 50_000
    with np.load(out / "trajectory.npz") as recorded:
        assert recorded["position"][-1, 0, 0] == pytest.approx(3, abs=0.4)
    lines = (out / "flight.csv").read_text().splitlines()
    assert lines[0] == "t,x,y,z,qx,qy,qz,qw,vx,vy,vz,p,q,r,w1,w2,w3,w4"
    assert float(lines[-1].split(",")[1]) == pytest.approx(3, abs=0.4)
    main(["verify", str(out)])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "Give either a task"),
        (["hover", "--speed", "3"], "--speed and --home apply to missions"),
        (["hover", "--mission", "x.plan"], "task has no effect on a mission"),
        (["--mission", "x.plan", "--live"], "live has no effect on a mission"),
        (["--mission", "x.plan", "--drones", "3"], "--drones has no effect on a mission"),
        (["--mission", "x.plan", "--animation", "gif"], "--animation has no effect"),
        (["--mission", "x.plan", "--seed", "-1"], "seed is -1"),
    ],
)
def test_options_without_an_effect_are_errors(words, message, capsys):
    with pytest.raises(SystemExit):
        main(["fly", *words])
    assert message in capsys.readouterr().err


def test_altitudes_above_terrain_that_a_plan_leaves_empty(save):
    item = waypoint(10, 20, None) | {"frame": 0, "AltitudeMode": 3, "Altitude": 8}
    mission = read_mission(save(plan(TAKE_OFF, item, LAND)))
    np.testing.assert_allclose(mission.waypoints()[1], [10, 20, 8], atol=0.02)
    assert mission.notes == ("item 1: altitude above terrain is taken above home",)


@pytest.mark.parametrize(("column", "name"), [(4, "latitude"), (5, "longitude"), (6, "altitude")])
def test_places_that_a_waypoint_lacks_are_named(save, column, name):
    item = waypoint(10, 20, 5)
    item["params"][column] = None
    with pytest.raises(ValueError, match=f"item 1: its {name} is missing"):
        read_mission(save(plan(TAKE_OFF, item)))


def test_rally_points_that_are_no_list(save):
    content = plan(TAKE_OFF, waypoint(10, 20, 5)) | {"rallyPoints": {"points": 5}}
    with pytest.raises(ValueError, match="points of rallyPoints is 5: a list is needed"):
        read_mission(save(content))
