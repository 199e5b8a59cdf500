"""Scores that commands print and store: what names them, and that commands agree."""

import csv
import re
import types

import pytest
from inline import no_processes

from bulletuav.cli import COMMANDS, _parser, main
from bulletuav.commands import evaluate, train
from bulletuav.policies.run import RunConfig, shipped_tasks
from bulletuav.training import campaign
from bulletuav.training import study as studies
from bulletuav.training.store import evaluation_conditions

OPTIONS = ["--drones", "2", "--dynamics", "point_mass", "--action", "velocity", "--horizon", "8"]
SHORT = ["--steps", "32", "--worlds", "2", "--evaluations", "1", "--episodes", "2"]
SHORT += ["--model", "n_steps=8", "--model", "batch_size=32"]
WITHOUT_SCORES = {
    "tasks": "describes tasks",
    "city": "draws cities",
    "dataset": "writes decisions; its metadata are tested with it",
    "merge": "prints paths; its files are those of evaluate and compare",
    "replay": "draws a flight",
    "export": "converts a flight",
    "convert": "converts a drone's file",
    "identify": "fits constants to logs",
    "reproduce": "compares with published numbers, and each table states its own conditions",
    "serve": "serves other programs",
    "benchmark": "measures speed",
    "compile": "compiles",
    "doctor": "describes the installation",
}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Folder of a tiny run of a task whose settings in the package are of another difficulty."""
    import stable_baselines3  # noqa: F401 - pytest keeps an ImportError of a fixture, but no exit

    folder = tmp_path_factory.mktemp("trained") / "run"
    main(["train", "hover", *OPTIONS, *SHORT, "--out", str(folder)])
    return folder


def scores(text):
    """The lines of scores, without where options are from."""
    lines = [line for line in text.splitlines() if line.startswith("score of ")]
    return [re.sub(r", (other )?options of \S+:", ":", line) for line in lines]


def test_training_ends_with_the_score_that_evaluation_finds(run, tmp_path, capsys):
    """By the folder alone, and by the command line of the training."""
    main(["train", "--config", str(run / "run.yaml"), "--out", str(run)])
    (trained,) = scores(capsys.readouterr().out)
    main(["evaluate", str(run), "--out", str(tmp_path / "folder")])
    printed = capsys.readouterr().out
    assert f"seeds 0 to 1, action velocity, options of {run / 'run.yaml'}: " in printed
    assert scores(printed) == [trained]
    policy = ["--policy", str(run), "--episodes", "2", "--out", str(tmp_path / "task")]
    main(["evaluate", "hover", *OPTIONS, *policy])
    assert scores(capsys.readouterr().out) == [trained]
    assert "hover, difficulty easy, dynamics point_mass, 2 episodes, seeds 0 to 1, " in trained
    mean = re.search(r"return (-?[\d.]+) \[", trained)[1]
    row = (run / "learning.md").read_text().splitlines()[2]
    assert "| easy | point_mass | 2 episodes, seeds 0 to 1 | " in row
    assert f"| {float(mean):.2f} |" in row


def test_options_that_are_given_go_before_those_of_the_run(run, tmp_path, capsys):
    changed = ["--difficulty", "extreme", "--dynamics", "single_integrator", "--episodes", "1"]
    main(["evaluate", str(run), *changed, "--seed", "7", "--out", str(tmp_path / "out")])
    printed = capsys.readouterr().out
    assert f", other options of {run / 'run.yaml'}: " in printed
    (score,) = scores(printed)
    assert "hover, difficulty extreme, dynamics single_integrator, 1 episode, seed 7, " in score


def test_a_run_and_a_policy_are_one_too_many(run, capsys):
    with pytest.raises(SystemExit):
        main(["evaluate", str(run), "--policy", "straight"])
    assert "give a task to evaluate another policy" in capsys.readouterr().err


def configured(*words):
    """The settings of a training by its command line."""
    parser, _ = _parser(["train", *words])
    arguments = parser.parse_args(["train", *words])
    return train.run_config(arguments, train.base_config(arguments, arguments.task))


@pytest.mark.parametrize("task", shipped_tasks())
def test_settings_of_the_package_bring_no_scenario_along(task):
    """A training without options is scored by what `evaluate` flies without options."""
    usual = RunConfig(task)
    assert evaluation_conditions(configured(task)) == evaluation_conditions(usual)


def test_given_options_hold_in_evaluations_too():
    given = ["--dynamics", "rigid_body", "--set", "d_safe=7.5", "--set", "num_neighbours=4"]
    config = configured("crossing", *given, "--set", "weights={'goal': 3}")
    held = {"dynamics": "rigid_body", "d_safe": 7.5, "weights": {"goal": 3}, "num_neighbours": 4}
    assert held.items() <= config.evaluated.items()
    # What the default settings change in training alone stays there
    assert configured("crossing").options["dynamics"] == "point_mass"
    assert not {"dynamics", "reward"} & configured("crossing").evaluated.keys()


FLOWN = ["--difficulty", "medium", "--dynamics", "single_integrator", "--horizon", "6"]
SEEDS = ["--episodes", "2", "--seed", "5"]
SCORE_FILES = ("curve.csv", "leaderboard.csv", "trials.csv")
"""Tables whose rows name their conditions; beside the others stands run.json or run.yaml"""
TRAINED = [*FLOWN, *SHORT, "--drones", "2", "--set", "observation=goal"]
CASES = {
    "fly": (["fly", "converge", *FLOWN, "--seed", "5", "--animation", "none"], "seed 5"),
    "evaluate": (["evaluate", "converge", *FLOWN, *SEEDS], "seeds 5 to 6"),
    "compare": (
        ["compare", "--tasks", "converge", "--policies", "straight,random", *FLOWN, *SEEDS],
        "seeds 5 to 6",
    ),
    "incentives": (
        ["incentives", "converge", "--difficulties", "medium", *FLOWN[2:], *SEEDS],
        "seeds 5 to 6",
    ),
    "train": (["train", "converge", *TRAINED, "--seed", "5"], "seeds 0 to 1"),
    "tune": (
        ["tune", "converge", *TRAINED, "--trials", "1", "--search", "model.gamma=0.9,0.99"],
        "seeds 1000000 to 1000001",
    ),
    "verify": (["verify"], "seeds 5 to 6"),
}


def test_every_command_has_a_case_or_prints_no_score():
    assert CASES.keys() | WITHOUT_SCORES.keys() == set(COMMANDS)


@pytest.fixture
def drawn(monkeypatch):
    """Texts of all pictures that reports draw meanwhile."""
    texts = []

    def note(figure, path):
        axes = figure.axes
        labels = [label.get_text() for one in axes for label in one.get_xticklabels()]
        titles = [one.get_title(loc=side) for one in axes for side in ("left", "center")]
        texts.append(" ".join([figure.get_suptitle(), *titles, *labels]))
        path.write_bytes(b"")

    for module in ("charts", "study"):
        monkeypatch.setattr(f"bulletuav.report.{module}.save_figure", note)
    return texts


@pytest.mark.parametrize("command", CASES)
def test_what_is_printed_and_stored_names_the_conditions(
    command, tmp_path, capsys, monkeypatch, drawn
):
    """Task, difficulty, dynamics, episodes and seeds, in output, tables and pictures."""
    if command == "tune":
        pytest.importorskip("optuna", reason="needs the extra tune")
    monkeypatch.setattr(studies, "training_processes", no_processes)
    monkeypatch.setattr(campaign, "training_processes", no_processes)
    monkeypatch.setenv("COLUMNS", "300")
    words, seeds = CASES[command]
    out = tmp_path / "out"
    if command == "verify":
        main([*CASES["compare"][0], "--out", str(out)])
        capsys.readouterr()
        main([*words, str(out)])
    else:
        main([*words, "--out", str(out)])
    number = "1 episode" if command == "fly" else "2 episodes"
    named = ("converge", "medium", "single_integrator", number, seeds)
    said = capsys.readouterr()
    tables = {path.name: path.read_text() for path in out.glob("*.md")}
    for place, text in {"output": said.out, **tables}.items():
        assert not [word for word in named if word not in text], place
    # Curves are of evaluations on the way, whose seeds are others
    curves = "seeds 1000000 to 1000001"
    for text in drawn:
        expected = (*named[:4], curves if command == "train" else seeds)
        assert not [word for word in expected if word not in text.replace("\n", " ")]
    for path in out.glob("*.csv"):
        if path.name in SCORE_FILES:
            seed = (curves if command == "train" else seeds).split()[1]
            require_conditions(path, [*named[:3], seed])


def require_conditions(path, expected):
    """Check that each row of a csv file has its conditions."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert rows
    for row in rows:
        assert [row[name] for name in ("task", "difficulty", "dynamics", "seed")] == expected
        assert int(row["episodes"]) <= 2  # those that have the metric


def test_short_evaluations_print_no_speed():
    """The start of the processes dominates their time."""
    result = types.SimpleNamespace(flight=600.0, seconds=2.0)
    short = evaluate._describe_speed(result)
    assert short == "600 s of simulated flight in 2.0 s of wall time"
    result.seconds = 60.0
    assert evaluate._describe_speed(result).endswith("60.0 s of wall time: 10.0 x real time")
