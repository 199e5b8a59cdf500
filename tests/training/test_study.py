"""Studies: what varies, what is tried, and how an interrupted one goes on; runs are stand-ins."""

import csv
import math
import os

import pytest
from inline import no_processes

from bulletuav.cli import main
from bulletuav.files import replace_file
from bulletuav.policies.run import RunConfig
from bulletuav.policies.space import Choices, Range, parse_space, with_values
from bulletuav.report.study import plot_study, study_table
from bulletuav.training import study as studies
from bulletuav.training import trainer
from bulletuav.training.store import FolderError
from bulletuav.training.study import Study, best_trials, run_study

pytest.importorskip("optuna", reason="needs the extra tune")

RUN = RunConfig("hover", seed=3, steps=64)
SPACE = parse_space(
    {
        "model": {
            "learning_rate": {"low": 1e-4, "high": 1e-2, "log": True},
            "n_epochs": {"low": 2, "high": 10, "step": 2},
            "policy_kwargs.net_arch": {"choices": [[64, 64], [32]]},
        },
        "shared_reward": {"choices": [True, False]},
    }
)
STUDY = Study(RUN, SPACE, trials=8, batch=3)


@pytest.fixture
def trained(monkeypatch):
    """The configurations that were trained; the return has its maximum at 1e-3 and 6 epochs."""
    configs = []

    def train(config, folder, progress, tracker):
        configs.append((folder, config))
        rate, epochs = config.model["learning_rate"], config.model["n_epochs"]
        if epochs == 10:
            raise ValueError("too\nmany")
        result = -abs(math.log10(rate) + 3) - abs(epochs - 6)
        return [{"return": -9.0, "length": 1.0}, {"return": result, "length": float(epochs)}]

    monkeypatch.setattr(trainer, "train", train)
    monkeypatch.setattr(studies, "training_processes", no_processes)
    return configs


def test_the_best_trial_is_found_and_failures_are_told(trained, tmp_path):
    notes = []
    trials = run_study(STUDY, tmp_path, note=notes.append)
    assert [trial.number for trial in trials] == list(range(8))
    failed = [trial for trial in trials if trial.values["model.n_epochs"] == 10]
    assert failed == [trial for trial in trials if trial.error]
    assert {trial.error for trial in failed} == {"too many"}
    best = best_trials(STUDY, trials)[0]
    assert best.result == max(trial.result for trial in trials if not trial.error)
    assert notes[-1] == f"best return {best.result:.4g} in trial {best.number}"
    with (tmp_path / "trials.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["error"] for row in rows] == [trial.error for trial in trials]
    assert float(rows[best.number]["return"]) == best.result
    assert study_table(STUDY, trials).splitlines()[4].startswith(f"| {best.number} | ")
    plot_study(STUDY, trials, tmp_path / "study.png")
    assert (tmp_path / "study.png").stat().st_size > 10_000


def test_less_is_better_of_a_length(trained, tmp_path):
    shortest = Study(RUN, SPACE, metric="length", trials=4)
    trials = run_study(shortest, tmp_path)
    lengths = [trial.result for trial in trials if not trial.error]
    assert best_trials(shortest, trials)[0].result == min(lengths)


def test_an_interrupted_study_goes_on_to_the_same_trials(trained, tmp_path, monkeypatch):
    whole = run_study(STUDY, tmp_path / "whole")
    tried = [config for _, config in trained]
    written = []

    def cut(path, text):
        replace_file(path, text)
        written.append(path)
        if len(written) == 6:
            raise KeyboardInterrupt

    monkeypatch.setattr(studies, "replace_file", cut)
    with pytest.raises(KeyboardInterrupt):
        run_study(STUDY, tmp_path / "cut")
    monkeypatch.setattr(studies, "replace_file", replace_file)
    del trained[:]
    again = run_study(STUDY, tmp_path / "cut")
    assert [config for _, config in trained] == tried
    assert [trial[:4] for trial in again] == [trial[:4] for trial in whole]
    for name in ("study.yaml", "trials.csv"):
        assert (tmp_path / "cut" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


def test_more_trials_go_on_with_a_study_and_another_one_is_refused(trained, tmp_path):
    first = run_study(Study(RUN, SPACE, trials=4, batch=3), tmp_path)
    more = run_study(STUDY, tmp_path)
    assert more[:4] == first
    assert Study.read(tmp_path / "study.yaml").text() == STUDY.text()
    with pytest.raises(FolderError, match="holds another study"):
        run_study(Study(RUN, SPACE, trials=8, batch=2), tmp_path)


def test_another_seed_tries_other_values(trained, tmp_path):
    other = Study(RunConfig("hover", seed=4, steps=64), SPACE, trials=3)
    one, two = run_study(STUDY, tmp_path / "one"), run_study(other, tmp_path / "two")
    assert one[0].values != two[0].values


def test_a_study_of_failures_alone_tells_the_first(trained, tmp_path):
    space = {**SPACE, "model.n_epochs": Choices((10,))}
    with pytest.raises(ValueError, match="all trials failed.*too many"):
        run_study(Study(RUN, space, trials=2), tmp_path)


@pytest.mark.parametrize("error", [OSError(28, os.strerror(28)), FolderError("in use")])
def test_what_is_no_fault_of_a_trials_settings_ends_the_study(
    error, trained, tmp_path, monkeypatch
):
    def fail(config, folder, progress, tracker):
        raise error

    monkeypatch.setattr(trainer, "train", fail)
    with pytest.raises(type(error), match=r"No space left|in use"):
        run_study(STUDY, tmp_path)


def test_values_stand_beside_the_defaults_of_the_algorithm():
    changed = with_values(RUN, {"model.policy_kwargs.log_std_init": -2.0, "worlds": 8})
    assert changed.worlds == 8
    assert changed.settings["policy_kwargs"] == {"net_arch": [64, 64], "log_std_init": -2.0}


def varied(**space):
    return lambda: Study(RUN, parse_space(space))


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (varied(modle={"gamma": {"low": 0.1, "high": 1}}), "did you mean 'model'"),
        (varied(seed={"low": 0, "high": 1}), "unknown setting that varies: 'seed'"),
        (varied(), "the search space is empty"),
        (varied(worlds=3), "worlds is 3: low and high are needed"),
        (varied(worlds={"low": 3}), "worlds: high is None"),
        (varied(worlds={"low": 3, "high": 4, "lgo": True}), "unknown key of worlds: 'lgo'"),
        (varied(worlds={"low": 3, "high": 3}), "low is 3 and high is 3"),
        (varied(worlds={"low": 0, "high": 3, "log": True}), "low above 0"),
        (varied(worlds={"low": 1, "high": 3, "log": 1}), "log is 1: true or false"),
        (varied(worlds={"low": 1, "high": 3, "step": 0}), "step is 0"),
        (varied(worlds={"choices": 3}), "choices is 3: a list"),
        (varied(options={"max_sped": {"low": 1, "high": 3}}), "did you mean 'max_speed'"),
        (varied(options={"num_drones": {"low": 1, "high": 3}}), "would change evaluations"),
        (
            varied(**{"worlds.more": {"low": 1, "high": 3}}),
            "worlds is 32, which has no nested settings",
        ),
        (lambda: Study(RUN, SPACE, metric="retrun"), "did you mean 'return'"),
    ],
)
def test_impossible_searches_are_refused_with_the_remedy(make, said):
    with pytest.raises(ValueError, match=said):
        make()


