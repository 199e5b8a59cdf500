import csv
import dataclasses
import json
import re

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text
from PIL import Image

import bulletuav
from bulletuav.analysis.recorded import summarize_infos
from bulletuav.analysis.recording import Recording, fly_episode, load, outcomes, save
from bulletuav.policies import Policy, find_policy
from bulletuav.report import pictures
from bulletuav.report.figures import bar_lines
from bulletuav.report.pictures import Animation, plot_tracks
from bulletuav.tasks import find_task


@pytest.fixture(scope="module")
def flown():
    """A short crossing of three drones, two of which collide."""
    options = {
        "num_drones": 3,
        "jitter": 0.0,
        "altitude_spread": 0.0,
        "half_length": 20.0,
        "start_speed": (10.0, 10.0),
    }
    aviary = bulletuav.Aviary("crossing", dynamics="rigid_body", lanes=1, **options)
    calls = []
    recording = fly_episode(
        aviary, find_policy("straight")(aviary), seed=0, progress=lambda: calls.append(1)
    )
    yield aviary, recording, len(calls)
    aviary.close()


def test_recording_holds_every_decision(flown):
    aviary, recording, calls = flown
    steps = len(recording.reward)
    assert steps == calls == len(recording.time) - 1
    assert recording.position.shape == (steps + 1, 3, 3)
    assert not recording.alive[-1].any()
    np.testing.assert_allclose(np.diff(recording.time), 0.1)
    np.testing.assert_array_equal(recording.goal[-1], aviary.scene.goal[0])
    assert recording.goal.shape == recording.position.shape


def test_outcomes_by_hand(flown):
    _, recording, _ = flown
    rows = outcomes(recording)
    assert [row.reached for row in rows] == [
        False,
        True,
        False,
    ]  # 0 and 2 meet in the middle, 1 follows behind 0
    assert [row.collisions for row in rows] == [1, 0, 1]
    assert rows[0].conflicts == rows[2].conflicts == 1
    assert rows[0].min_separation < 0.6
    assert rows[0].time == rows[2].time < rows[1].time
    assert rows[1].final_distance <= 2
    assert rows[0].final_distance == pytest.approx(20, abs=1)


def test_same_seed_same_recording(flown):
    aviary, recording, _ = flown
    again = fly_episode(aviary, find_policy("straight")(aviary), seed=0)
    np.testing.assert_array_equal(again.position, recording.position)


def test_files_hold_what_was_flown(flown, tmp_path):
    aviary, recording, _ = flown
    arrays, table, run = save(recording, aviary, "straight", 0, tmp_path)
    with np.load(arrays) as file:
        np.testing.assert_array_equal(file["position"], recording.position)
        assert set(file.files) >= {"time", "velocity", "alive", "reward", "separation", "goal"}
    with table.open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(recording.time) * 3
    row = rows[3 * 5 + 2]
    assert (float(row["time"]), int(row["drone"])) == (0.5, 2)
    np.testing.assert_allclose(
        [float(row[axis]) for axis in "xyz"], recording.position[5, 2], rtol=1e-8
    )
    about = json.loads(run.read_text())
    assert (about["task"], about["seed"], about["options"]["airframe"]) == (
        "crossing",
        0,
        ["hummingbird"] * 3,
    )
    assert about["options"]["half_length"] == 20
    assert about["outcomes"][1]["reached"]
    assert about["outcomes"][0]["collisions"] == 1


def test_a_recording_is_read_as_it_was_written(flown, tmp_path):
    aviary, recording, _ = flown
    assert len(recording.contact_step) == 2
    path, *_ = save(recording, aviary, "straight", 0, tmp_path)
    for source in (path, str(path), tmp_path):
        again = load(source)
        assert again.version == 5
        assert list(again.info) == list(recording.info)
        for name, array in recording.info.items():
            np.testing.assert_array_equal(again.info[name], array)
        for name, array in recording.arrays().items():
            np.testing.assert_array_equal(getattr(again, name), array)
            assert getattr(again, name).dtype == array.dtype


