"""Every example runs, in its shortest form, and does what it says."""

import importlib
import re
import runpy
from pathlib import Path

import numpy as np
import pytest
import sensing
import yaml

import bulletuav
from bulletuav.policies.pad_vision import picture_rays

ROOT = Path(__file__).parent.parent
FOLDER = ROOT / "examples"
GYM = "from_gym_pybullet_drones"
EXAMPLES = {
    "step_response": "",
    "pid_flight": "--seconds 2",
    "custom_task": "--seconds 2 --drones 3",
    "custom_airframe": "--payload 0.5",
    "ppo_hover": "--steps 1 --episodes 1",
    "ppo_crossing": "--steps 1 --episodes 1",
    "dqn_discrete": "--steps 5200 --episodes 1",
    "camera_cnn": "--steps 1 --episodes 1 --forests 2",
    "domain_randomisation": "--steps 1 --episodes 1",
    "curriculum": "--steps 1 --episodes 1",
    "behaviour_cloning": "--flights 20 --epochs 1 --episodes 2",
    "torchrl_mappo": "--steps 1 --episodes 2",
    "fast_ppo": "crossing --critic state --steps 1 --episodes 2",
    "pillars": "--density 0.6 --episodes 1",
    "streets": "--stack --steps 1 --episodes 1",
    "depth_ppo": "--steps 1 --episodes 1",
    "search_ppo": "--cloned 2 --steps 1 --episodes 1",
    "pad_landing_ppo": "--rounds 1 --steps 1 --episodes 1",
    "dagger": "race --rounds 2 --decisions 5 --updates 2",
    "team_critics": "maddpg --steps 1 --episodes 2",
    "self_play": "--rounds 1 --steps 1 --episodes 2",
    "plan_ahead": "--decisions 3 --plans 4 --ahead 3",
    "own_pid": "",
    "figure_eight": "--out figure_eight",
    "rotor_control": "--seconds 2",
    "exchange_places": "--seconds 4",
    "crash_and_recovery": "--blow 12",
    f"{GYM}/pid": "--seconds 4",
    f"{GYM}/downwash": "--seconds 4",
    f"{GYM}/learn": "--steps 1",
}
"""Arguments of the shortest form"""
BY_HAND = {"rllib_ppo", "betaflight_loop"}
"""Examples that need what the suite has not: Ray, Betaflight"""
PICTURES = {
    "pid_flight": "square.png",
    "custom_task": "idleness.png",
    "custom_airframe": "step.png",
    "ppo_hover": "flight.png",
    "ppo_crossing": "flight.png",
    "pillars": "paths.png",
    "camera_cnn": "flight.png",
    "figure_eight": "eight.png",
    "rotor_control": "recovery.png",
    "exchange_places": "exchange.png",
    "crash_and_recovery": "crash.png",
    f"{GYM}/pid": "circles.png",
    f"{GYM}/downwash": "heights.png",
}
MODELS = {
    "ppo_hover": {"model.zip"},
    "ppo_crossing": {"model.zip"},
    "dqn_discrete": {"untrained.zip", "trained.zip"},
    "camera_cnn": {"model.zip"},
    "domain_randomisation": {"certain.zip", "uncertain.zip"},
    "curriculum": {"model.zip"},
    "self_play": {"chaser.zip", "evader.zip"},
    f"{GYM}/learn": {"model.zip"},
}
NUMBER = r"(-?\d+(?:\.\d+)?|nan|-?inf)"


def numbers(pattern, text):
    """What stands where the pattern has `#`; at least one match."""
    found = re.findall(pattern.replace("#", NUMBER), text)
    assert found, f"{pattern!r} is not in {text!r}"
    values = np.array(found, dtype=float)
    assert np.isfinite(values).all()
    return values


def test_every_example_is_tested_and_short():
    paths = [*FOLDER.glob("*.py"), *FOLDER.glob(f"{GYM}/*.py")]
    names = {path.relative_to(FOLDER).with_suffix("").as_posix() for path in paths}
    assert names == set(EXAMPLES) | BY_HAND
    for path in paths:
        assert len(path.read_text().splitlines()) <= 360, path.name


