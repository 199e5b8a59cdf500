"""Files that others made: what they hold never runs, unless it is trusted."""

import ast
import json
import os
import pickle
import re
import stat
import zipfile
from pathlib import Path

import pytest

import bulletuav
from bulletuav.cli import main
from bulletuav.compiled import folders, kernel
from bulletuav.policies import find_policy
from bulletuav.policies.neural_network import read_weights
from bulletuav.policies.run import RunConfig

PACKAGE = Path(bulletuav.__file__).parent
SHORT = ["--dynamics", "single_integrator", "--drones", "2", "--horizon", "4"]


class Poison:
    """Makes a folder when it is read by pickle."""

    def __init__(self, place):
        self.place = place

    def __reduce__(self):
        return os.mkdir, (str(self.place),)


@pytest.fixture
def sprung(tmp_path):
    """What shows that something ran."""
    return tmp_path / "sprung"


@pytest.fixture
def poison(sprung):
    return pickle.dumps(Poison(sprung))


def poisoned_zip(path, poison):
    """A model as stable-baselines3 saves one, with an object that runs."""
    from base64 import b64encode

    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(
            "data",
            json.dumps(
                {"policy_class": {":type:": "x", ":serialized:": b64encode(poison).decode()}}
            ),
        )
        archive.writestr("_stable_baselines3_version", "2.9.2")


def refused(arguments, capsys, said):
    with pytest.raises(SystemExit) as end:
        main(arguments)
    assert end.value.code == 2
    assert said in capsys.readouterr().err.splitlines()[-1]


def test_the_poison_works(sprung, poison):
    pickle.loads(poison)
    assert sprung.exists()