def test_weighted_reward_terms_are_recorded_and_add_up_to_rewards(flown):
    _, recording, _ = flown
    terms = {name: row for name, row in recording.info.items() if name.startswith("reward/")}
    assert {"reward/progress", "reward/collision"} <= set(terms)
    np.testing.assert_allclose(sum(terms.values()), recording.reward, atol=1e-9)
    assert recording.info["reward/collision"].min() == -200
    assert set(recording.info) >= {"goal_distance", "power", "charge", "impulse", "resting"}
    assert not set(recording.info) & set(recording.arrays())


def test_what_infos_told_is_found_by_their_names(flown):
    _, recording, _ = flown
    assert recording.get_info("separation") is recording.separation
    assert recording.get_info("charge") is recording.info["charge"]
    for name in ("goal_distanc", "position"):
        with pytest.raises(ValueError, match=f"unknown info of the recording '{name}'"):
            recording.get_info(name)


def test_episodes_are_summed_up_by_hand(flown):
    _, recording, _ = flown
    names = ("success", "separation", "conflicts", "collision", "goal_distance")
    rows = summarize_infos(recording, names)
    for row, outcome in zip(rows, outcomes(recording), strict=True):
        assert tuple(row) == names
        wanted = (outcome.reached, outcome.min_separation, outcome.conflicts, outcome.collisions)
        assert tuple(row.values())[:4] == wanted
        assert row["goal_distance"] == pytest.approx(outcome.final_distance)
    assert [type(value) for value in rows[0].values()] == [bool, float, int, int, float]


def test_a_recording_of_version_3_has_no_bars(flown, tmp_path):
    aviary, recording, _ = flown
    path, *_ = save(recording, aviary, "straight", 0, tmp_path)
    change(path, version=np.array(3), obstacle_axis=None)
    assert load(path).obstacle_axis.shape == (*recording.obstacle_radius.shape, 3)


def test_bars_of_gates_are_told_and_drawn(tmp_path):
    aviary = bulletuav.Aviary(
        "race", num_drones=1, difficulty="medium", dynamics="point_mass", horizon=200
    )
    recording = fly_episode(aviary, find_policy("stay")(aviary), 0)
    size = np.linalg.norm(recording.obstacle_axis, axis=1)
    square, ring = 1.0 + 0.2, 1.2 * np.tan(np.pi / 12)
    np.testing.assert_allclose(size, ([square] * 4 + [ring] * 12) * 3)
    gate = aviary.scene.memory["gate"][0, 0]
    # The four bars of an upright gate: two lie, two stand.
    assert sorted(np.abs(recording.obstacle_axis[:4, 2]).round(6)) == [0, 0, square, square]
    np.testing.assert_allclose(recording.obstacle[0, :4].mean(axis=0), gate)
    lines = np.array(bar_lines(recording, 0))
    assert lines.shape == (48, 2, 2)
    plot_tracks(recording, 1.0, "race", tmp_path / "race.png")
    Animation(recording, 1.0, 0.4, "race")


def test_a_recording_of_version_2_is_read(flown, tmp_path):
    """It has no infos but the task's own, and starts as goals where there are targets."""
    aviary, recording, _ = flown
    path, *_ = save(recording, aviary, "straight", 0, tmp_path)
    told = dict.fromkeys(f"info/{name}" for name in recording.info)
    change(path, version=np.array(2), **told)
    again = load(path)
    assert (again.version, set(again.info)) == (2, {"goal_distance"})
    assert outcomes(again) == outcomes(recording)
    for i, end in enumerate(recording.alive[:-1].sum(axis=0)):
        np.testing.assert_allclose(
            again.get_info("goal_distance")[:end, i], recording.get_info("goal_distance")[:end, i]
        )
    plot_tracks(again, 5.0, "old", tmp_path / "old.png")
    targets = {
        "target": np.zeros((len(again.time), 2, 3)),
        "seen": np.ones((len(again.time), 2), bool),
    }
    change(path, **targets)
    assert load(path).goal.shape == (len(again.time), 0, 3)
    assert all(row.final_distance == np.inf for row in outcomes(load(path)))