@pytest.mark.parametrize("name", [name for name, arguments in EXAMPLES.items() if arguments])
def test_help_tells_what_one_sees(name, run_program, capsys):
    with pytest.raises(SystemExit) as end:
        run_program(FOLDER / f"{name}.py", "--help")
    assert end.value.code == 0
    told = capsys.readouterr().out
    assert f"python examples/{name}.py" in told
    assert "Takes" in told


@pytest.mark.parametrize("name", EXAMPLES)
def test_it_runs(name, run_program, tmp_path):
    told = run_program(FOLDER / f"{name}.py", EXAMPLES[name])
    short = Path(name).name
    folder = tmp_path / short
    CHECKS[short](told, folder)
    written = {path.name for path in tmp_path.rglob("*") if path.is_file()}
    assert {path.name for path in tmp_path.iterdir()} <= {short}, "writes outside its folder"
    assert MODELS.get(name, set()) == {file for file in written if file.endswith(".zip")}
    if name in PICTURES:
        assert (folder / PICTURES[name]).read_bytes().startswith(b"\x89PNG")


def check_step_response(told, folder):
    overshoot, settling = numbers(r"overshoot # %, settles in # s", told).T
    assert len(overshoot) == 2
    assert (overshoot < 30).all()
    assert (settling < 10).all()


def check_pid_flight(told, folder):
    mean, most, _ = numbers(r"error # cm on average, # cm at most, # cm", told)[0]
    assert 0 < mean < most < 50


def check_custom_task(told, folder):
    rows = numbers(r"success #, conflicts #, worst idleness at the end # s", told)
    assert rows[:, 2] == pytest.approx(2.0)  # in two seconds no one comes round


def check_custom_airframe(told, folder):
    airframe = bulletuav.load_airframe(folder / "hexacopter.urdf")
    assert airframe.mass == pytest.approx(0.95 + 0.5 + 6 * (0.075 + 0.035))
    assert len(airframe.rotors) == 6
    formula, engine = numbers(r"hover speed # rad/s by formula, # rad/s", told)[0]
    assert formula == pytest.approx(airframe.hover_speed(), abs=0.05)
    assert engine == pytest.approx(formula, rel=1e-3)
    assert numbers("thrust to weight #", told)[0] > 2


def check_ppo_hover(told, folder):
    success, low, high = numbers(r"in bullet: success # \(# to #\)", told)[0]
    assert 0 <= low <= success <= high <= 1
    assert numbers(r"goal_distance # ", told)[0] < 20


def check_ppo_crossing(told, folder):
    rows = dict(re.findall(r"^(ppo|straight|orca) +(.*)$", told, re.MULTILINE))
    table = {name: [float(number) for number in row.split()] for name, row in rows.items()}
    assert [len(row) for row in table.values()] == [7, 7, 7]
    assert table["orca"][0] == 1  # all reach their goals
    assert table["straight"][3] > table["orca"][3]  # conflicts
    assert table["ppo"][0] == 0  # which has learned nothing yet


def check_torchrl_mappo(told, folder):
    assert numbers("# decisions: mean reward #", told)[0, 0] == 32 * 64 * 4
    rows = numbers(r"in bullet: drone_success # \(# to #\)", told)
    assert len(rows) == 2
    assert (rows[:, 0] < 0.5).all()  # which has learned nothing yet
    assert (folder / "agent.pt").stat().st_size > 10_000


def check_fast_ppo(told, folder):
    assert numbers("# decisions: mean return #", told)[0, 0] == 32 * 32 * 8
    success, low, high = numbers(r"in bullet: success # \(# to #\)", told)[0]
    assert success == low == 0 < high  # which has learned nothing yet
    assert {path.name for path in folder.rglob("*.*")} == {"run.yaml", "policy.safetensors"}
    text = (folder / "run.yaml").read_text()
    assert text.startswith("# Learned by `examples/fast_ppo.py`.\n")
    told = {"version", "task", "algo", "seed", "steps", "options", "model", "constants"}
    assert set(yaml.safe_load(text)) == told


def check_pillars(told, folder):
    there, low, high, lost = numbers(r"at the goal # \(# to #\), lost #", told)[0]
    assert 0.8 < there <= 1
    assert low <= there <= high
    assert 0 <= lost <= 1 - there


