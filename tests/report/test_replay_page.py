"""The page of a replay in a real browser; skipped where there is no Chromium."""

import dataclasses
import io

import chromium
import numpy as np
import pytest
from PIL import Image

import bulletuav
from bulletuav.analysis.markers import MarkerLog
from bulletuav.analysis.recording import fly_episode
from bulletuav.policies import find_policy
from bulletuav.report import replay_sampling
from bulletuav.report.replay import write_replay
from bulletuav.report.replay_sampling import take_sample

pytestmark = pytest.mark.skipif(not chromium.found(), reason="there is no Chromium")


def recorded(task, policy, **options):
    aviary = bulletuav.Aviary(task, dynamics="point_mass", **options)
    recording = fly_episode(aviary, find_policy(policy)(aviary), 0)
    aviary.close()
    return recording


@pytest.fixture(scope="module")
def flight():
    return recorded("crossing", "straight", num_drones=4)


@pytest.fixture(scope="module")
def browser():
    with chromium.Page() as page:
        yield page


@pytest.fixture
def page(flight, browser, tmp_path):
    """The crossing, opened; in the end nothing may have gone wrong or asked for a network."""
    path = tmp_path / "replay.html"
    write_replay(flight, "a crossing", path)
    browser.open(path, "#theme=light")
    yield browser
    assert browser.messages == []
    assert browser.requests == [path.resolve().as_uri()]


def time_of(page):
    return page.tell("replay.episode.time")


def test_it_plays_pauses_and_scrubs(page, flight):
    assert time_of(page) == 0
    page.click("#play")
    page.wait("replay.episode.time > 0.5")
    assert page.tell("document.querySelector('#play').textContent") == "Pause"
    page.press(" ", "Space", 32)
    stopped = time_of(page)
    assert page.tell("document.querySelector('#play').textContent") == "Play"
    page.wait("!replay.dirty")
    assert time_of(page) == stopped
    # The slider, by a drag along it.
    left, top, width = page.tell(
        "(() => { const b = document.querySelector('#scrub').getBoundingClientRect();"
        " return [b.x, b.y + b.height / 2, b.width]; })()"
    )
    page.press_mouse(left + 0.1 * width, top, to=(left + 0.5 * width, top))
    assert time_of(page) == pytest.approx(0.5 * flight.time[-1], rel=0.05)
    page.press("End", "End", 35)
    assert time_of(page) == pytest.approx(flight.time[-1])
    page.press("ArrowLeft", "ArrowLeft", 37)
    assert time_of(page) == pytest.approx(flight.time[-2], abs=1e-3)
    # Playing at the end begins anew.
    page.press("End", "End", 35)
    page.press(" ", "Space", 32)
    page.wait(f"replay.episode.time < {0.5 * flight.time[-1]}")
    page.press(" ", "Space", 32)


def test_it_shows_where_drones_were(page, flight):
    for row in (0, 7, len(flight.time) - 1):
        page.tell(f"replay.seek({flight.time[row]})")
        shown = page.tell("[...replay.episode.position]")
        np.testing.assert_allclose(shown, flight.position[row].ravel(), atol=0.01)
        near = flight.separation[row - 1] < 5 if row else np.zeros(4, bool)
        drones = range(4)
        told = page.tell("[0, 1, 2, 3].map((k) => replay.episode.inConflict(k))")
        flies = flight.alive[row]
        assert told == [bool(near[k] and flies[k]) for k in drones]
    middle = 0.5 * (flight.time[7] + flight.time[8])
    page.tell(f"replay.seek({middle})")
    between = flight.position[7:9].mean(axis=0).ravel()
    np.testing.assert_allclose(page.tell("[...replay.episode.position]"), between, atol=0.01)


def test_the_camera_follows_turns_and_zooms(page, flight):
    page.tell("replay.seek(3)")
    page.click("#follow")
    page.press("n")
    page.wait("!replay.dirty")
    assert page.tell("replay.chosen") == 1
    target = page.tell("replay.view.target.toArray()")
    np.testing.assert_allclose(target, flight.position[30, 1], atol=0.05)
    page.tell("replay.seek(5)")
    page.wait("!replay.dirty")
    target = page.tell("replay.view.target.toArray()")
    np.testing.assert_allclose(target, flight.position[50, 1], atol=0.05)
    before = page.tell("[replay.view.azimuth, replay.view.elevation, replay.view.distance]")
    page.press_mouse(400, 400, to=(500, 430))
    page.call("Input.dispatchMouseEvent", type="mouseWheel", x=400, y=400, deltaX=0, deltaY=-200)
    page.wait(f"replay.view.distance < {before[2]} * 0.9")
    after = page.tell("[replay.view.azimuth, replay.view.elevation]")
    assert after[0] == pytest.approx(before[0] - 0.6)
    assert after[1] == pytest.approx(before[1] + 0.18)
    page.press("r")
    assert not page.tell("replay.following")