def test_contacts_of_the_first_world_are_recorded():
    class Falling(find_task("hover")):
        name = "falling"
        ends = ()

    start = ((0.0, 0.0, 0.2), (1.0, 0.0, 0.3))
    options = {"action": "velocity", "num_drones": 2, "start": start, "horizon": 20}
    aviary = bulletuav.Aviary(Falling, 2, **options)
    seen = []

    class Down(Policy):
        """Down in the first world; the other world's first drone follows later."""

        name, actions, reads_swarm = "down", ("velocity",), False

        def reset(self, mask):
            pass

        def act(self, observations, swarm):
            if aviary.steps[0]:
                seen.append(aviary.contacts)
            action = np.zeros((2, 2, 3))
            action[0, :, 2] = -1.0
            action[1, 0, 2] = -0.8
            return action

    recording = fly_episode(aviary, Down(aviary), seed=0)
    seen.append(aviary.contacts)
    aviary.close()
    assert any((one.world == 1).any() for one in seen)
    rows = [
        (step, *row[1:-1])  # without the world and the depth
        for step, one in enumerate(seen)
        for row in zip(*one, strict=True)
        if row[0] == 0
    ]
    assert len(rows) > 20
    assert {row[1] for row in rows} == {0, 1}
    names = ("step", "drone", "other", "impulse", "point", "normal", "velocity")
    for name, column in zip(names, zip(*rows, strict=True), strict=True):
        np.testing.assert_array_equal(getattr(recording, f"contact_{name}"), np.array(column))
    touched = np.zeros_like(recording.collision)
    touched[recording.contact_step, recording.contact_drone] = True
    np.testing.assert_array_equal(touched, recording.collision)


def test_infos_of_the_task_are_recorded(tmp_path):
    class Telling(find_task("hover")):
        name = "telling"

        def info(self, frame):
            values = {"height": frame.after.position[..., 2], "object": np.array([[None] * 2])}
            if frame.time[0] > 0:  # of other forms, which are refused at a reset
                values |= {"place": frame.after.position, "number": 5.0}
            late = {"late": values["height"]} if frame.time[0] > 0.1 else {}
            return super().info(frame) | values | late

    aviary = bulletuav.Aviary(Telling, num_drones=2, horizon=4, action="velocity")
    recording = fly_episode(aviary, find_policy("straight")(aviary), seed=0)
    path, *_ = save(recording, aviary, "straight", 0, tmp_path)
    aviary.close()
    for one in (recording, load(path)):
        assert {"height", "place"} <= set(one.info)
        assert not {"object", "number", "late"} & set(one.info)
        np.testing.assert_array_equal(one.info["place"], recording.position[1:])
        np.testing.assert_array_equal(one.info["height"], recording.position[1:, :, 2])


def change(path, **changes):
    """Write the arrays of a file again, without those that are None."""
    with np.load(path) as file:
        arrays = {**file, **changes}
    np.savez(path, **{name: array for name, array in arrays.items() if array is not None})


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"version": None}, "without a version, and version 5 is needed: fly the episode again"),
        ({"version": np.array(1)}, "of version 1, and version 5 is needed: .*or read it with"),
        ({"version": np.array(6)}, "of version 6, and version 5 is needed: .*or read it with"),
        ({"version": np.array("2")}, "of version 2, and version 5"),
        ({"version": np.array([2, 2])}, "of version"),
        ({"goal": None}, "damaged recording, without 'goal': fly the episode again"),
        ({"contact_step": None}, "damaged recording, without 'contact_step'"),
    ],
)
def test_a_recording_of_another_form_is_refused(flown, tmp_path, changes, said):
    aviary, recording, _ = flown
    path, *_ = save(recording, aviary, "straight", 0, tmp_path)
    change(path, **changes)
    with pytest.raises(ValueError, match=f"{re.escape(str(path))} is a .*{said}"):
        load(path)