def test_the_teacher_among_pillars_knows_when_it_touches():
    """By hand: a point at 2 m/s, balls of 1 m around it; one that moves along, one that is left."""
    time_to = runpy.run_path(str(FOLDER / "pillars.py"))["time_to"]
    gap = np.array([[[[3.0, 0.0, 0.0], [0.0, 4.0, 3.0]]]])
    tries = np.array([[[[2.0, 0.0, 0.0], [0.0, 1.6, 1.2], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]]])
    reach = np.ones((1, 1, 2))
    still = time_to(gap, tries, 0 * gap, reach)
    np.testing.assert_allclose(still, [[[1.0, 2.0, np.inf, np.inf]]])
    # Whoever flies away as fast is never met, and whoever comes is met though one waits
    moved = np.array([[[[2.0, 0.0, 0.0], [0.0, -0.8, -0.6]]]])
    np.testing.assert_allclose(time_to(gap, tries, moved, reach), [[[np.inf, 4 / 3, np.inf, 4.0]]])
    # Within reach it is at once if it comes nearer, and never if it leaves
    np.testing.assert_allclose(time_to(gap, tries, 0 * gap, 3.5 * reach)[0, 0, [0, 2]], [0, np.inf])


def check_dagger(told, folder):
    assert numbers("# decisions: loss #", told)[:, 0].tolist() == [5 * 128, 10 * 128]
    assert {path.name for path in folder.rglob("*.*")} == {"run.yaml", "policy.safetensors"}
    text = (folder / "run.yaml").read_text()
    assert text.startswith("# Learned by `examples/dagger.py`.\n")
    assert yaml.safe_load(text)["steps"] == 10 * 128
    result = bulletuav.evaluate("race", folder, 1, difficulty="easy")
    assert result.estimates()["drone_success"].mean == 0  # which has learned nothing yet


def check_streets(told, folder):
    assert numbers("# decisions: mean return #", told)[0, 0] == 64 * (40 * 3 + 24 * 5 + 15 * 8)
    reached, low, high = numbers(r"at medium # \(# to #\) reach their goals", told)[0]
    assert reached == low == 0 <= high  # which has learned nothing yet
    # It flies with the sensor that it learned with, where its module is trusted
    settings = yaml.safe_load((folder / "run.yaml").read_text())
    assert settings["options"]["sensors"] == ["streets:Earlier"]
    with pytest.raises(ValueError, match="whose module would be imported"):
        bulletuav.evaluate("lidar_navigation", folder, 1)


def check_depth_ppo(output, folder):
    assert numbers("# decisions: mean return #", output)[0, 0] == 64 * (40 * 3 + 24 * 5 + 15 * 8)
    # float32 of PyTorch and of ONNX Runtime
    assert numbers(r"ONNX file differ by at most #e-0#", output)[0, 1] >= 6
    reached, low, high = numbers(r"at medium # \(# to #\) reach their goals", output)[0]
    assert reached == low == 0 <= high  # which has learned nothing yet
    settings = yaml.safe_load((folder / "run.yaml").read_text())
    assert settings["options"]["action"] == "turn_speed"
    assert (folder / "policy.onnx").stat().st_size > 10_000


def check_pad_landing_ppo(output, folder):
    assert numbers("# decisions: loss #", output)[0, 0] == 40 * 192
    assert numbers("# decisions: mean return #", output)[0, 0] == 64 * 192
    found = numbers("at medium: success #, score #, landed after # s", output)
    assert len(found) == 2
    assert (found[:, :2] == 0).all()  # which has learned nothing yet
    settings = yaml.safe_load((folder / "run.yaml").read_text())
    assert settings["options"]["sensors"] == ["pad_landing_ppo:HeightMap"]