def test_the_whole_view_has_all_in_sight_beside_the_panels(page, flight):
    page.tell("replay.view.distance = 3; replay.whole()")
    for time in (0.0, flight.time[-1]):
        page.tell(f"replay.seek({time})")
        page.wait("!replay.dirty && !replay.view.changed")
        shown = np.array(page.tell("[0, 1, 2, 3].map((k) => replay.project(k))"))
        left, top = page.tell(
            "[document.querySelector('aside').getBoundingClientRect().x,"
            " document.querySelector('footer').getBoundingClientRect().y]"
        )
        assert (shown > 0).all()
        assert (shown < (left, top)).all()
        assert np.ptp(shown, axis=0).max() > 100


def test_a_click_chooses_a_drone_and_plots_go_with_the_time(page, flight):
    page.tell("replay.seek(2)")
    page.wait("!replay.dirty && !replay.view.changed")
    page.press_mouse(*page.tell("replay.project(2)"))
    assert page.tell("replay.chosen") == 2
    row = 20
    page.tell("replay.seek(2)")
    page.wait("!replay.dirty")
    captions = page.tell(
        "[...document.querySelectorAll('figcaption')].map((one) => one.innerText.split('\\n'))"
    )
    told = {caption[0]: caption[1] for caption in captions if len(caption) > 1}
    assert float(told["altitude (m)"]) == pytest.approx(flight.position[row, 2, 2], abs=0.06)
    assert float(told["separation (m)"]) == pytest.approx(flight.separation[row - 1, 2], abs=0.06)
    assert float(told["reward"]) == pytest.approx(flight.reward[row - 1, 2], abs=0.06)
    cursor = "document.querySelector('figure .cursor').style.transform"
    before = page.tell(cursor)
    page.tell("replay.seek(4)")
    page.wait(f"!replay.dirty && {cursor} !== '{before}'")
    # A click into a plot goes to that time.
    page.click("figure canvas")
    assert time_of(page) == pytest.approx(0.43 * flight.time[-1], rel=0.1)


def picture(page):
    page.wait("!replay.dirty && !replay.view.changed")
    return np.asarray(Image.open(io.BytesIO(page.picture())).convert("RGB")).astype(int)


def test_light_and_dark_and_layers_change_the_picture(page):
    page.tell("replay.seek(4)")
    light = picture(page)
    page.press("t")
    dark = picture(page)
    assert light.mean() > 180
    assert dark.mean() < 60
    page.tell("replay.showLayer('trails', false)")
    assert (np.abs(picture(page) - dark).max(axis=-1) > 20).sum() > 100


def test_users_links_and_beams_are_drawn(browser, tmp_path):
    options = {"area": 200.0, "num_layouts": 1, "num_users": 12, "horizon": 6}
    service = recorded("mec", "kmeans", num_drones=2, **options)
    write_replay(service, "users", tmp_path / "users.html")
    browser.open(tmp_path / "users.html", "#time=3")
    row = int(browser.tell("replay.episode.row"))
    links = (service.scene["link"][:, 0] == row).sum()
    assert browser.tell("replay.layers.links.geometry.drawRange.count") == 6 * links > 0
    assert browser.tell("replay.layers.users.count") == 12
    assert browser.tell("replay.stats.calls") < 20
    flown = recorded("lidar_navigation", "straight", num_drones=2, area=200.0, leg=50.0, horizon=6)
    write_replay(flown, "beams", tmp_path / "beams.html")
    browser.open(tmp_path / "beams.html", "#drone=1")
    beams = browser.tell("[...replay.layers.beams.geometry.attributes.finish.array]")
    ranges = flown.reading["lidar"][0, 1]
    away = np.array(beams[: 12 * len(ranges)]).reshape(-1, 4, 3)[:, 0] - flown.position[0, 1]
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), ranges, atol=0.01)
    assert browser.messages == []


def test_a_block_that_is_no_block_is_told(flight, browser, tmp_path):
    path = tmp_path / "replay.html"
    write_replay(flight, "a crossing", path)
    text = path.read_text()
    path.write_text(text.replace('id="payload">eN', 'id="payload">eM'))
    browser.call("Page.navigate", url=path.as_uri())
    browser.wait("document.querySelector('#trouble') && !document.querySelector('#trouble').hidden")
    assert browser.messages
    browser.messages.clear()