def test_what_is_no_recording_is_refused(tmp_path):
    path = tmp_path / "trajectory.npz"
    with pytest.raises(FileNotFoundError, match="no recording file .*trajectory.npz"):
        load(tmp_path)
    with pytest.raises(ValueError, match="path of the recording file is 5"):
        load(5)
    np.savez(path, position=np.array([None]))
    for content in (path.read_bytes(), b"", b"zzz", path.read_bytes()[:100]):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=f"{re.escape(str(path))} is not a recording"):
            load(path)
    with path.open("wb") as file:
        np.save(file, np.zeros(3))
    with pytest.raises(ValueError, match="is not a recording"):
        load(path)


def test_contacts_are_crosses_in_pictures(flown, tmp_path, monkeypatch):
    _, recording, _ = flown
    drawn = []
    monkeypatch.setattr(pictures, "save_figure", lambda figure, path: drawn.append(figure))
    plot_tracks(recording, 5.0, "touching", tmp_path / "touching.png")
    nothing = {name: value[:0] for name, value in recording.arrays().items() if "contact_" in name}
    plot_tracks(dataclasses.replace(recording, **nothing), 5.0, "free", tmp_path / "free.png")
    touching, free = ({line.get_label(): line for line in figure.axes[0].lines} for figure in drawn)
    np.testing.assert_array_equal(touching["contact"].get_xydata(), recording.contact_point[:, :2])
    assert touching["contact"].get_marker() == "+"
    assert "contact" not in free
    assert "start of conflict" in free


@pytest.mark.parametrize("ratio", [0.02, 1.0, 20.0])
def test_the_legend_of_tracks_covers_nothing(flown, ratio, tmp_path, monkeypatch):
    """However flat the view from above is."""
    _, recording, _ = flown
    drawn = []
    monkeypatch.setattr(pictures, "save_figure", lambda figure, path: drawn.append(figure))
    stretched = {
        name: getattr(recording, name) * np.array([1.0, ratio, 1.0])
        for name in ("position", "goal", "obstacle", "contact_point")
    }
    plot_tracks(dataclasses.replace(recording, **stretched), 5.0, "flat", tmp_path / "flat.png")
    (figure,) = drawn
    figure.draw_without_rendering()
    above = figure.axes[0]
    legend = above.get_legend().get_window_extent()
    assert not legend.overlaps(above.xaxis.get_tightbbox())
    assert not legend.overlaps(above.get_window_extent())
    assert legend.y0 >= 0


def test_pictures_are_drawn(flown, tmp_path):
    _, recording, _ = flown
    plot_tracks(recording, 5.0, "title", tmp_path / "tracks.png")
    whole = {
        "building",
        "obstacle_axis",
        *(name for name in recording.arrays() if "contact_" in name),
    }
    alone = {
        name: value[:, :1] if value.ndim > 1 and name not in whole else value
        for name, value in recording.arrays().items()
    }
    alone["info"] = {name: value[:, :1] for name, value in recording.info.items()}
    plot_tracks(Recording(**alone), 5.0, "one drone", tmp_path / "alone.png")
    with Image.open(tmp_path / "tracks.png") as image:
        assert image.size == (2090, 715)  # with a view in three dimensions
    animation = Animation(recording, 5.0, 0.55, "title")
    caption = animation.figure.axes[-1].get_xlabel()
    assert "Crosses: goals" in caption
    assert "Dots" not in caption
    assert "true: 0.55 m" in caption
    assert "Circles: diameter d_safe = 5 m" in caption
    frames = []
    animation.save(tmp_path / "flight.gif", lambda: frames.append(1))
    with Image.open(tmp_path / "flight.gif") as image:
        assert image.n_frames == len(animation) == len(recording.time)
    assert len(frames) == len(animation)