def test_heights_in_pictures_are_mapped_to_cells(monkeypatch):
    """By hand: ground 10 m below a level drone, with a pixel 2 m above it, and sky."""
    monkeypatch.syspath_prepend(FOLDER)
    example = importlib.import_module("pad_landing_ppo")
    half = np.sqrt(0.5)
    rise = picture_rays((64, 64), np.pi / 2) @ (-half, 0.0, half)  # of a camera 45 degrees down
    depth = -10.0 / rise
    depth[40, 21] *= 0.8
    depth[:4, :4] = 2000.0
    mount = (0.0, np.sin(np.pi / 8), 0.0, np.cos(np.pi / 8))
    maps = np.zeros((1, 1, 2, 16, 16), np.float32)
    level, mask = np.array([[[0.0, 0.0, 0.0, 1.0]]]), np.ones((1, 1), dtype=bool)
    picture = depth[None, None].astype(np.float32)
    example.map_heights(picture, level, mount, mask, np.zeros((64, 64)), maps)
    top, mean = maps[0, 0]
    assert np.argwhere(top > 0.01).tolist() == [[10, 5]]
    assert top[10, 5] == pytest.approx(np.log(21) / np.log(151), rel=1e-4)
    assert mean[10, 5] == pytest.approx(-np.log(1 + 98.75) / np.log(151), rel=1e-4)
    assert mean[0, 0] == 0
    np.testing.assert_allclose(mean[1:, 9], -np.log(101) / np.log(151), rtol=1e-4)


def test_height_maps_are_of_every_second_pixel_of_the_task():
    options = {"dynamics": "rigid_body", "observation": ["depth"]}
    whole, half = (
        bulletuav.Aviary("pad_landing", 1, **options, camera_size=(side, side))
        for side in (128, 64)
    )
    seen = [one.reset(seeds=3)["depth"] for one in (whole, half)]
    np.testing.assert_array_equal(seen[0][..., 1::2, ::2], seen[1])
    whole.close()
    half.close()


def test_what_a_camera_drone_observes_of_goal_and_bounds(monkeypatch):
    """By hand: a drone at (10, 20, 5) m whose nose points north, in a square of 100 m."""
    monkeypatch.syspath_prepend(FOLDER)
    egocentric = importlib.import_module("depth_ppo").egocentric
    north = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))
    goal = np.array((10.0 - 30.0, 20.0 + 40.0, 7.0))  # 50 m away, to the left ahead
    bounds = (100.0, 100.0, 15.0, 0.0, 0.0)  # east, north, up, west, south
    seen = egocentric((10.0, 20.0, 5.0), north, goal, *bounds)
    expected = (0.8, 0.6, 50, 2, 60, 10, 60, 10, 5, 0, 0)  # at most 60 m are observed
    np.testing.assert_allclose(seen, expected, atol=1e-9)


def check_search_ppo(output, folder):
    assert numbers("cloned `sweep` from # decisions", output)[0] == 2 * 64 * 3
    assert numbers("# decisions: mean return #", output)[0, 0] == 64 * 64 * 3
    safe, low, high = numbers(r"safe_success # \(# to #\)", output)[0]
    assert safe == low == 0 <= high  # which has learned nothing yet
    options = yaml.safe_load((folder / "run.yaml").read_text())["options"]
    assert "decision_hz" not in options  # flies at that of the task


def test_what_a_searching_drone_observes_of_the_squares(monkeypatch):
    """By hand: four squares of 20 m; one is searched, and one is nearer to another drone."""
    monkeypatch.syspath_prepend(FOLDER)
    module = importlib.import_module("search_ppo")
    position = np.array([(10.0, 10.0, 9.0), (30.0, 24.0, 9.0), (0.0, 0.0, 9.0)])
    alive = np.array([True, True, False])  # the third drone is lost
    searched, ground = np.array([0.0, 0.0, 0.0, 1.0]), np.ones(4)
    clue, out = np.array((20.0, 20.0, 0.0)), np.full(len(module.LABELS), np.nan)
    sighting = (1.0, 16.0, 12.0, -9.0)  # 20 m away, 4.5 m from the other drone
    state = position[0], searched, sighting, position, alive, ground, clue, 20.0
    module.unsearched(0, *state, out)
    rings, sectors = len(module.RINGS), module.SECTORS
    whole, own = out[: 2 * rings * sectors].reshape(2, rings, sectors)
    # Squares at (10, 10), (10, 30) and (30, 10) m; the last is 14 m from the other drone
    expected = np.zeros((rings, sectors))
    expected[0, 0], expected[2, 3] = 1.0, 1.0  # here, and 20 m north
    np.testing.assert_allclose(own, expected, atol=1e-12)
    expected[2, 0] = 1.0  # 20 m east
    np.testing.assert_allclose(whole, expected, atol=1e-12)
    np.testing.assert_allclose(out[-5:], (0, 0, 0, 0, 1), atol=1e-12)
    # Between two sectors and two rings
    place = np.zeros(rings * sectors)
    module.add_to_map(place, 0, 14 * np.cos(np.pi / 4), 14 * np.sin(np.pi / 4))
    grid = place.reshape(rings, sectors)
    np.testing.assert_allclose(grid[1:3, 1:3], np.full((2, 2), 0.25))
    assert grid.sum() == pytest.approx(1.0)


