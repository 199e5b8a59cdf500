"""Pictures of AirSim's clients: the process that draws them, and whose turn it is."""

import asyncio
import logging
import os
import signal
import threading

import msgpack
import numpy as np
import pytest
from waiting import PATIENCE

from bulletuav.bridges import airsim_drawing
from bulletuav.bridges.airsim_calls import AirsimCalls
from bulletuav.bridges.airsim_pictures import MAX_RESTARTS, DrawingError, PictureQueue
from bulletuav.bridges.airsim_world import AirsimWorld
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.solids import Solids

KINDS = (
    {"image_type": 0},
    {"image_type": 0, "compress": True},
    {"image_type": 1, "pixels_as_float": True},
    {"image_type": 2, "pixels_as_float": True},
    {"image_type": 3, "pixels_as_float": True},
    {"image_type": 3},
    {"image_type": 5, "compress": True},
)
CAMERAS = ("0", "1", "2", "3", "4")


@pytest.fixture
def make():
    """Makes worlds with their calls and pictures, and closes them."""
    made = []

    def make(*args, **options):
        world = AirsimWorld(*args, **{"seed": 0, **options})
        made.append((world, AirsimCalls(world), PictureQueue(world)))
        return made[-1]

    yield make
    for world, _, pictures in made:
        pictures.close()
        world.close()


def wanted(calls, count=1, vehicle=""):
    """An album of some pictures of the first camera."""
    return calls.parse_images(
        "simGetImages", [[{"camera_name": "0", "image_type": 0}] * count, vehicle]
    )