def test_a_frame_needs_no_layout_of_text(flown, monkeypatch):
    """It takes longer than all else: the outlines of characters are made once."""
    _, recording, _ = flown
    animation = Animation(recording, 5.0, 0.55, "title")
    frames = [animation.draw(row) for row in (0, 3)]
    monkeypatch.setattr(Text, "draw", None)
    np.testing.assert_array_equal(animation.draw(0), frames[0])
    assert (animation.draw(3) != frames[0]).any()


def test_moving_parts_are_drawn_at_their_positions(flown):
    """Pixels that change are near the track or the clock, and some at each position."""
    _, recording, _ = flown
    animation = Animation(recording, 0.5, 0.55, "title")
    row = 5
    changed = np.flipud((animation.draw(row) != animation.draw(0)).any(axis=-1))
    allowed = np.zeros_like(changed)
    above, south = animation.figure.axes
    for axes, along in ((above, (0, 1)), (south, (0, 2))):
        for place in recording.position[: row + 1][..., along].reshape(-1, 2):
            x, y = axes.transData.transform(place).astype(int)
            assert changed[y - 8 : y + 8, x - 8 : x + 8].any()
            allowed[y - 20 : y + 20, x - 20 : x + 20] = True
    right, top = above.bbox.max.astype(int)
    allowed[top - 30 : top, right - 120 : right] = True
    assert not (changed & ~allowed).any()


def test_all_text_fits_into_the_animation(flown):
    """Whatever kinds of symbols the caption explains."""
    _, recording, _ = flown
    rows = len(recording.time)
    whole = dataclasses.replace(
        recording,
        target=np.zeros((rows, 2, 3)),
        seen=np.ones((rows, 2), dtype=bool),
        building=np.array([[[-1000.0, -1000.0, 0.0], [-900.0, -900.0, 100.0]]]),
    )
    figure = Animation(whole, 12.5, 0.55, "lidar_navigation: 16 hummingbird, planner").figure
    needed = figure.get_tightbbox(figure.canvas.get_renderer())
    assert (needed.min >= 0).all()
    assert (needed.max <= figure.get_size_inches()).all()


def test_pictures_are_drawn_once(flown, tmp_path, monkeypatch):
    _, recording, _ = flown
    draws = []
    draw = Figure.draw
    monkeypatch.setattr(Figure, "draw", lambda self, one: (draws.append(self), draw(self, one)))
    plot_tracks(recording, 5.0, "title", tmp_path / "tracks.png")
    assert len(draws) == 1


def test_long_flights_are_drawn_in_few_frames(flown):
    _, recording, _ = flown
    repeated = {
        name: np.repeat(value, 40, axis=0) if len(value) > 3 else value
        for name, value in recording.arrays().items()
    }
    repeated["alive"] = np.ones((len(repeated["time"]), 3), dtype=bool)
    assert len(Animation(Recording(**repeated), 5.0, 0.55, "title")) <= 151


def test_video_needs_its_extra_and_says_so(flown, tmp_path, monkeypatch):
    _, recording, _ = flown
    monkeypatch.setitem(__import__("sys").modules, "imageio_ffmpeg", None)
    with pytest.raises(ImportError, match=r"pip install -c .*constraints.txt .*\[video\]'"):
        Animation(recording, 5.0, 0.55, "title").save(tmp_path / "flight.mp4")