def test_ranges_of_half_a_second_ago_are_of_the_same_episode(monkeypatch):
    """By hand: a range that grows by 1 m in each decision of 0.25 s, in two worlds."""
    monkeypatch.syspath_prepend(FOLDER)
    earlier = runpy.run_path(str(FOLDER / "streets.py"))["Earlier"]
    sensor = sensing.sensor_of(earlier, (2, 1), period=0.25, beams=((0.0, 0.0), (90.0, 0.0)))
    swarm, told = sensing.swarm_of(2, 1), []
    for steps, ranges in [
        ((0, 0), (9, 4)),
        ((1, 1), (10, 5)),
        ((2, 0), (11, 6)),
        ((3, 1), (12, 7)),
    ]:
        readings = {"lidar": np.broadcast_to(np.reshape(ranges, (2, 1, 1)), (2, 1, 2)) * (1.0, 2.0)}
        told.append(sensing.measure(sensor, swarm, steps=steps, readings=readings)["earlier"])
    # The first world remembers two decisions, the second began anew in the third
    beam = np.exp(np.array(told)[..., 0, 0])
    np.testing.assert_allclose(beam[:, 0], [1, 10 / 11, 10 / 12, 11 / 13])
    np.testing.assert_allclose(beam[:, 1], [1, 5 / 6, 1, 7 / 8])
    np.testing.assert_allclose(np.exp(told[-1][0, 0, 1]), 21 / 25)


def check_team_critics(told, folder):
    success, low, high = numbers(r"drone_success # \(# to #\)", told)[0]
    assert success == low == 0 < high  # which has learned nothing yet
    assert {path.name for path in folder.rglob("*.*")} == {"run.yaml", "policy.safetensors"}
    text = (folder / "run.yaml").read_text()
    assert text.startswith("# Learned by `examples/team_critics.py maddpg`")
    told = {"version", "task", "algo", "seed", "steps", "worlds", "options", "model", "constants"}
    assert set(yaml.safe_load(text)) == told


def check_dqn_discrete(told, folder):
    rows = numbers(
        r"ed in (?:point_mass|bullet): drone_success #, conflict #, conflicts #, goal_distance #",
        told,
    )
    assert len(rows) == 3
    assert (rows[:, 0] <= 1).all()
    assert (folder / "trained.zip").read_bytes() != (folder / "untrained.zip").read_bytes()


def check_camera_cnn(told, folder):
    rows = numbers(r": success # \(# to #\)", told)
    assert len(rows) == 3
    assert (rows[:, 1] <= rows[:, 0]).all()
    assert (rows[:, 0] <= rows[:, 2]).all()


def check_domain_randomisation(told, folder):
    rows = numbers(r"\n(?:certain|uncertain) +(?:certain|uncertain) +# +# +#", told)
    success, distance, collision = rows.T
    assert len(rows) == 4
    assert ((success >= 0) & (success <= 1) & (distance < 20) & (collision <= 1)).all()


def check_curriculum(told, folder):
    rows = numbers(r"stage # in bullet: success of drones #, episodes with conflict #", told)
    assert list(rows[:, 0]) == [0, 1, 2, 3]
    assert (rows[:, 1:] <= 1).all()


def check_self_play(told, folder):
    shares = numbers(r"wander #, against flee #, evader, against lead #, both #", told)
    assert len(shares) == 1
    assert ((shares >= 0) & (shares <= 1)).all()


def check_plan_ahead(told, folder):
    flown = numbers(r"(?:straight|planned): return #, conflicts #", told)
    assert len(flown) == 2
    assert (flown[:, 1] >= 0).all()


