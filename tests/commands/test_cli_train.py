import dataclasses
import json
import re
import sys
from pathlib import Path

import pytest

from bulletuav.cli import _parser, main
from bulletuav.commands import train
from bulletuav.policies.run import RunConfig, shipped, shipped_tasks
from bulletuav.training.campaign import Campaign
from bulletuav.training.store import planned_steps

TINY = [
    "--steps",
    "64",
    "--worlds",
    "2",
    "--drones",
    "2",
    "--difficulty",
    "easy",
    "--horizon",
    "8",
    "--evaluations",
    "1",
]
TINY += [
    "--episodes",
    "1",
    "--dynamics",
    "single_integrator",
    "--model",
    "n_steps=8",
    "--model",
    "batch_size=32",
]
SHORT = ["--horizon", "8", "--dynamics", "single_integrator", "--drones", "2"]


def test_a_run_trains_flies_is_evaluated_and_goes_on(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    main(["train", "obstacles", *TINY, "--set", "observation=goal,velocity", "--out", "run"])
    out = capsys.readouterr().out
    assert "| obstacles | ppo | 0 | 64 |" in out
    for name in ("run.yaml", "policy.safetensors", "curve.csv", "learning.md", "curves.png"):
        assert f"wrote run/{name}" in out
        assert (tmp_path / "run" / name).stat().st_size
    main(["fly", "obstacles", "--policy", "run", *SHORT, "--animation", "none", "--out", "flight"])
    assert json.loads((tmp_path / "flight" / "run.json").read_text())["options"]["observation"] == [
        "goal",
        "velocity",
    ]
    main(["evaluate", "obstacles", "--policy", "run", *SHORT, "--episodes", "2", "--out", "found"])
    assert json.loads((tmp_path / "found" / "summary.json").read_text())["policy"] == "run"
    before = (tmp_path / "run" / "policy.safetensors").read_bytes()
    main(["train", "--config", "run/run.yaml", "--out", "run"])
    assert (tmp_path / "run" / "policy.safetensors").read_bytes() == before
    capsys.readouterr()


def test_progress_tells_how_it_goes_and_where_the_time_went(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("bulletuav.commands.progress.LINE_PERIOD", 0.0)
    main(["train", "obstacles", *TINY, "--set", "observation=goal", "--out", "run"])
    told = capsys.readouterr()
    told_of, first, *_, last = [
        line for line in told.err.splitlines() if not line.startswith("flying: ")
    ]
    assert told_of == (
        "in training: obstacles, difficulty easy, dynamics single_integrator, the last 100 "
        "training episodes of seed 0, by the stochastic policy while it learns"
    )
    assert re.match(r"training obstacles: 4 of 64 steps \(6 %\), \d+ s$", first)
    assert re.search(
        r"training return -?[\d.]+, training success \d\.\d\d at easy, [\d,]+ steps/s$", last
    )
    assert re.search(r"minutes: simulation \d+ %, update \d+ %, evaluation \d+ %", told.out)


def test_an_interrupt_tells_how_to_go_on(tmp_path, capsys, monkeypatch):
    from bulletuav.training import segments

    monkeypatch.chdir(tmp_path)

    def cut(*_, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(segments, "evaluate", cut)
    with pytest.raises(SystemExit) as end:
        main(["train", "obstacles", *TINY, "--out", "run"])
    assert end.value.code == 130
    assert "the same command resumes from the last checkpoint in run" in capsys.readouterr().err


def test_evaluating_an_interrupted_run_reports_what_to_do(tmp_path, capsys, monkeypatch):
    """Before its first checkpoint, and after it."""
    monkeypatch.chdir(tmp_path)
    main(["train", "obstacles", *TINY, "--out", "run"])
    (tmp_path / "run" / "policy.safetensors").unlink()

    def error():
        capsys.readouterr()
        with pytest.raises(SystemExit):
            main(["evaluate", "run"])
        return capsys.readouterr().err

    resume = "resume it by bulletuav train --config run/run.yaml --out run"
    assert f"{resume}, or use its last checkpoint, run/checkpoints/001" in error()
    main(["evaluate", "run/checkpoints/001"])
    for folder in ("000", "001"):
        (tmp_path / "run" / "checkpoints" / folder / "policy.safetensors").unlink()
    message = error()
    assert resume in message
    assert "use its last checkpoint" not in message


@pytest.mark.parametrize(
    ("algo", "settings", "planned"),
    [
        ("ppo", ["n_steps=8", "batch_size=32"], 64),
        ("sac", ["train_freq=3", "learning_starts=100", "batch_size=8"], 48),
        ("sac", ["train_freq=[3,'step']", "learning_starts=100", "batch_size=8"], 48),
    ],
)
def test_rounded_steps_are_printed(algo, settings, planned, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    models = [word for one in settings for word in ("--model", one)]
    words = ["train", "obstacles", "--algo", algo, *TINY[:-4], "--set", "observation=goal", *models]
    main([*words, "--steps", "40", "--out", "run"])
    printed = capsys.readouterr().err
    assert f"40 steps are rounded up to whole rollouts, {planned} decisions" in printed
    names, *_, last = (tmp_path / "run" / "curve.csv").read_text().splitlines()
    row = dict(zip(names.split(","), last.split(","), strict=True))
    assert float(row["steps"]) == planned
    config = RunConfig.read(tmp_path / "run" / "run.yaml")
    assert planned_steps(dataclasses.replace(config, steps=planned)) == planned


def test_steps_of_rollouts_of_unknown_length_stay_as_they_are():
    for value in ([1, "episode"], 0, "many"):
        config = RunConfig("obstacles", "sac", steps=41, model={"train_freq": value})
        assert planned_steps(config) == 41


def test_the_page_on_training_lists_the_files_of_a_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    main(["train", "obstacles", *TINY, "--out", "run"])
    page = (Path(__file__).parents[2] / "docs" / "howto" / "train.md").read_text()
    files = {path.name for path in (tmp_path / "run").iterdir()}
    assert {"lock", "state.json", "curve.csv"} <= files
    rows = "\n".join(line for line in page.splitlines() if line.startswith("|"))
    assert {name for name in files if f"`{name}" not in rows} == set()


class OneProcess(Campaign):
    """Which starts faster."""

    def train(self, workers=1, progress=lambda steps: None, note=lambda text: None):
        from bulletuav.training.trainer import train

        return [(config, train(config, self.run_folder(config))) for config in self.configs]


def test_several_seeds_make_one_table_and_one_picture(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(train, "Campaign", OneProcess)
    main(["train", "obstacles", *TINY, "--seeds", "0,1", "--out", "runs"])
    table = (tmp_path / "runs" / "learning.md").read_text()
    assert "| obstacles | ppo | 0 | 64 |" in table
    assert "| obstacles | ppo | 1 | 64 |" in table
    assert (tmp_path / "runs" / "runs" / "obstacles" / "1" / "policy.safetensors").exists()
    assert (tmp_path / "runs" / "curves.png").stat().st_size > 10_000
    assert "wrote runs/curves.png" in capsys.readouterr().out


def test_dqn_chooses_among_discrete_actions_and_difficulties_make_a_curriculum(
    tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    tiny = [
        *TINY[:4],
        "--evaluations",
        "1",
        "--episodes",
        "1",
        "--dynamics",
        "single_integrator",
        "--horizon",
        "8",
    ]
    settings = [
        "--model",
        "learning_starts=8",
        "--model",
        "batch_size=8",
        "--set",
        "observation=goal",
    ]
    main(["train", "obstacles", "--algo", "dqn", *tiny, *settings, "--curriculum", "easy,medium"])
    run = RunConfig.read(tmp_path / "training" / "obstacles-dqn-0" / "run.yaml")
    assert run.options["action"] == "discrete"
    assert run.stages == [{"difficulty": "easy"}, {"difficulty": "medium"}]
    assert run.model == {"learning_starts": 8, "batch_size": 8}


def configured(*arguments):
    words = ["train", *arguments]
    parser, _ = _parser(words)
    given = parser.parse_args(words)
    return train.run_config(given, train.base_config(given, given.task))


def test_what_is_given_goes_before_the_settings_of_the_package():
    usual = configured("crossing")
    assert usual.options["dynamics"] == "point_mass"
    assert "dynamics" not in configured("crossing", "--action", "rates").options
    one = configured("crossing", "--dynamics", "double_integrator", "--model", "gamma=0.9")
    assert one.options["dynamics"] == "double_integrator"
    assert list(one.stages) == [{}]
    assert one.model == {**usual.model, "gamma": 0.9}
    easier = configured("crossing", "--curriculum", "easy,medium")
    assert easier.stages == [{"difficulty": "easy"}, {"difficulty": "medium"}]
    assert easier.curriculum == {}
    other = configured("crossing", "--algo", "sac", "--seed", "5")
    assert (other.model, other.seed, other.options) == ({}, 5, usual.options)


def test_a_run_with_weights_for_training_is_evaluated_by_the_benchmark():
    run = configured("formation", "--set", "reward=training", "--set", "goal_radius=3")
    assert run.options["reward"] == "training"
    assert run.evaluation == {"goal_radius": 3}


def test_a_run_that_shows_a_block_of_a_module_is_evaluated_and_goes_on(
    tmp_path, capsys, monkeypatch
):
    """The module is the user's own: nothing asks for trust before a file comes from elsewhere."""
    (tmp_path / "blocks_of_mine.py").write_text(
        "from bulletuav.sensors import Label\n"
        "from bulletuav.tasks import block\n"
        "@block([Label('height', 'm', -100.0, 100.0)])\n"
        "def height(known_position):\n"
        "    return known_position[2]\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    shown = ["--set", "observation=goal,velocity,blocks_of_mine:height"]
    for _ in range(2):
        main(["train", "obstacles", *TINY, *shown, "--out", "run"])
        assert "score of run" in capsys.readouterr().out
    again = ["train", "--config", "run/run.yaml", "--out", "again"]
    with pytest.raises(SystemExit):
        main(again)
    assert "'blocks_of_mine:height', whose module would be imp" in capsys.readouterr().err
    main([*again, "--trust"])
    assert "score of again" in capsys.readouterr().out


def test_beside_other_actions_a_trained_policy_keeps_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    both = ["--tasks", "crossing", "--policies", "straight,untrained", "--episodes", "2"]
    main(["compare", *both, "--action", "target_position", *SHORT])
    told = [
        json.loads(path.read_text()) for path in tmp_path.glob("leaderboard/runs/*/summary.json")
    ]
    given = {one["policy"]: one["options"]["action"] for one in told}
    assert given == {"straight": "target_position", "untrained": "velocity"}


class Absent:
    """Finder by which some packages cannot be imported."""

    def __init__(self, names):
        self.names = names

    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in self.names:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


@pytest.mark.filterwarnings("ignore:the package's policy")
@pytest.mark.parametrize("task", shipped_tasks())
def test_a_shipped_policy_flies_its_task_without_what_it_was_trained_with(
    task, tmp_path, capsys, monkeypatch
):
    """As after the README's installation."""
    # A lap or a race takes longer
    horizon = {"pursuit": "400", "race": "200"}.get(task, "5")
    absent = ("torch", "stable_baselines3", "tensorboard", "filelock")
    for name in list(sys.modules):
        if name.partition(".")[0] in absent or name.startswith("bulletuav.adapters"):
            monkeypatch.delitem(sys.modules, name)
    # None in sys.modules would do, but SciPy looks there for PyTorch, and trusts what it finds.
    monkeypatch.setattr(sys, "meta_path", [Absent(absent), *sys.meta_path])
    if task == shipped_tasks()[0]:
        main(
            [
                "fly",
                task,
                "--policy",
                "untrained",
                "--horizon",
                horizon,
                "--animation",
                "none",
                "--out",
                str(tmp_path),
            ]
        )
    main(
        [
            "fly",
            task,
            "--policy",
            "trained",
            "--horizon",
            horizon,
            "--animation",
            "none",
            "--out",
            str(tmp_path),
        ]
    )
    assert "drone_0" in capsys.readouterr().out
    assert {path.suffix for path in shipped(task).rglob("*") if path.is_file()} == {
        ".yaml",
        ".safetensors",
    }


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["train"], "train what?"),
        (["train", "crossing", "--all"], "train what?"),
        (["train", "crosing"], "did you mean 'crossing'"),
        (["train", "crossing", "--algo", "pppo"], "did you mean 'ppo'"),
        (["train", "crossing", "--steps", "many"], "invalid count value: 'many'"),
        (["train", "crossing", "--steps", "2.5"], "invalid count value: '2.5'"),
        (["train", "crossing", "--steps", "0"], "steps is 0"),
        (["train", "crossing", "--seed", "1", "--seeds", "2,3"], "give one of them"),
        (["train", "crossing", "--model", "gamma"], "--model gamma: NAME=VALUE is needed"),
        (["train", "crossing", "--curriculum", "easy,hrd", "--out", "x"], "did you mean 'hard'"),
        (["train", "--config", "nowhere.yaml"], "no file nowhere.yaml"),
        (["train", "--config", "."], "no file run.yaml"),
        (["train", "crossing", "--seeds", "a,b"], "invalid seeds value: 'a,b'"),
        (
            ["train", "crossing", "--difficulty", "easy", "--curriculum", "easy,hard"],
            "--difficulty and --curriculum",
        ),
        (
            ["train", "crossing", "--set", "lanespacing=3", "--out", "x"],
            "did you mean 'lane_spacing'",
        ),
        (
            ["fly", "crossing", "--policy", "trained", "--action", "target_position"],
            "supports velocity actions, not",
        ),
        (
            ["evaluate", "crossing", "--policy", "trained", "--action", "attitude"],
            "supports velocity actions, not",
        ),
    ],
)
def test_bad_input_ends_in_one_line(arguments, said, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as end:
        main(arguments)
    assert end.value.code == 2
    assert said in capsys.readouterr().err.splitlines()[-1]