def settings(dynamics):
    """Options of a world with bodies of all kinds, but for a plain one."""
    if dynamics == "rigid_body":
        return {"dynamics": dynamics}
    city = Solids(np.array([[(-8.0, 6.0, 0.0), (-4.0, 9.0, 5.0)], [(5, 8, 0), (9, 12, 7)]]), ())
    return {
        "dynamics": dynamics,
        "obstacles": (Obstacle("box", (2.0, 0.5, 2.0)), Obstacle("cylinder", (0.5, 3.0))),
        "layout": city,
    }


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body"])
def test_the_process_draws_what_the_server_would_to_the_last_bit(make, dynamics):
    world, calls, pictures = make(2, **settings(dynamics))

    async def compare(name, *arguments):
        here = calls.call(name, list(arguments))
        parts = await pictures.draw(calls.parse_images(name, list(arguments)))
        assert b"".join(parts) == msgpack.packb(here)
        return here

    async def look(kinds, cameras):
        for vehicle in ("Drone1", "Drone2"):
            requests = [{"camera_name": one, **kind} for one in cameras for kind in kinds]
            await compare("simGetImages", requests[: len(requests) // 2], vehicle)
            await compare("simGetImages", requests[len(requests) // 2 :], vehicle)

    async def check():
        for k in range(len(world.vehicles)):
            pose = np.array((0.0, 0.0, -2.0 - k)), np.array((0.0, 0.1 * k, 0.3, 1.0))
            world.place(k, *pose)
        await look(KINDS, CAMERAS if dynamics == "bullet" else CAMERAS[:1])
        # What moves and what is added is seen
        before = await compare("simGetImage", "0", 0, "Drone1")
        world.airspace.add_body(Obstacle("sphere", (0.5,)), (0.0, 3.0, 2.0))
        if dynamics == "bullet":
            world.airspace.place_obstacle(0, (1.5, 5.0, 3.0))
            world.airspace.place_obstacle(1, (-2.0, 5.0, 1.5), (0.0, 0.6, 0.0, 0.8))
        for _ in range(7):
            world.step()
        await look(KINDS[:1] + KINDS[-1:], CAMERAS[:2])
        world.airspace.add_body(Obstacle("box", (0.5, 0.5, 0.5)), (1.0, 4.0, 2.5))
        assert await compare("simGetImage", "0", 0, "Drone1") != before
        assert await compare("simGetImages", [], "") == []
        # Another process draws the same, with what was added
        if dynamics == "rigid_body":
            os.kill(pictures._process.pid, signal.SIGTERM)
            with pytest.raises(DrawingError, match="exit code -15"):
                await compare("simGetImage", "0", 0, "Drone1")
            await look(KINDS[:1] + KINDS[-1:], CAMERAS[:1])

    asyncio.run(check())


class Stub:
    """A process that draws nothing, and answers when it is allowed to."""

    made = ()
    dies, permits = 0, 0
    """How many processes end in their first call, and how many pictures each draws unasked"""

    def __init__(self):
        self.allowed, self.killed = threading.Semaphore(self.permits), False
        type(self).made += (self,)
        self.drawn = []

    def prepare(self, contents):
        assert len(contents.airframes) >= 1

    def draw(self, poses, exposure, is_list):
        self.drawn.append(poses)
        assert self.allowed.acquire(timeout=PATIENCE)
        if self.killed or len(Stub.made) <= Stub.dies:
            raise EOFError
        height = float(poses.position[0, 0, 2])
        return msgpack.packb([height, exposure.view.time_stamp])

    def kill(self):
        self.killed = True
        self.allowed.release()

    def close(self):
        return -9


@pytest.fixture
def stub(draw_by, monkeypatch):
    """Replaces the process; returns the class, which lists those that were started."""
    draw_by(Stub)
    monkeypatch.setattr(Stub, "made", ())
    monkeypatch.setattr(Stub, "dies", 0)
    monkeypatch.setattr(Stub, "permits", 0)
    return Stub


async def until(happens):
    """Let others go on until something is true."""
    async with asyncio.timeout(PATIENCE):
        while not happens():
            await asyncio.sleep(0.001)


def test_pictures_show_the_state_when_the_turn_of_their_call_came(make, stub):
    """All pictures of a call show one state, whatever flies and is reset while they are drawn."""
    world, calls, pictures = make(1)
    start = float(world.airspace.swarm.position[0, 2])

    async def check():
        world.place(0, np.array((0.0, 0.0, -5.0)), np.array((0.0, 0.0, 0.0, 1.0)))
        first = asyncio.create_task(pictures.draw(wanted(calls, 3)))
        await until(lambda: stub.made and stub.made[0].drawn)
        second = asyncio.create_task(pictures.draw(wanted(calls)))
        await asyncio.sleep(0)
        # The flight goes on while the first picture is drawn
        before = world.time
        for _ in range(10):
            world.step()
        world.reset()
        world.paused = True
        for _ in range(4):
            stub.made[0].allowed.release()
        shown = msgpack.unpackb(b"".join(await first))
        assert shown == [[pytest.approx(start + 5.0), round(before * 1e9)]] * 3
        assert msgpack.unpackb(b"".join(await second)) == [[start, round(world.time * 1e9)]]
        # The one picture of the second client came right after the first of three
        heights = [float(poses.position[0, 0, 2]) for poses in stub.made[0].drawn]
        assert [round(one - start) for one in heights] == [5, 0, 5, 5]

    asyncio.run(check())


def test_a_process_that_ends_is_started_again_once(make, stub, caplog):
    """Whose picture it was is answered by an error; the next is drawn by another process."""
    stub.dies, stub.permits = 1, 100
    _, calls, pictures = make(1)

    def draw():
        return asyncio.run(pictures.draw(wanted(calls)))

    with pytest.raises(DrawingError, match="ended .exit code -9.; the next request starts it"):
        draw()
    assert [one.levelno for one in caplog.records] == [logging.WARNING]
    draw()
    assert len(stub.made) == 2
    # Deaths after pictures that were drawn do not add up; those in a row do
    stub.dies = 10
    for _ in range(MAX_RESTARTS):
        with pytest.raises(DrawingError, match="the next request starts it"):
            draw()
    for _ in range(2):
        with pytest.raises(DrawingError, match="no more pictures: .*restart the server"):
            draw()
    assert len(stub.made) == 2 + MAX_RESTARTS
    assert len(caplog.records) == 2 + MAX_RESTARTS


def test_a_process_that_cannot_start_is_an_error(make, draw_by, monkeypatch):
    def refuse(*args, **options):
        raise OSError("no room for a process")

    draw_by(airsim_drawing.DrawingProcess)
    monkeypatch.setattr(airsim_drawing.subprocess, "Popen", refuse)
    _, calls, pictures = make(1)
    with pytest.raises(DrawingError, match="no room for a process"):
        asyncio.run(pictures.draw(wanted(calls)))


def test_no_more_pictures_are_drawn_for_a_client_that_has_gone(make, stub):
    """Those after the one that is being drawn; other clients' are."""
    _, calls, pictures = make(1)

    async def check():
        here = [True]
        gone = asyncio.create_task(pictures.draw(wanted(calls, 32), lambda: here[0]))
        await until(lambda: stub.made and stub.made[0].drawn)
        waiting = asyncio.create_task(pictures.draw(wanted(calls, 32), lambda: here[0]))
        other = asyncio.create_task(pictures.draw(wanted(calls)))
        await asyncio.sleep(0)
        here[0] = False
        for _ in range(2):
            stub.made[0].allowed.release()
        assert await gone == await waiting == []
        assert len(await other) == 2
        assert len(stub.made[0].drawn) == 2

    asyncio.run(check())


def test_closing_ends_outstanding_pictures(make, stub, caplog):
    _, calls, pictures = make(1)

    async def check():
        tasks = [asyncio.create_task(pictures.draw(wanted(calls, 2))) for _ in range(2)]
        await until(lambda: stub.made and stub.made[0].drawn)
        pictures.close()
        for task in tasks:
            with pytest.raises(DrawingError, match="the server is closing"):
                await task

    asyncio.run(check())
    assert not caplog.records


def test_closing_while_the_process_starts_ends_the_request(make, stub, monkeypatch):
    _, calls, pictures = make(1)

    async def check():
        loop = asyncio.get_running_loop()
        monkeypatch.setattr(
            stub, "prepare", lambda self, setup: loop.call_soon_threadsafe(pictures.close)
        )
        with pytest.raises(DrawingError, match="the server is closing"):
            await pictures.draw(wanted(calls))

    asyncio.run(check())


def test_the_process_that_draws_imports_nothing_from_the_working_folder(tmp_path, monkeypatch):
    (tmp_path / "planted.py").touch()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(airsim_drawing.sys, "path", [one for one in airsim_drawing.sys.path if one])
    look = "import importlib.util, sys; sys.exit(importlib.util.find_spec('planted') is not None)"
    monkeypatch.setattr(airsim_drawing, "CHILD_PROGRAM", look)
    assert airsim_drawing.DrawingProcess().close() == 0
