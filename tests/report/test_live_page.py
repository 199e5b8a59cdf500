"""Live pages in a real browser; skipped where there is no Chromium."""

import chromium
import numpy as np
import pytest

import bulletuav
from bulletuav.envs.pacer import Pacer

pytestmark = pytest.mark.skipif(not chromium.found(), reason="there is no Chromium")


@pytest.fixture(scope="module")
def browser():
    with chromium.Page(640, 480) as page:
        yield page


@pytest.fixture
def env(monkeypatch):
    """The test tells when the next decision comes."""
    monkeypatch.setattr(Pacer, "wait", lambda self: None)
    env = bulletuav.Aviary(
        "mec",
        num_drones=2,
        dynamics="point_mass",
        area=200.0,
        num_layouts=1,
        num_users=12,
        render_mode="web",
        render_address="127.0.0.1:0",
    )
    yield env
    env.close()


def fly(env, decisions):
    """Fly, and tell where drones were before and after each decision."""
    places = [env.swarm.position[0].copy()]
    for row in range(decisions):
        env.step(np.random.default_rng(row).uniform(-1, 1, env.given.shape))
        places.append(env.swarm.position[0].copy())
    return np.array(places)


def rows(page):
    return page.tell("replay.episode.about.rows")


def test_a_page_goes_along_with_the_flight(browser, env):
    address = f"http://{env.viewer.feed.address}/"
    browser.call("Page.navigate", url=f"{address}#theme=light")
    assert env.viewer.feed.wait(chromium.PATIENCE)
    assert browser.tell("document.querySelector('#payload').textContent") == ""
    env.reset(seeds=0)
    places = fly(env, 9)
    browser.wait("globalThis.replay !== undefined && replay.episode.about.rows === 10")
    assert browser.tell("document.querySelector('#feed').textContent") == "Live"
    browser.wait("replay.episode.time > 0.97 * replay.episode.duration && !replay.dirty")
    # Drones are where they are now, and were where they were.
    for row in (9, 4, 0):
        browser.tell(f"replay.seek({row} * replay.episode.period)")
        shown = browser.tell("[...replay.episode.position]")
        np.testing.assert_allclose(shown, places[row].ravel(), atol=0.02)
        flies = browser.tell("[0, 1].map((drone) => replay.episode.flies(drone))")
        assert flies == [True, True]
    links = env.links[0].sum()
    browser.tell("replay.seek(1e9)")
    browser.wait("!replay.dirty")
    assert browser.tell("replay.layers.links.geometry.drawRange.count") == 6 * links
    pieces = browser.tell("replay.layers.trails.geometry.drawRange.count")
    assert pieces > 0
    # Who looks at the past stays there while rows come; the button leads back.
    browser.tell("replay.seek(0)")
    fly(env, 1)
    browser.wait("replay.episode.about.rows === 11")
    browser.press(" ", "Space", 32)
    assert browser.tell("replay.episode.time") < 0.5 * browser.tell("replay.episode.duration")
    browser.click("#feed")
    browser.wait("replay.episode.time > 0.97 * replay.episode.duration")
    # A new episode, in place of the one before; what was chosen stays.
    browser.press("n")
    browser.tell("replay.showLayer('trails', false)")
    env.reset(seeds=1)
    places = fly(env, 2)
    browser.wait("replay.episode.about.rows === 3")
    assert browser.tell("[replay.chosen, replay.layers.trails.visible]") == [1, False]
    browser.tell("replay.seek(1e9)")
    np.testing.assert_allclose(
        browser.tell("[...replay.episode.position]"), places[2].ravel(), atol=0.02
    )
    env.close()
    browser.wait("document.querySelector('#feed').textContent === 'The flight is over'")
    # The page stays, as a replay.
    browser.press("Home", "Home", 36)
    browser.wait("!replay.dirty && replay.episode.time === 0")
    assert browser.messages == []
    assert browser.requests[-2:] == [address, f"{address}feed"]


def test_closing_the_page_lets_the_flight_go_on(browser, env):
    browser.call("Page.navigate", url=f"http://{env.viewer.feed.address}/")
    assert env.viewer.feed.wait(chromium.PATIENCE)
    env.reset(seeds=0)
    fly(env, 2)
    browser.call("Page.navigate", url="about:blank")
    for _ in range(1000):
        fly(env, 1)
        if not env.viewer.feed.is_watched:
            break
    assert not env.viewer.feed.is_watched
    fly(env, 2)
    assert env.viewer._recorder is None
