import importlib.metadata
import json
import os
import re
import resource
import subprocess
import sys
import types

import llvmlite.binding as llvm
import numpy as np
import pytest

import bulletuav
from bulletuav import cli
from bulletuav.analysis.benchmark import ENGINE_CASES
from bulletuav.cli import COMMANDS, main
from bulletuav.commands.progress import EXPECTED_FUNCTIONS, show_progress
from bulletuav.compiled import dispatcher
from bulletuav.dynamics import DEFAULT_DYNAMICS, DYNAMICS
from bulletuav.engine import engine
from bulletuav.engine.c_extension import Extension
from bulletuav.engine.calls import HAS_BULLET
from bulletuav.envs.stages import decision_stages
from bulletuav.report import doctor
from bulletuav.tasks import find_task
from bulletuav.version import DOCUMENTATION

MAIN_JOB = ["fly", "crossing", "--drones", "8", "--policy", "straight", "--seed", "0"]
FILES = {"trajectory.npz", "trajectory.csv", "run.json", "tracks.png", "flight.gif"}


def test_the_main_job_from_another_directory(tmp_path):
    command = [sys.executable, "-m", "bulletuav", *MAIN_JOB, "--horizon", "30", "--out", "result"]
    run = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=True)
    assert {path.name for path in (tmp_path / "result").iterdir()} == FILES
    for word in (
        "drone_7",
        "success",
        "nearest",
        "conflicts",
        "collisions",
        "time (s)",
        "result/flight.gif",
    ):
        assert word in run.stdout
    assert "flying" in run.stderr
    assert "pybullet" not in run.stdout + run.stderr


def test_flying_with_options(tmp_path, capsys):
    options = [
        "--airframe",
        "cf2x",
        "--dynamics",
        "rigid_body",
        "--wind",
        "1",
        "0",
        "0",
        "--horizon",
        "20",
        "--animation",
        "none",
    ]
    main(
        [
            "fly",
            "hover",
            *options,
            "--set",
            "height=3.0",
            "--set",
            "effects=('drag',)",
            "--out",
            str(tmp_path),
        ]
    )
    assert not (tmp_path / "flight.gif").exists()
    assert '"height": 3.0' in (tmp_path / "run.json").read_text()
    assert (
        '"action": "velocity"' in (tmp_path / "run.json").read_text()
    )  # the policy's, as hover's own is not one
    assert "drone_0" in capsys.readouterr().out


def test_values_in_the_ways_people_write_them(tmp_path):
    words = [
        "--set",
        "wind=1,0,0",
        "--set",
        "weights={'goal':10}",
        "--set",
        "observation=position,goal",
        "--set",
        "turbulence=light",
    ]
    main(
        [
            "fly",
            "crossing",
            "--dynamics",
            "point_mass",
            *words,
            "--horizon",
            "5",
            "--animation",
            "none",
            "--out",
            str(tmp_path),
        ]
    )
    options = json.loads((tmp_path / "run.json").read_text())["options"]
    assert (options["wind"], options["weights"], options["observation"]) == (
        [1, 0, 0],
        {"goal": 10},
        ["position", "goal"],
    )


def test_no_animation_of_an_earlier_flight_is_left(tmp_path):
    (tmp_path / "flight.gif").write_text("old")
    main(["fly", "hover", "--horizon", "5", "--animation", "none", "--out", str(tmp_path)])
    assert not (tmp_path / "flight.gif").exists()


def test_the_benchmark_prints_the_stages_of_a_task(capsys):
    main(["benchmark", "--stages", "hover"])
    out = capsys.readouterr().out
    assert f"hover, 1 drone, {DEFAULT_DYNAMICS}: microseconds per decision" in out
    assert all(re.search(rf"{stage.name} .*\d\.\d", out) for stage in decision_stages())