COMMANDS = {
    "fly": ["fly", "crossing", *SHORT, "--animation", "none", "--policy"],
    "evaluate": ["evaluate", "crossing", *SHORT, "--episodes", "1", "--policy"],
    "compare": ["compare", "--tasks", "crossing", *SHORT, "--episodes", "1", "--policies"],
}


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("as_run", [False, True])
def test_a_poisoned_model_is_refused_before_anything_of_it_runs(
    command, as_run, tmp_path, sprung, poison, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    policy = "ppo:model.zip"
    if as_run:  # of a version that kept models so
        (tmp_path / "run.yaml").write_text(RunConfig("crossing").text())
        policy = "."
    poisoned_zip(tmp_path / "model.zip", poison)
    refused(
        [*COMMANDS[command], policy, "--out", "out"], capsys, "can execute code when it is read"
    )
    assert not sprung.exists()
    import stable_baselines3  # noqa: F401 - skips the rest without it

    with pytest.raises(SystemExit):  # it is no whole model, but is read: that the test can fail
        main([*COMMANDS[command], policy, "--out", "out", "--trust"])
    assert sprung.exists()


def test_python_is_refused_as_well(tmp_path, sprung, poison):
    poisoned_zip(tmp_path / "model.zip", poison)
    source = f"ppo:{tmp_path / 'model.zip'}"
    with pytest.raises(ValueError, match="trust=True"):
        find_policy(source)
    with pytest.raises(ValueError, match="trust=True"):
        bulletuav.evaluate("crossing", source, 1)
    from bulletuav.adapters.sb3_model import Sb3Model

    aviary = bulletuav.Aviary("crossing")
    with pytest.raises(ValueError, match="trust=True"):
        Sb3Model(aviary, "ppo", tmp_path / "model.zip")
    aviary.close()
    assert not sprung.exists()


def interrupted(run):
    """Train until the first checkpoint."""
    from bulletuav.training import trainer

    config = RunConfig.read(run / "run.yaml")

    def stop(steps):
        if steps > 20:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        trainer.train(config, run, stop)


def test_resuming_reads_no_pickle(tmp_path, sprung, poison, capsys, monkeypatch):
    """With one in every place where it could be: beside the files that are read, and instead."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run").mkdir()
    options = {
        "dynamics": "single_integrator",
        "num_drones": 2,
        "horizon": 4,
        "observation": ["goal"],
    }
    model = {"learning_starts": 8, "batch_size": 8, "buffer_size": 100}
    config = RunConfig("crossing", "sac", 0, 64, 2, options, model=model, evaluations=4, episodes=1)
    (tmp_path / "run" / "run.yaml").write_text(config.text())
    interrupted(tmp_path / "run")
    last = sorted((tmp_path / "run" / "checkpoints").iterdir())[-1]
    assert {path.name for path in last.iterdir()} >= {
        "policy.safetensors",
        "training.safetensors",
        "replay.safetensors",
    }
    for name in ("000.zip.pkl", "replay.pkl", "policy.pth", "pytorch_variables.pth"):
        (last / name).write_bytes(poison)
    (tmp_path / "run" / "model.zip").write_bytes(poison)
    poisoned_zip(tmp_path / "run" / "model.zip", poison)
    main(["train", "--config", "run/run.yaml", "--out", "run"])
    assert not sprung.exists()
    for name in ("replay.safetensors", "training.safetensors", "policy.safetensors"):
        state = (tmp_path / "run" / "state.json").read_text()
        changed = json.loads(state)
        changed["rows"][-1]["steps"] -= 1  # so that there is something left to do
        (tmp_path / "run" / "state.json").write_text(json.dumps(changed))
        last = sorted((tmp_path / "run" / "checkpoints").iterdir())[-1]
        kept = (last / name).read_bytes()
        (last / name).write_bytes(poison)
        refused(
            ["train", "--config", "run/run.yaml", "--out", "run"],
            capsys,
            "holds no checkpoint of this run",
        )
        (last / name).write_bytes(kept)
        (tmp_path / "run" / "state.json").write_text(state)
    assert not sprung.exists()


def test_checkpoints_of_an_older_version_are_not_read(tmp_path, sprung, poison):
    from bulletuav.training.trainer import train

    config = RunConfig("crossing", steps=32)
    (tmp_path / "checkpoints").mkdir()
    (tmp_path / "run.yaml").write_text(config.text())
    (tmp_path / "state.json").write_text(
        json.dumps({"rows": [{"steps": 0, "decisions": 0}], "curriculum": {}})
    )
    poisoned_zip(tmp_path / "checkpoints" / "000.zip", poison)
    with pytest.raises(
        ValueError, match="checkpoints of an older version, which can run code when read"
    ):
        train(config, tmp_path)
    assert not sprung.exists()


def test_files_that_are_not_what_they_are_called_are_refused(tmp_path, sprung, poison):
    path = tmp_path / "policy.safetensors"
    for content in (
        poison,
        b"",
        b"\x00" * 8,
        b"\xff" * 64,
        b'\x08\x00\x00\x00\x00\x00\x00\x00{"a":0}',
        b"PK\x03\x04",
    ):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=re.escape(str(path))):
            read_weights(path)
    assert not sprung.exists()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("task: !!python/object/apply:os.system ['touch {place}']", "is not valid YAML"),
        ("task: crossing\nmodel: !!python/name:os.system ''", "is not valid YAML"),
        ("task: crossing\nmodel: {{a: &a [1, 2], b: *a}}", "it has an alias"),
    ],
)
def test_yaml_makes_plain_values_alone(text, said, tmp_path, sprung):
    (tmp_path / "run.yaml").write_text(text.format(place=sprung))
    with pytest.raises(ValueError, match=said):
        RunConfig.read(tmp_path / "run.yaml")
    assert not sprung.exists()


@pytest.mark.parametrize(
    "entities",
    [
        '<!ENTITY a0 "aaaaaaaaaa">'
        + "".join(f'<!ENTITY a{k} "{f"&a{k - 1};" * 10}">' for k in range(1, 10)),
        '<!ENTITY a9 SYSTEM "file:///etc/passwd">',
    ],
    ids=["expansion", "external"],
)
def test_entities_of_xml_neither_expand_without_end_nor_read_files(entities, tmp_path):
    text = bulletuav.load_airframe("cf2x").urdf.read_text()
    text = text.replace(
        '<robot name="cf2x">',
        f'<!DOCTYPE robot [{entities}]>\n<robot name="cf2x"><about>&a9;</about>',
    )
    (tmp_path / "own.urdf").write_text(text)
    with pytest.raises(ValueError, match=r"own\.urdf is not valid XML"):
        bulletuav.load_airframe(tmp_path / "own.urdf")


READS = re.compile(
    r"(?<!def )(?<!builder\.)\b(read_(?:json|toml|yaml|xml|file|schema|table)|parse_json|load|"
    r"load_extension|loads|load_file|safe_open|ZipFile|parse|read_text|read_bytes|recv|recvfrom|feed|loadURDF|load_replay_buffer|"
    r"eval|exec)\("
    r"|(?<!os)\.open\((?!'w')"
)


def test_what_reads_a_file_is_told():
    """The table of SECURITY.md has every file of the source that reads one, and no other."""
    found = set()
    for path in PACKAGE.rglob("*.py"):
        tree = ast.parse(path.read_text())
        code = ast.unparse(tree)  # without comments
        if READS.search(code):
            found.add(path.relative_to(PACKAGE).as_posix())
    rows = re.findall(
        r"^\| (`.*?) \|", (PACKAGE.parent / "SECURITY.md").read_text(), flags=re.MULTILINE
    )
    told = {name for row in rows for name in re.findall(r"`([\w/]+\.py)`", row)}
    assert found == told


def test_nothing_in_the_package_imports_pickle_to_read():
    """But for compiled kernels, which run code anyway; the next test is about their folder."""
    for path in set(PACKAGE.rglob("*.py")) - {PACKAGE / "compiled" / "dispatcher.py"}:
        assert not re.search(
            r"pickle\.loads?\(|torch\.load\(|allow_pickle=True|"
            r"yaml\.(unsafe_)?load\((?!text, _Loader\))",
            path.read_text(),
        )


def test_compiled_kernels_are_read_from_folders_of_ones_own(tmp_path, monkeypatch):
    """Where the user's cache cannot be written to, they are below a temporary folder.

    Nobody else may be able to write there.
    """
    monkeypatch.setattr(folders.config, "CACHE_DIR", str(tmp_path / "file" / "below"))
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(folders.tempfile, "gettempdir", lambda: str(tmp_path))
    spare = tmp_path / f"bulletuav-{os.getuid()}"
    assert kernel.cache_folder().is_relative_to(spare)
    assert stat.S_IMODE(spare.stat().st_mode) == 0o700
    spare.chmod(0o777)
    with pytest.raises(OSError, match="set NUMBA_CACHE_DIR"):
        kernel.cache_folder()
    spare.chmod(0o700)
    os.rename(spare, tmp_path / "theirs")
    spare.symlink_to(tmp_path / "theirs")
    with pytest.raises(OSError, match="set NUMBA_CACHE_DIR"):
        kernel.cache_folder()