def test_markers_are_shown_for_their_time(flight, browser, tmp_path):
    log = MarkerLog(lambda: 2.0)
    log.add_points(np.array([[1.0, 2.0, 3.0]]), (0.0, 0.0, 1.0), 20, 1.0)
    log.add_lines(np.zeros((2, 2, 3)), (1.0, 0.0, 0.0), 3, np.inf)
    log.add_texts(["here <b>"], np.array([[0.0, 0.0, 2.0]]), (1.0, 0.0, 0.0), 12, np.inf)
    marked = dataclasses.replace(flight, scene={**flight.scene, **log.arrays()})
    path = tmp_path / "marked.html"
    write_replay(marked, "marked", path)
    browser.open(path, "#theme=light")
    shown = (
        "[...replay.markers.points, ...replay.markers.lines]"
        ".map((one) => one.mesh.geometry.drawRange.count)"
    )
    texts = "[...document.querySelectorAll('#texts div')].map((one) => one.textContent)"
    for time, counts in ((1.9, [0, 0]), (2.1, [1, 12]), (3.1, [0, 12])):
        browser.tell(f"replay.seek({time})")
        browser.wait("!replay.dirty")
        assert browser.tell(shown) == counts
        assert browser.tell(texts) == (["here <b>"] if time > 2 else [])
    browser.tell("replay.seek(2.5)")
    browser.wait("!replay.dirty && !replay.view.changed")
    at = browser.tell("replay.projectPoint([1, 2, 3])")
    picture = np.array(Image.open(io.BytesIO(browser.picture())))
    assert picture[round(at[1]), round(at[0]), :3].tolist() == [0, 0, 255]
    browser.click("#more")
    browser.click("#layer-markers")
    browser.wait("!replay.dirty")
    assert browser.tell("document.querySelector('#texts').hidden")
    assert browser.messages == []


def test_a_far_marker_leaves_the_whole_view_on_the_drones(flight, browser, tmp_path):
    log = MarkerLog(lambda: 0.0)
    log.add_points(np.full((1, 3), 1e4), (0.0, 0.0, 1.0), 20, np.inf)
    log.add_lines(np.array([np.zeros(3), np.full(3, -1e4)])[None], (1.0, 0.0, 0.0), 3, np.inf)
    marked = dataclasses.replace(flight, scene={**flight.scene, **log.arrays()})
    extents = []
    for name, one in (("plain", flight), ("marked", marked)):
        write_replay(one, name, tmp_path / f"{name}.html")
        browser.open(tmp_path / f"{name}.html", "#theme=light")
        extents.append(browser.tell("replay.view.extent"))
    assert browser.tell("replay.markers.exists")
    assert extents[0] == extents[1]
    assert browser.messages == []


def test_large_swarms_are_shown_as_discs_and_a_sample_in_detail(browser, tmp_path, monkeypatch):
    monkeypatch.setattr(replay_sampling, "MAX_POSITIONS", 300 * 7)
    flight = recorded("crossing", "straight", num_drones=300, horizon=25)
    path = tmp_path / "swarm.html"
    write_replay(flight, "a swarm", path)
    browser.open(path, "#theme=light")
    assert browser.tell("replay.episode.detailed") == 256
    assert browser.tell("document.querySelector('#sampling').textContent") == (
        "300 drones by their positions, every 4 decisions; 256 of them also with attitudes, "
        "trails, goals and plots."
    )
    order = take_sample(flight, {"airframe_of": [0] * 300}).order
    for row, time in ((12, flight.time[12]), (25, flight.time[25])):
        browser.tell(f"replay.seek({time})")
        shown = np.array(browser.tell("Array.from(replay.episode.position)")).reshape(-1, 3)
        np.testing.assert_allclose(shown, flight.position[row][order], atol=0.01)
    # The last interval has one decision: half of it is at the middle of its two rows
    middle = 0.5 * (flight.time[24] + flight.time[25])
    browser.tell(f"replay.seek({middle})")
    shown = np.array(browser.tell("Array.from(replay.episode.position)")).reshape(-1, 3)
    between = 0.5 * (flight.position[24] + flight.position[25])
    np.testing.assert_allclose(shown, between[order], atol=0.01)
    # A control sets how many drones have trails
    total = browser.tell("replay.drones.trails.total")
    browser.tell(
        "document.querySelector('#tracked').value = 16;"
        "document.querySelector('#tracked').dispatchEvent(new Event('change'))"
    )
    assert browser.tell("replay.drones.trails.total") == pytest.approx(total * 16 / 256, rel=0.2)
    assert browser.tell("document.querySelector('#all').textContent") == "of 300 drones"
    assert browser.messages == []