def test_the_benchmark_prints_every_dynamics_and_the_floor(capsys):
    main(["benchmark", "--drones", "1", "3", "--seconds", "0.01"])
    said = capsys.readouterr().out
    for word in (*DYNAMICS, *ENGINE_CASES, "N = 1", "N = 3"):
        assert word in said


def test_tasks_are_listed_and_explained(capsys):
    main(["tasks"])
    assert [
        line.split()[0] for line in capsys.readouterr().out.splitlines()
    ] == bulletuav.list_tasks()
    main(["tasks", "crossing", "--all"])
    said = capsys.readouterr().out
    for word in (
        "Observation",
        "distance of the goal",
        "Action",
        "Reward",
        "End:",
        "lane_spacing",
        "15.0",
        "decision_hz=10",
    ):
        assert word in said
    assert "action by dynamics" not in said  # the same in all of them
    main(["tasks", "hover", "--all"])
    assert "action by dynamics" in capsys.readouterr().out


@pytest.mark.parametrize("task", bulletuav.list_tasks())
def test_the_summary_of_a_task_fits_on_a_page(task, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    main(["tasks", task])
    said = capsys.readouterr().out
    assert len(said.splitlines()) <= 45
    kind = find_task(task)
    for word in ("Observation", "Action", "Reward", "End:", "Success:", *kind.difficulties):
        assert word in said
    for option in {name for level in kind.difficulties.values() for name in level}:
        assert f"\n {option} " in said
    assert len(re.findall(r"^ \w+ +\S", said, re.MULTILINE)) >= 11  # with the headings
    assert f"bulletuav tasks {task} --all" in said


def test_the_observation_is_printed_number_by_number_with_the_options_given(capsys):
    main(
        [
            "tasks",
            "crossing",
            "--observation",
            "--drones",
            "3",
            "--set",
            "observation=identity,goal,rgb",
        ]
    )
    said = capsys.readouterr().out
    for word in (
        "index",
        "is drone 2",
        "goal distance",
        "375.068",
        "rgb",
        "picture",
        "one drone of 3",
    ):
        assert word in said
    assert "is drone 3" not in said


def test_evaluating_prints_and_writes_and_goes_on(tmp_path, capsys):
    command = [
        "evaluate",
        "converge",
        "--policy",
        "orca",
        "--episodes",
        "3",
        "--workers",
        "2",
        "--dynamics",
        "point_mass",
    ]
    command += ["--drones", "3", "--set", "radius=20.0", "--out", str(tmp_path / "run")]
    main(command)
    said = capsys.readouterr()
    for word in (
        "score of orca, which reads the true state: converge, difficulty medium, dynamics "
        "point_mass, 3 episodes, seeds 0 to 2, action velocity: success 1 [",
        "conflict",
        "95 % interval",
        "summary.png",
    ):
        assert word in said.out
    assert "flying: 3 of 3 episodes (100 %)" in said.err
    assert {path.name for path in (tmp_path / "run").iterdir()} == {
        "run.json",
        "episodes.csv",
        "summary.json",
        "summary.png",
    }
    main(command)
    table, again = (
        [line for line in text.splitlines() if "│" in line]
        for text in (said.out, capsys.readouterr().out)
    )
    assert table == again


def test_a_flight_does_not_go_into_the_folder_of_an_evaluation(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    common = [
        "converge",
        "--dynamics",
        "point_mass",
        "--drones",
        "1",
        "--horizon",
        "3",
        "--set",
        "normalise=true",
    ]
    main(["evaluate", *common, "--episodes", "1"])
    assert (tmp_path / "evaluation" / "converge-default-point_mass-orca" / "episodes.csv").exists()
    with pytest.raises(SystemExit):
        main(["fly", *common, "--out", "evaluation/converge-default-point_mass-orca"])
    assert "holds an evaluation" in capsys.readouterr().err


def test_an_interrupted_evaluation_tells_what_is_kept(tmp_path, capsys, monkeypatch):
    def interrupted(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr("bulletuav.commands.evaluate.evaluate", interrupted)
    with pytest.raises(SystemExit) as end:
        main(["evaluate", "converge", "--out", str(tmp_path)])
    assert end.value.code == 130
    assert "the same command resumes" in " ".join(capsys.readouterr().err.split())


def test_comparing_writes_a_leaderboard(tmp_path, capsys):
    common = [
        "--episodes",
        "2",
        "--dynamics",
        "point_mass",
        "--drones",
        "2",
        "--horizon",
        "30",
        "--out",
        str(tmp_path),
    ]
    main(
        [
            "compare",
            "--policies",
            "straight,random",
            "--tasks",
            "converge,follow",
            "--difficulties",
            "easy,hard",
            *common,
        ]
    )
    said = capsys.readouterr().out
    assert said.count("### ") == 4
    assert "| straight \\* |" in said
    assert (tmp_path / "leaderboard.md").read_text() in said
    assert {path.name for path in tmp_path.iterdir()} == {
        "leaderboard.md",
        "leaderboard.csv",
        "leaderboard.png",
        "leaderboard.json",
        "runs",
    }
    assert len(list((tmp_path / "runs").iterdir())) == 8
    main(["compare", "--policies", "straight", "--tasks", "converge", *common])
    assert "### converge, medium: 2 drones" in capsys.readouterr().out


COMPARED = [
    "compare",
    "--policies",
    "random",
    "--tasks",
    "mobile_users",
    "--episodes",
    "2",
    "--horizon",
    "3",
]
COMPARED += ["--set", "area=250.0", "--set", "num_layouts=1"]


def test_comparing_dynamics(tmp_path, capsys):
    main([*COMPARED, "--dynamics", "single_integrator,point_mass", "--out", str(tmp_path)])
    said = capsys.readouterr().out
    assert said.count("### ") == 1
    rows = [line for line in said.splitlines() if line.startswith("| random |")]
    assert ["single_integrator at 240 Hz" in row for row in rows] == [True, False]
    assert ["point_mass at 240 Hz" in row for row in rows] == [False, True]
    assert len({row.split("|")[-2] for row in rows}) == 2  # hashes of different flights
    runs = {
        path.name: json.loads((path / "run.json").read_text())
        for path in (tmp_path / "runs").iterdir()
    }
    assert {run["options"]["dynamics"] for run in runs.values()} == {
        "single_integrator",
        "point_mass",
    }
    assert len(runs) == 2
    main([*COMPARED, "--dynamics", "point_mass", "--out", str(tmp_path)])  # goes on with its run
    again = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| random |")]
    assert [cell for cell in rows[1].split("|") if "Hz" not in cell] == again[0].split("|")


def test_dynamics_are_listed_as_tasks_are(tmp_path, capsys):
    """With spaces, and each once."""
    main(
        [
            *COMPARED,
            "--dynamics",
            "single_integrator, point_mass,point_mass",
            "--out",
            str(tmp_path),
        ]
    )
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| random |")]
    assert len(rows) == 2


@pytest.mark.parametrize(
    "arguments", [["--help"], ["fly", "--help"], ["tasks", "--help"], ["--version"]]
)
def test_help(arguments, capsys):
    with pytest.raises(SystemExit) as end:
        main(arguments)
    assert end.value.code == 0
    said = capsys.readouterr().out
    assert ("bulletuav fly crossing --drones 8" in said) == (
        arguments in (["--help"], ["fly", "--help"])
    )
    assert said


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["fly", "crosing"], "did you mean 'crossing'"),
        (["fly", "crossing", "--drone", "8"], "unknown argument --drone: did you mean --drones"),
        (
            ["fly", "crossing", "--quick"],
            "unknown argument --quick: environment options that are not listed",
        ),
        (["doctor", "--quick"], "unknown argument --quick: there is no such option"),
        (["fly", "crossing", "--drones", "many"], "many: a number, or a range such as 4,12"),
        (["fly", "crossing", "--drones", "0"], "num_drones is 0"),
        (["fly", "crossing", "--policy", "strait"], "did you mean 'straight'"),
        (["fly", "crossing", "--set", "lanespacing=3"], "did you mean 'lane_spacing'"),
        (["fly", "crossing", "--set", "lane_spacing"], "NAME=VALUE"),
        (["fly", "crossing", "--set", "difficulty=esy"], "did you mean 'easy'"),
        (["fly", "crossing", "--decision-hz", "7"], "does not divide"),
        (["fly", "crossing", "--airframe", "nowhere.urdf"], "nowhere.urdf"),
        (
            ["fly", "crossing", "--action", "rpm"],
            "supports velocity or velocity_increment actions",
        ),
        (
            ["fly", "crossing", "--out", "/dev/null/x"],
            "--out /dev/null/x cannot be a folder to write to",
        ),
        (
            ["fly", "crossing", "--drones", "2", "--set", "num_drones=3"],
            "num_drones is given twice",
        ),
        (["fly", "crossing", "--set", "wind=nan,0,0"], "wind is nan: a finite number"),
        (["fly", "crossing", "--set", "weights=goal:1"], "weights is 'goal:1': a dict"),
        (["fly", "crossing", "--set", "start_speed=3"], "start_speed is 3: a list or tuple"),
        (["fly", "crossing", "--set", "observation=position,gaol"], "did you mean 'goal'"),
        (["benchmark", "--drones", "0"], "numbers above 0 are needed"),
        (["benchmark", "--stages", "hover", "--drones", "1"], "leave --drones and --seconds out"),
        (["fly", "crossing", "--seed", "-3"], "seed is -3"),
        (["evaluate", "converge", "--episodes", "0"], "episodes is 0"),
        (
            ["evaluate", "converge", "--policy", "ppo:nowhere.zip", "--episodes", "1"],
            "no model nowhere.zip",
        ),
        (["compare", "--policies", "straight"], "required: --tasks"),
        (["compare", "--policies", ",", "--tasks", "converge"], "',' has no name"),
        (["evaluate", "converge", "--set", "radius={[]:1}"], "radius is '{[]:1}'"),
        (["compare", "--policies", "strait", "--tasks", "converge"], "did you mean 'straight'"),
        (
            [
                "compare",
                "--policies",
                "straight",
                "--tasks",
                "converge",
                "--difficulty",
                "easy",
                "--difficulties",
                "hard",
            ],
            "give one of them",
        ),
        (
            [*COMPARED, "--dynamics", "point_mass,point_mas"],
            "unknown dynamics 'point_mas': did you mean 'point_mass'",
        ),
        ([*COMPARED, "--set", "dynamics=5"], "unknown dynamics '5'"),
        ([*COMPARED, "--against", "orc"], "unknown policy in --against, 'orc'"),
        (["tasks", "hoover"], "did you mean 'hover'"),
        (["flyy"], "unknown command 'flyy': did you mean 'fly'"),
        (["tran"], "unknown command 'tran': did you mean 'train'"),
        (["--versio"], "unknown argument --versio: did you mean --version?"),
        (["fly", "crossing", "more"], "unexpected argument more: the command takes no further"),
        # Whatever else is wrong with the words
        (["fly", "--polcy", "orca"], "unknown argument --polcy: did you mean --policy?"),
        (["compare", "--task", "hover"], "unknown argument --task: did you mean --tasks?"),
        (["identify", "--airfame=cf2x"], "unknown argument --airfame: did you mean --airframe?"),
        # Values of options
        (["fly", "hover", "--animation", "gof"], "--animation 'gof': did you mean 'gif'?"),
        (["fly", "hover", "--airframe", "humingbird"], "did you mean 'hummingbird'"),
        (["fly", "hover", "--dynamics", "point_mas"], "did you mean 'point_mass'"),
        (["fly", "hover", "--action", "velocty"], "did you mean 'velocity'"),
        (["fly", "hover", "--controller", "le"], "did you mean 'lee'"),
        (["fly", "hover", "--difficulty", "hrad"], "did you mean 'hard'"),
        (["fly", "hover", "--turbulence", "ligth"], "did you mean 'light'"),
        (["fly", "crossing", "--preset", "uavconflct"], "did you mean 'uavconflict'"),
        (["fly", "lidar_navigation", "--city", "urbann"], "did you mean 'urban'"),
        (["city", "--kind", "urbann"], "did you mean 'urban'"),
        (["serve", "crazyfly"], "did you mean 'crazyflie'"),
        (["train", "hover", "--algo", "pppo"], "did you mean 'ppo'"),
        (["evaluate", "hover", "--metric", "jerkk"], "did you mean 'jerk'"),
        (["export", "out", "--to", "mcapp"], "did you mean 'mcap'"),
        (["identify", "--example", "a.csv", "--airframe", "cf3x"], "did you mean 'cf2x'"),
        (["identify", "--airframe", "cf2x"], "Give either flight logs or --example FILE"),
    ],
)
def test_bad_input_ends_in_one_line_and_exit_code_2(arguments, said, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as end:
        main(arguments)
    out, err = capsys.readouterr()
    assert end.value.code == 2
    assert out == ""
    lines = [line for line in err.splitlines() if line]
    assert len(lines) == 1
    assert said in lines[0]


@pytest.mark.parametrize("name", COMMANDS)
def test_descriptions_in_the_help_are_wrapped(name, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit):
        main([name, "--help"])
    # Examples are commands to copy, each on one line
    before_examples = capsys.readouterr().out.partition("\nexample")[0]
    assert max(map(len, before_examples.splitlines())) <= 80


def test_the_help_lists_all_commands_and_a_first_example(capsys):
    with pytest.raises(SystemExit) as end:
        main(["--help"])
    assert not end.value.code
    out, err = capsys.readouterr()
    assert err == ""
    for command in COMMANDS:
        assert f"\n    {command}" in out
    assert "bulletuav fly crossing --drones 8" in out
    assert len(out.splitlines()) < 50


def test_without_arguments_a_menu_is_printed(capsys):
    """Every command in the menu is one that the command line accepts."""
    main([])
    out, err = capsys.readouterr()
    assert err == ""
    lines = out.splitlines()
    assert 8 <= len(lines) <= 12
    assert max(map(len, lines)) <= 80
    assert lines[-1] == f"Documentation: {DOCUMENTATION}"
    offered = [re.split(r"  +", line.strip()) for line in lines if line.startswith("  bulletuav ")]
    for example, _ in offered:
        _, *words = example.split()
        if words != ["--help"]:
            parser, _ = cli._parser(words)
            assert parser.parse_args(words).command == words[0]
    steps = [example.split()[1] for example, _ in offered]
    assert steps == ["tasks", "fly", "replay", "train", "evaluate", "doctor", "--help"]


def test_the_menu_imports_no_parser():
    program = "import sys; from bulletuav.cli import main; main([]); print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert "bulletuav.commands.parsers.fly" not in run.stdout.splitlines()[-1].split()
    assert run.stdout.startswith(cli.MENU)


def test_an_interrupt_ends_quietly(monkeypatch):
    def interrupted(arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr("bulletuav.commands.tasks.run", interrupted)
    with pytest.raises(SystemExit) as end:
        main(["tasks"])
    assert end.value.code == 130


def test_the_doctor_tells_what_is_active(capsys, monkeypatch):
    main(["doctor"])
    out = capsys.readouterr().out
    assert "pybullet" in out
    assert "C extension" in out
    state = {finding.subject: finding for finding in doctor.examine()}
    active = "active" if HAS_BULLET else "installed, not used without pybullet"
    assert state["C extension"] == ("C extension", active, "")
    extras = importlib.metadata.metadata("bulletuav").get_all("Provides-Extra")
    assert {f"extra {extra}" for extra in extras} < set(state)
    assert len(extras) >= 20
    monkeypatch.setenv("DISPLAY", "")
    assert {finding.subject: finding for finding in doctor.examine()}[
        "window"
    ].state == "not available"


def test_the_doctor_prints_problems_first(capsys, monkeypatch):
    findings = [doctor.Finding("numpy", "2.4"), doctor.Finding("extra ray", "missing", "get ray")]
    found = [*findings, doctor.Finding("C extension", "not active", "get a compiler")]
    monkeypatch.setattr("bulletuav.commands.doctor.examine", lambda: found)
    main(["doctor"])
    first, *others = capsys.readouterr().out.splitlines()
    assert first == "problems: C extension; extras not installed: ray"
    assert others[:2] == ["extra ray: get ray", "C extension: get a compiler"]
    assert any("numpy" in line for line in others[2:])
    monkeypatch.setattr("bulletuav.commands.doctor.examine", lambda: found[:1])
    main(["doctor"])
    assert capsys.readouterr().out.startswith("no problems; extras not installed: none\n")


def test_the_doctor_lists_versions_and_parts_of_extras():
    import stable_baselines3

    state = {finding.subject: finding.state for finding in doctor.examine()}
    assert f"stable-baselines3 {stable_baselines3.__version__}" in state["extra sb3"]
    assert state["extra test"].startswith("airsim, city, ")


def test_the_doctor_tells_what_is_missing(monkeypatch, capsys):
    def absent(name):
        raise importlib.metadata.PackageNotFoundError(name)

    with monkeypatch.context() as patch:
        patch.setattr(doctor, "EXTENSION", Extension(None, "", "no compiler"))
        patch.setattr(doctor, "_version", lambda package: None)
        patch.setattr(doctor, "require_screen", lambda: None)
        found = {finding.subject: finding for finding in doctor.examine()}
    assert found["C extension"].remedy == "no compiler"
    assert found["C extension"].state.startswith("not active")
    assert found["extra video"][:2] == ("extra video", "missing: imageio-ffmpeg")
    tools = "build, cyclonedx-bom, pip-audit, pre-commit, twine, uv, test"
    assert found["extra dev"].state == f"missing: {tools}"
    assert re.fullmatch(
        r"pip install -c \S+/constraints\.txt -e '\S+\[video\]'", found["extra video"].remedy
    )
    assert found["window"].state == "available"
    with monkeypatch.context() as patch:
        patch.setattr(importlib.metadata, "metadata", absent)
        (extras,) = doctor._extras()
    assert "not installed" in extras.state
    monkeypatch.setattr("bulletuav.commands.doctor.examine", lambda: list(found.values()))
    main(["doctor"])
    assert "[video]'" in "".join(capsys.readouterr().out.split())


@pytest.mark.bullet
def test_the_doctor_tells_of_an_extension_that_does_not_fit(monkeypatch):
    monkeypatch.setattr(engine, "EXTENSION", engine.EXTENSION._replace(path="/nowhere.so"))
    with pytest.warns(UserWarning, match="could not load"):
        assert "is not compatible" in doctor._extension().remedy


def test_a_reader_that_has_seen_enough_is_no_error():
    """`bulletuav tasks mec | head -1`: quiet, whether it prints lines or a table by rich."""
    commands = (["tasks", "mec"], ["tasks", "mec", "--observation"])
    running = [
        subprocess.Popen(
            [sys.executable, "-m", "bulletuav", *command],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        for command in commands
    ]
    for shown in running:
        shown.stdout.close()
        assert shown.stderr.read() == b""
        assert shown.wait() in (0, 1, 141)  # 0 where it was faster
        shown.stderr.close()


def test_memory_that_runs_out_is_told_in_one_line(capsys, monkeypatch):
    def greedy(arguments):
        np.empty(2**56)

    monkeypatch.setattr("bulletuav.commands.tasks.run", greedy)
    with pytest.raises(SystemExit) as end:
        main(["tasks"])
    assert end.value.code == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "memory ran out (Unable to allocate 512. PiB" in said


def test_how_far_it_is_is_told_in_lines_where_there_is_no_terminal(capsys, monkeypatch):
    now = iter(range(0, 1000, 4))
    monkeypatch.setattr("bulletuav.commands.progress.time.monotonic", lambda: next(now))
    with show_progress("training crossing", 1000, "steps") as report:
        for done in (0, 100, 200, 300, 400, 1000, 1000):
            report(done)
    assert capsys.readouterr().err.splitlines() == [
        "training crossing: 0 of 1,000 steps (0 %), 0 s",
        "training crossing: 300 of 1,000 steps (30 %), 12 s",
        "training crossing: 1,000 of 1,000 steps (100 %), 20 s",
    ]


def test_compilation_has_lines_of_its_own_and_no_part_in_the_time(capsys, monkeypatch):
    compilation = dispatcher.Compilation()
    monkeypatch.setattr(dispatcher, "COMPILATION", compilation)
    monkeypatch.setattr(dispatcher, "MANY", 2)
    now = [0.0]
    clock = types.SimpleNamespace(monotonic=lambda: now[0])
    monkeypatch.setattr(dispatcher, "time", clock)
    monkeypatch.setattr("bulletuav.commands.progress.time", clock)

    def compile_for(seconds):
        with compilation.count():
            now[0] += seconds

    with show_progress("flying", 500, "decisions") as report:
        for _ in range(6):
            compile_for(60.0)
        report(1)
        now[0] += 4.0
        compile_for(100.0)  # as at a first touch
        report(500)
    assert capsys.readouterr().err.splitlines() == [
        *(
            f"compiling: {k} of about 270 functions, {60 * k} s, kept for later runs"
            for k in range(2, 7)
        ),
        "flying: 1 of 500 decisions (0 %), 0 s",
        "compiling: 7 of about 270 functions, 460 s, kept for later runs",
        "flying: 500 of 500 decisions (100 %), 4 s",
    ]
    assert compilation.watch is None


@pytest.mark.slow
@pytest.mark.parametrize("dynamics", ["point_mass", "bullet"])
def test_about_as_many_functions_are_compiled_as_are_announced(dynamics, tmp_path):
    words = ["fly", "crossing", "--dynamics", dynamics, "--horizon", "2", "--animation", "none"]
    # With a processor that is named, no shipped code is used
    variables = {"NUMBA_CACHE_DIR": str(tmp_path), "NUMBA_CPU_NAME": llvm.get_host_cpu_name()}
    subprocess.run(
        [sys.executable, "-m", "bulletuav", *words],
        env={**os.environ, **variables},
        cwd=tmp_path,
        check=True,
    )
    compiled = len(list(tmp_path.rglob("*.nbc")))
    assert compiled == pytest.approx(EXPECTED_FUNCTIONS, rel=0.2)


def test_how_far_it_is_is_a_bar_on_a_terminal():
    """In a pseudo-terminal."""
    mine, theirs = os.openpty()
    program = "from bulletuav.commands.progress import show_progress\n"
    program += "from bulletuav.compiled.dispatcher import COMPILATION\n"
    program += "with show_progress('flying', 3, 'episodes') as report:\n"
    program += "    with COMPILATION.count(): pass\n"
    program += "    import time; time.sleep(0.3)\n"  # more than a frame
    program += "    [report(done) for done in range(4)]\n"
    # Workers are forked meanwhile, and threads could hold locks that a fork would wait for
    program += "    import os, threading; os.write(1, b'%d' % threading.active_count())"
    done = subprocess.run(
        [sys.executable, "-c", program],
        check=True,
        stderr=theirs,
        stdout=subprocess.PIPE,
        env={**os.environ, "TERM": "xterm"},
    )
    assert int(done.stdout) == 1
    os.close(theirs)
    said = os.read(mine, 65536).decode()
    assert "compiling" in said
    assert f"1 of about {EXPECTED_FUNCTIONS} functions" in said
    last = said.rpartition("flying")[2]
    assert "3 of 3 episodes" in last
    assert "compiling" not in last
    os.close(mine)


@pytest.fixture
def full_disk():
    """Lets no file grow beyond so many bytes, as on a disk with that much room."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda room: resource.setrlimit(resource.RLIMIT_FSIZE, (room, before[1]))
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.filterwarnings("ignore:the folder for temporary files")
@pytest.mark.parametrize(
    ("room", "command"),
    [
        (3000, ["fly", "hover", "--horizon", "5", "--dynamics", "rigid_body"]),
        (3000, ["city", "--kind", "urban", "--side", "200"]),
        (0, ["evaluate", "hover", "--episodes", "1", "--horizon", "5", "--dynamics", "rigid_body"]),
        (
            3000,
            [
                "train",
                "converge",
                "--steps",
                "16",
                "--worlds",
                "1",
                "--evaluations",
                "1",
                "--episodes",
                "1",
            ],
        ),
    ],
)
def test_a_full_disk_ends_in_one_line_that_names_the_file(
    room, command, tmp_path, full_disk, capsys
):
    out = tmp_path / "out"
    if command[0] == "train":
        command = [*command, "--dynamics", "single_integrator", "--horizon", "4"]
    main([*command, "--out", str(tmp_path / "first")])  # which may compile
    capsys.readouterr()
    full_disk(room)
    with pytest.raises(SystemExit) as end:
        main([*command, "--out", str(out)])
    assert end.value.code == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert str(out) in last
    assert "too large" in last
    files = [
        path for path in out.rglob("*") if path.is_file() and path.parent.name != "tensorboard"
    ]
    assert not [path for path in files if path.name.startswith(".part-")]
    assert all(path.stat().st_size <= room for path in files)


@pytest.mark.parametrize("words", [["tasks"], ["tasks", "nosuch"]], ids=["result", "error"])
@pytest.mark.parametrize("closed", [(0,), (1,), (2,), (0, 1, 2)], ids=str)
def test_a_closed_stream_costs_nothing_of_the_others(words, closed, tmp_path):
    """Daemons and schedulers start programs so."""
    code = (
        f"import os, sys; [os.close(k) for k in {closed}];"
        f"os.execv(sys.executable, [sys.executable, '-m', 'bulletuav', *{words}])"
    )
    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, timeout=120
    )
    assert run.returncode == (2 if "nosuch" in words else 0)
    assert ("crossing" in run.stdout) == (1 not in closed and "nosuch" not in words)
    assert ("unknown task" in run.stderr) == (2 not in closed and "nosuch" in words)
    assert "Traceback" not in run.stderr


def test_the_number_of_drones_is_a_range(tmp_path, capsys):
    words = ["crossing", "--dynamics", "point_mass", "--horizon", "5"]
    main(["evaluate", *words, "--drones", "2,5", "--episodes", "2", "--out", str(tmp_path)])
    options = json.loads((tmp_path / "summary.json").read_text())["options"]
    assert (options["min_drones"], options["num_drones"]) == (2, 5)
    # The same call continues
    main(["evaluate", *words, "--drones", "2,5", "--episodes", "2", "--out", str(tmp_path)])
    capsys.readouterr()
    for wrong in ("2-5", "2,5,6", "2,", "two", "-2"):
        with pytest.raises(SystemExit):
            main(["fly", *words, "--drones", wrong])
        assert f"{wrong}: a number, or a range such as 4,12, is needed" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["fly", *words, "--drones", "5,2"])
    assert "from low to high is needed" in capsys.readouterr().err