def test_a_setting_of_stages_cannot_vary():
    staged = RunConfig("hover", stages=[{"max_speed": 1.0}, {"max_speed": 2.0}])
    space = parse_space({"options.max_speed": {"low": 1.0, "high": 3.0}})
    with pytest.raises(ValueError, match="stages of the run set it"):
        Study(staged, space)


def test_a_setting_that_the_algorithm_does_not_take_is_told_before_anything_runs(trained, tmp_path):
    space = parse_space({"model.gama": {"low": 0.9, "high": 1.0}})
    with pytest.raises(ValueError, match="did you mean 'gamma'"):
        run_study(Study(RUN, space), tmp_path)
    assert trained == []


def test_the_command_searches_writes_and_reads_its_study(trained, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    search = [
        *("--search", "model.learning_rate=1e-4:1e-2:log"),
        *("--search", "model.n_epochs=2:8:2"),
        *("--search", "model.policy_kwargs.net_arch=[64,64],[32]"),
        *("--search", "options.dynamics=rigid_body,point_mass"),
    ]
    main(["tune", "pursuit", "--trials", "3", "--seed", "5", *search, "--out", "study"])
    told = capsys.readouterr().out
    assert "wrote study/trials.csv" in told
    assert "bulletuav train --config study/trials/00" in told
    study = Study.read(tmp_path / "study" / "study.yaml")
    assert study.space == {
        "model.learning_rate": Range(1e-4, 1e-2, log=True),
        "model.n_epochs": Range(2, 8, step=2),
        "model.policy_kwargs.net_arch": Choices(([64, 64], [32])),
        "options.dynamics": Choices(("rigid_body", "point_mass")),
    }
    main(["tune", "--study", "study/study.yaml", "--out", "again"])
    again = (tmp_path / "again" / "trials.csv").read_bytes()
    assert again == (tmp_path / "study" / "trials.csv").read_bytes()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "tune what?"),
        (["hover", "--study", "x"], "tune what?"),
        (["--study", "nowhere.yaml"], "no file nowhere.yaml: the study.yaml of a study"),
        (["hover"], "the search space is empty"),
        (["hover", "--search", "model.gamma"], "--search model.gamma: NAME=VALUE is needed"),
        (["hover", "--search", "model.gamma=1"], "A,B,C is needed"),
        (["hover", "--search", "worlds=1:2:3:4"], "A,B,C is needed"),
        (["hover", "--search", "worlds=1:2", "--workers", "0"], "workers is 0"),
    ],
)
def test_bad_input_ends_in_one_line(arguments, said, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit):
        main(["tune", *arguments])
    assert said in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("version: 1\nrun: {task: hover}\n", "space is None: names with values are needed"),
        ("version: 1\nrun: {task: hover}\nspace: {}\n", "the search space is empty"),
        ("version: 1\nspase: {}\n", "did you mean 'space'"),
    ],
)
def test_a_file_that_is_no_study_is_refused_by_its_name(text, said, tmp_path):
    path = tmp_path / "study.yaml"
    path.write_text(text)
    with pytest.raises(ValueError, match=f"study.yaml: .*{said}"):
        Study.read(path)