def check_behaviour_cloning(told, folder):
    assert numbers("# decisions of 20 flights", told)[0] > 5000
    shares = numbers(r"(?:random|clone|orca): # \(", told)
    assert len(shares) == 3
    assert shares[2] == 1


def check_own_pid(told, folder):
    errors = numbers(r"after \d s the error is # cm", told)
    assert len(errors) == 8
    assert errors[0] > 10 > errors[4]
    assert numbers(r"last second the error is # cm", told)[0] < 2
    source = (FOLDER / "own_pid.py").read_text()
    core = source[source.index("import numpy") : source.index("\nfor second")].splitlines()
    assert len([line for line in core if line and not line.strip().startswith("#")]) <= 25


def check_figure_eight(told, folder):
    assert 0 < numbers(r"overshoots by # cm", told)[0] < 5
    speed, rms, most = numbers(r"at # m/s on average: error # cm rms, # cm at most", told)[0]
    assert speed == pytest.approx(1.0, abs=0.01)
    assert rms < 5
    assert rms < most < 10
    assert numbers(r"it rests on the ground, # cm beside", told)[0] < 1


def check_rotor_control(told, folder):
    settled, falls, drifts = numbers(r"in # s, falls # cm, drifts # cm", told)[0]
    assert 0.2 < settled < 1.6
    assert falls < 40
    assert drifts < 150
    tilt, height = numbers(r"the tilt is # degrees, the height # m", told)[0]
    assert tilt < 1
    assert height == pytest.approx(2.0, abs=0.01)


def check_exchange_places(told, folder):
    beside, above = numbers(r"separation # m at least, errors # and # cm at most", told)
    assert beside[0] > 0.9
    assert above[0] > 0.4
    # The wake of the upper drone pushes the lower one
    assert above[2] > 2 * beside[2]
    assert (numbers(r"# cm from the other's place", told) < 2).all()


def check_crash_and_recovery(told, folder):
    hits = numbers(r"at \(#, #, #\) m with # m/s and # mN s", told)
    ground = numbers(r"touches the ground at \(#, #, #\) m with # m/s", told)
    assert len(hits) > len(ground) >= 1  # the roof, too
    assert (hits[:, 2] < 0.61).all()
    assert ground[0][2] == pytest.approx(0.0, abs=0.01)
    assert (hits[:, 4] > 0).all()
    assert numbers(r"tilted by # degrees", told)[0] == pytest.approx(180, abs=1)
    away, error = numbers(r"moved it by # cm; at the end the error is # cm", told)[0]
    assert 5 < away < 30
    assert error < 1


def check_pid(told, folder):
    rows = numbers(r"drone \d: error # cm on average, # at most", told)
    assert len(rows) == 3
    assert ((rows[:, 0] > 5) & (rows[:, 1] < 15)).all()


def check_downwash(told, folder):
    assert 1 < numbers(r"lower drone down by # cm", told)[0] < 10
    assert numbers(r"upper one by # cm", told)[0] == 0


def check_learn(told, folder):
    rows = numbers(r"learning: return # \+- #, ends # cm from", told)
    assert len(rows) == 2
    assert (rows[:, 0] < 240).all()
    assert (rows[:, 2] < 2000).all()


@pytest.mark.parametrize("name", ["pid", "downwash", "learn"])
def test_the_page_for_those_who_come_shows_lines_of_the_scripts(name):
    def bare(code):
        return re.sub(r"\s", "", code).replace(",)", ")")

    source = bare((FOLDER / GYM / f"{name}.py").read_text())
    page = (ROOT / "docs" / "howto" / f"migrate_{GYM}.md").read_text()
    (section,) = re.findall(rf"^## {name}\.py$(.*?)(?=^## |\Z)", page, re.MULTILINE | re.DOTALL)
    rows = re.findall(r"^\| .* \| (.*) \|$", section, re.MULTILINE)
    codes = [code for row in rows for code in re.findall(r"`([^`]+)`", row)]
    assert len(codes) >= 8
    assert [code for code in codes if bare(code) not in source] == []


CHECKS = {
    name.removeprefix("check_"): check
    for name, check in list(globals().items())
    if name.startswith("check_")
}
