"""Films of recordings: cameras, places between rows, what hides what, and files."""

import dataclasses
import json
import sys

import numpy as np
import pytest

import bulletuav
from bulletuav.analysis.recording import fly_episode, save
from bulletuav.cli import main
from bulletuav.policies import find_policy
from bulletuav.report.film import TURN, Film

SMALL = (200, 120)


def flown(task="crossing", policy="straight", folder=None, **options):
    options = {"num_drones": 3, "dynamics": "point_mass", "horizon": 6, **options}
    aviary = bulletuav.Aviary(task, **options)
    recording = fly_episode(aviary, find_policy(policy)(aviary), 0)
    if folder is not None:
        save(recording, aviary, policy, 0, folder)
    aviary.close()
    return recording


@pytest.fixture(scope="module")
def flight():
    return flown()


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    flown(folder=folder, horizon=2)
    return folder


@pytest.fixture
def film(request):
    """Makes films that are closed in the end."""

    def made(*arguments, **options):
        one = Film(*arguments, **options)
        request.addfinalizer(one.close)
        return one

    return made


def coloured(picture, colour):
    """Pixels with the hue of a colour, however bright."""
    shades = picture / np.maximum(1, picture.max(axis=-1, keepdims=True))
    wanted = np.array(colour) / max(colour)
    return (np.abs(shades - wanted) < 0.08).all(axis=-1)


def test_the_followed_drone_is_in_the_middle(flight, film):
    for drone in range(3):
        follows = film(flight, "", "follow", drone, SMALL)
        place = np.argwhere(coloured(follows.picture(0.3, reach=0.0), follows._colours[drone]))
        assert len(place) > 30
        assert (np.abs(place.mean(axis=0)[::-1] - np.array(SMALL) / 2) < (12, 20)).all()


def test_the_camera_comes_behind_its_drone(flight, film):
    follows = film(flight, "", "follow", 0, SMALL)
    _, away = follows._camera_position(0.0, flight.position[0], float(follows._camera_azimuth[0]))
    way = flight.velocity[0, 0]
    cosine = away[:2] @ way[:2] / np.linalg.norm(away[:2]) / np.linalg.norm(way[:2])
    assert cosine == pytest.approx(-1)
    assert away[2] > 0
    # Directions change by less than a decision could turn a drone.
    assert np.abs(np.diff(follows._camera_azimuth)).max() < 0.3


def test_cameras_turn_or_stand(flight, film):
    position = flight.position[0]
    orbit, still = (film(flight, "", name, size=SMALL) for name in ("orbit", "still"))
    (middle, start), (_, later) = (
        orbit._camera_position(time, position, 0.0) for time in (0.0, 5.0)
    )
    angle = [np.arctan2(away[1], away[0]) for away in (start, later)]
    assert (angle[1] - angle[0]) % (2 * np.pi) == pytest.approx(5 * TURN)
    assert np.linalg.norm(start) == pytest.approx(np.linalg.norm(later))
    whole = np.concatenate([flight.position.reshape(-1, 3), flight.goal.reshape(-1, 3)])
    np.testing.assert_allclose(middle, (whole.min(axis=0) + whole.max(axis=0)) / 2)
    first, last = (still._camera_position(time, position, 0.0)[1] for time in (0.0, 5.0))
    np.testing.assert_array_equal(first, last)


def test_between_decisions_drones_are_between(flight, film):
    one = film(flight, "", size=SMALL)
    one.picture(0.25)
    own = np.array(one._owner) == 1
    bodies = one._engine.scenery.place[0, len(one._owner) - len(own) :][: len(own)][own]
    wanted = flight.position[2:4, 1].mean(axis=0)
    scale = one._scale(one._about["airframes"][0]["radius"])
    assert scale > 1
    assert (np.linalg.norm(bodies - wanted, axis=1) < scale).all()


def test_what_is_behind_a_building_is_not_seen(flight, film):
    drone = flight.position[3, 0]
    follows = film(flight, "", "follow", 0, SMALL)
    _, away = follows._camera_position(0.3, flight.position[3], float(follows._camera_azimuth[3]))
    wall = drone + 0.5 * away
    building = np.array([[wall - 1.0, wall + 1.0]])
    hidden = film(dataclasses.replace(flight, building=building), "", "follow", 0, SMALL)
    colour = follows._colours[0]
    seen, unseen = (coloured(one.picture(0.3), colour).sum() for one in (follows, hidden))
    assert seen > 100
    assert unseen < 0.5 * seen


@pytest.mark.parametrize(
    ("task", "options"),
    [
        ("lidar_navigation", {"area": 200.0, "leg": 50.0}),
        ("obstacles", {}),
        ("mec", {"area": 200.0, "num_layouts": 1, "num_users": 12}),
        ("race", {"horizon": 600}),
    ],
)
def test_every_kind_of_scene_is_shown(task, options, film):
    recording = flown(task, "random", **{"num_drones": 2, "horizon": 3, **options})
    picture = film(recording, "scene", size=SMALL).picture(0.2, reach=np.inf)
    assert picture.shape == (*SMALL[::-1], 3)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 50


def test_a_film_is_written(run, tmp_path, capsys):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    path = tmp_path / "film.mp4"
    main(["replay", str(run), "--out", str(path), "--camera", "follow", "--drone", "1"])
    assert f"wrote {path}" in capsys.readouterr().out.replace("\n", "")
    assert ffmpeg.count_frames_and_secs(str(path)) == (5, pytest.approx(0.25, abs=0.06))


def test_bad_input_gets_one_line(run, flight, tmp_path, capsys, monkeypatch):
    film = ["replay", str(run), "--out", str(tmp_path / "film.mp4")]
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    damaged = tmp_path / "damaged"
    damaged.mkdir()
    for name in ("run.json", "trajectory.npz", "trajectory.csv"):
        data = (run / name).read_bytes()
        (damaged / name).write_bytes(data[: len(data) // 2] if name.endswith("npz") else data)
    for words, said in (
        ([*film, "--camera", "orbti"], "unknown camera 'orbti': did you mean 'orbit'?"),
        ([*film, "--drone", "3"], "drone is 3"),
        ([*film[:-1], "film.avi"], "film.avi: its name has to end in .html or .mp4"),
        ([*film[:2], "--camera", "orbit"], "--camera and --drone are for videos"),
        (["replay", str(damaged), "--out", "film.mp4"], "trajectory.npz is damaged or was changed"),
        (film, "[video]"),
    ):
        with pytest.raises(SystemExit) as end:
            main(words)
        assert end.value.code == 2
        assert said in capsys.readouterr().err.strip().splitlines()[-1]
    assert not (tmp_path / "film.mp4").exists()


def test_a_scene_that_is_damaged_is_told(flight):
    scene = {**flight.scene, "about": np.array(json.dumps({}))}
    with pytest.raises(ValueError, match="scene of the recording is damaged"):
        Film(dataclasses.replace(flight, scene=scene), "")
