"""Fly virtual Crazyflies with cflib, unmodified, as its users do.

python cflib_client.py udp://127.0.0.1:19850 udp://127.0.0.1:19851 ...
"""

import sys
import threading
import time

import cflib.crtp
from cflib.crazyflie.log import LogConfig
from cflib.crazyflie.swarm import CachedCfFactory, Swarm
from cflib.crazyflie.syncLogger import SyncLogger
from cflib.positioning.motion_commander import MotionCommander
from cflib.positioning.position_hl_commander import PositionHlCommander

HEIGHT = 0.6
started = time.time()


def say(text):
    print(f"{time.time() - started:5.1f} s  {text}", flush=True)


def place(scf):
    """Ask one drone where it is."""
    log = LogConfig("place", 20)
    for axis in "xyz":
        log.add_variable(f"stateEstimate.{axis}", "float")
    with SyncLogger(scf, log) as logger:
        _, values, _ = next(iter(logger))
    return tuple(values.values())


def by_planner(scf):
    """Take off, fly a square, land: HighLevelCommander."""
    x, y, ground = place(scf)
    planner = scf.cf.high_level_commander
    planner.takeoff(HEIGHT, 1.5)
    time.sleep(2.5)
    for dx, dy in ((0.2, 0.0), (0.0, 0.2), (-0.2, 0.0), (0.0, -0.2)):
        planner.go_to(dx, dy, 0.0, 0.0, 1.0, relative=True)
        time.sleep(1.2)
    time.sleep(1.0)
    near(place(scf), (x, y, HEIGHT), 0.05)
    planner.land(0.0, 1.5)
    time.sleep(2.5)
    near(place(scf), (x, y, ground), 0.05)


def by_motions(scf):
    """Go forward and back, turn: MotionCommander, which sends setpoints by itself."""
    x, y, _ = place(scf)
    with MotionCommander(scf, default_height=HEIGHT) as motion:
        time.sleep(1.5)
        motion.forward(0.3)
        motion.turn_left(90)
        motion.right(0.1)
        time.sleep(1.5)
        near(place(scf), (x + 0.4, y, HEIGHT), 0.15)
    time.sleep(0.5)
    assert place(scf)[2] < 0.1


def by_positions(scf):
    """Go to places: PositionHlCommander."""
    x, y, _ = place(scf)
    with PositionHlCommander(scf, x=x, y=y, default_height=HEIGHT) as planner:
        planner.go_to(x, y + 0.2, 1.0)
        time.sleep(1.5)
        near(place(scf), (x, y + 0.2, 1.0), 0.05)


def near(found, wanted, tolerance):
    gap = max(abs(a - b) for a, b in zip(found, wanted, strict=True))
    assert gap < tolerance, (found, wanted)


def fly(scf, way):
    way(scf)
    say(f"{scf._link_uri} flew {way.__name__}")


def main():
    uris = sys.argv[1:]
    cflib.crtp.init_drivers()
    say(f"found {len(cflib.crtp.scan_interfaces())} drones")
    ways = (by_planner, by_motions, by_positions)
    with Swarm(uris, factory=CachedCfFactory(rw_cache="./cache")) as swarm:
        say(f"connected to {len(uris)}")
        swarm.reset_estimators()
        say("estimators reset")
        failed = []
        threading.excepthook = lambda told: failed.append(told.exc_value)
        swarm.parallel_safe(fly, {uri: [ways[k % len(ways)]] for k, uri in enumerate(uris)})
        assert not failed, failed
    say("all flew")


if __name__ == "__main__":
    main()