def test_video_is_written(flown, tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    _, recording, _ = flown
    animation = Animation(recording, 5.0, 0.55, "title")
    animation.save(tmp_path / "flight.mp4")
    assert ffmpeg.count_frames_and_secs(str(tmp_path / "flight.mp4"))[0] == len(animation)


def test_policies_say_which_actions_they_give():
    aviary = bulletuav.Aviary("hover")
    with pytest.raises(
        ValueError,
        match="supports velocity or velocity_increment or target_position actions, not 'rotor'",
    ):
        find_policy("straight")(aviary)
    with pytest.raises(ValueError, match="did you mean 'straight'"):
        find_policy("strait")


@pytest.mark.parametrize("action", ["velocity", "target_position"])
def test_straight_reaches_the_target_of_hover(action):
    aviary = bulletuav.Aviary("hover", action=action, num_drones=2)
    recording = fly_episode(aviary, find_policy("straight")(aviary), seed=0)
    assert all(row.reached for row in outcomes(recording))
    aviary.close()


def test_users_are_recorded_and_drawn_by_whether_they_are_seen(tmp_path):
    aviary = bulletuav.Aviary("mobile_users", area=200.0, num_layouts=1, num_users=12, horizon=20)
    recording = fly_episode(aviary, find_policy("kmeans")(aviary), seed=0)
    again = aviary.reset(seeds=0)
    policy, served = find_policy("kmeans")(aviary), [aviary.first_info()["served"][0, 0]]
    policy.reset(np.ones(1, dtype=bool))
    for _ in range(20):
        step = aviary.step(policy.act(again, aviary.swarm))
        again = step.observations
        served.append(step.info["served"][0, 0])
    np.testing.assert_allclose(recording.seen.mean(axis=1), served)
    assert 0 < recording.seen.mean() < 1
    assert recording.target.shape == (21, 12, 3)
    assert recording.goal.shape == (21, 0, 3)
    np.testing.assert_allclose(recording.get_info("served")[:, 0], served[1:])
    pace = np.linalg.norm(np.diff(recording.target, axis=0), axis=-1)
    assert 0 < pace.max() <= 3.0 + 1e-9  # 1 s at the speed of users
    plot_tracks(recording, 2.0, "users", tmp_path / "tracks.png", {"served": "served"})
    assert (tmp_path / "tracks.png").stat().st_size > 10000
    picture = Animation(recording, 2.0, 0.55, "users").draw(20).astype(int)
    green, red = (
        np.abs(picture - colour).max(axis=-1) < 30 for colour in ((34, 136, 51), (204, 51, 17))
    )
    assert green.any() == recording.seen[20].any()
    assert red.any() == (~recording.seen[20]).any()
    aviary.close()


def panels(recording, shows, tmp_path, monkeypatch):
    """Panels of a picture beside the map: what each is called, and how many lines it has."""
    drawn = []
    monkeypatch.setattr(pictures, "save_figure", lambda figure, path: drawn.append(figure))
    plot_tracks(recording, 5.0, "title", tmp_path / "tracks.png", shows)
    told = {axes.get_ylabel(): len(axes.lines) for axes in drawn[0].axes[1:]}
    told.pop("", None)  # the view in three dimensions
    return told


def test_panels_are_those_that_the_task_shows(flown, tmp_path, monkeypatch):
    """A line for each drone, one of d_safe, and one alone for what is the same for all."""
    aviary, recording, _ = flown
    wanted = {"altitude (m)": 3, "nearest (m)": 4, "to goal (m)": 3}
    assert panels(recording, aviary.task.shows, tmp_path, monkeypatch) == wanted
    same = np.broadcast_to(
        np.linspace(0, 1, len(recording.reward))[:, None], (len(recording.reward), 3)
    )
    together = dataclasses.replace(recording, info={**recording.info, "served": same})
    shows = {"served": "served", "collision": "collisions"}
    assert panels(together, shows, tmp_path, monkeypatch) == {"altitude (m)": 3, "served": 1}
    with pytest.raises(ValueError, match="unknown info of the recording 'servd'"):
        panels(together, {"servd": "served"}, tmp_path, monkeypatch)
