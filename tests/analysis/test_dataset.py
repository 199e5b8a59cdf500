"""Datasets: what drones observed and did, read back by Minari and as tables."""

import json
import sys

import minari
import numpy as np
import pyarrow.parquet as pq
import pytest

import bulletuav
from bulletuav.analysis.dataset import collect
from bulletuav.cli import main
from bulletuav.policies import find_policy

EPISODES = 12
NEAR = {"half_length": 20.0, "lane_spacing": 10.0, "goal_radius": 30.0, "start_speed": (0.0, 10.0)}
"""Drones begin near their goals, and leave early"""
OPTIONS = {"dynamics": "point_mass", "num_drones": 3, "horizon": 25, "difficulty": "easy", **NEAR}
ARGUMENTS = [
    *["--dynamics", "point_mass", "--drones", "3", "--horizon", "25", "--difficulty", "easy"],
    *[text for name, value in NEAR.items() for text in ("--set", f"{name}={value}")],
]
CALL = ["dataset", "crossing", "--policy", "straight", "--episodes", str(EPISODES), *ARGUMENTS]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A dataset that one process has made."""
    path = tmp_path_factory.mktemp("flights")
    main([*CALL, "--out", str(path)])
    return path


def files(folder):
    """Bytes of all files, by their path."""
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


def test_minari_reads_each_drones_flights(folder, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(folder / "minari"))
    env = bulletuav.parallel_env("crossing", **OPTIONS)
    for drone in range(3):
        data = minari.load_dataset(f"crossing/straight/drone_{drone}-v0")
        assert data.total_episodes == EPISODES
        assert data.observation_space == env.observation_space("drone_0")
        assert data.action_space == env.action_space("drone_0")
        for episode in data.iterate_episodes([0, EPISODES - 1]):
            count = len(episode.rewards)
            assert episode.observations.shape == (count + 1, *data.observation_space.shape)
            assert episode.actions.shape == (count, 3)
            assert all(data.observation_space.contains(one) for one in episode.observations)
            ends = episode.terminations | episode.truncations
            assert ends.tolist() == [False] * (count - 1) + [True]
    env.close()


def test_actions_that_are_read_fly_the_same_again(folder, monkeypatch):
    """Observations, rewards and ends come back as the flight of an environment gives them."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(folder / "minari"))
    names = [f"crossing/straight/drone_{drone}-v0" for drone in range(3)]
    drones = [minari.load_dataset(name)[11] for name in names]
    env = bulletuav.parallel_env("crossing", **OPTIONS)
    seen, _ = env.reset(seed=11)
    early = 0
    for step in range(25):
        for agent in env.agents:
            saw = drones[int(agent[-1])].observations[step]
            np.testing.assert_allclose(saw, seen[agent], atol=1e-4)
        if not env.agents:
            break
        flown = env.agents[:]
        seen, rewards, terminated, truncated, _ = env.step(
            {agent: drones[int(agent[-1])].actions[step] for agent in flown}
        )
        for agent in flown:
            one = drones[int(agent[-1])]
            assert one.rewards[step] == pytest.approx(rewards[agent], abs=1e-3)
            assert one.terminations[step] == terminated[agent]
            assert one.truncations[step] == truncated[agent]
            if terminated[agent] or truncated[agent]:
                early += step < 24
                np.testing.assert_allclose(one.observations[-1], seen[agent], atol=1e-4)
                assert len(one.rewards) == step + 1
    assert early
    env.close()


def test_tables_hold_every_transition_once(folder):
    table = pq.read_table(folder / "parquet")
    about = json.loads((folder / "dataset.json").read_text())
    rows = table.to_pydict()
    keys = list(zip(rows["episode"], rows["drone"], rows["step"], strict=True))
    assert keys == sorted(set(keys))
    assert {key[0] for key in keys} == set(range(EPISODES))
    for k, end in enumerate(about["ends"]):
        steps = [key[2] for key in keys if key[0] == k]
        assert end["seed"] == end["episode"] == k
        assert end["decisions"] == max(steps) + 1
        assert len(end["state_hash"]) == 32
    finals = [one is not None for one in rows["final_observation"]]
    ends = [a or b for a, b in zip(rows["terminated"], rows["truncated"], strict=True)]
    assert finals == ends
    assert sum(finals) == 3 * EPISODES


def test_the_hash_is_that_of_the_flight(folder):
    about = json.loads((folder / "dataset.json").read_text())
    aviary = bulletuav.Aviary("crossing", 10, action="velocity", **OPTIONS)
    policy = find_policy("straight")(aviary)
    observations = aviary.reset(seeds=0)
    policy.reset(np.ones(10, dtype=bool))
    while aviary.alive.any():
        observations = aviary.step(policy.act(observations, aviary.swarm)).observations
    assert [end["state_hash"] for end in about["ends"][:10]] == list(aviary.state_hash())
    aviary.close()


def test_pieces_and_processes_give_the_same_bytes(folder, tmp_path, capsys):
    for piece in ("2/2", "1/2"):
        main([*CALL, "--out", str(tmp_path / "apart"), "--piece", piece])
        if piece == "2/2":
            with pytest.raises(SystemExit):
                main(["merge", str(tmp_path / "apart")])
            assert "lacks 1 tables, the first is that of episode 0" in capsys.readouterr().err
    main(["merge", str(tmp_path / "apart")])
    main([*CALL, "--out", str(tmp_path / "both"), "--workers", "2"])
    assert "wrote" in capsys.readouterr().out
    assert files(tmp_path / "apart") == files(folder) == files(tmp_path / "both")


def test_discrete_actions_are_choices(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    tables = collect(
        "crossing", "random", 2, action="discrete", out="here", **OPTIONS | {"horizon": 3}
    )
    actions = pq.read_table(tables[0])["action"].to_pylist()
    assert set(actions) <= set(range(7))
    assert all(type(one) is int for one in actions)


def test_what_cannot_be_is_refused(folder, tmp_path, monkeypatch, capsys):
    with pytest.raises(ValueError, match="holds vectors of numbers: choose observation_format"):
        collect("crossing", out=tmp_path, observation_format="dict", **OPTIONS)
    with pytest.raises(ValueError, match="holds another run: its policy is 'straight'"):
        collect("crossing", "stay", EPISODES, out=folder, **OPTIONS)
    (tmp_path / "parquet").mkdir()
    (tmp_path / "run.json").write_text("{")
    with pytest.raises(ValueError, match="run.json is damaged"):
        collect("crossing", "stay", EPISODES, out=tmp_path, **OPTIONS)
    (tmp_path / "other" / "parquet").mkdir(parents=True)
    (tmp_path / "other" / "parquet" / "episodes-000000.parquet").write_bytes(b"PAR1")
    with pytest.raises(ValueError, match="is damaged .*: delete it, and collect again"):
        collect("crossing", "stay", 10, out=tmp_path / "other", **OPTIONS)
    for name in [one for one in sys.modules if one.startswith("bulletuav.adapters.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delitem(sys.modules, "bulletuav.analysis.dataset")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(SystemExit):
        main([*CALL, "--out", str(tmp_path / "more")])
    assert "needs the extra 'dataset'" in capsys.readouterr().err


def test_absent_drones_have_no_transitions(tmp_path):
    options = {**OPTIONS, "num_drones": (1, 3)}
    collect("crossing", "straight", episodes=6, out=tmp_path, **options)
    aviary = bulletuav.Aviary("crossing", **options)
    present = set()
    for episode in range(6):
        aviary.reset(seeds=episode)
        present |= {(episode, drone) for drone in np.flatnonzero(aviary.members[0]).tolist()}
    assert 6 < len(present) < 18
    found = set()
    for path in (tmp_path / "parquet").iterdir():
        rows = pq.read_table(path)
        found |= set(zip(rows["episode"].to_pylist(), rows["drone"].to_pylist(), strict=True))
    assert found == present
    # The same call continues, although JSON has no tuples
    collect("crossing", "straight", episodes=6, out=tmp_path, **options)
    aviary.close()


def test_each_team_has_the_numbers_that_it_observes(tmp_path, monkeypatch):
    mixed = {"chasers": ["velocity", "room"], "evaders": ["velocity"]}
    options = {"num_drones": 4, "dynamics": "point_mass", "horizon": 9, "observation": mixed}
    collect("pursuit_evasion", "lead vs flee", 2, out=tmp_path, **options)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    for drone, size in enumerate((9, 9, 9, 3)):
        data = minari.load_dataset(f"pursuit_evasion/lead_vs_flee/drone_{drone}-v0")
        assert data.observation_space.shape == (size,)
        for episode in data.iterate_episodes():
            assert all(data.observation_space.contains(one) for one in episode.observations)
    # Rows of the tables have zeros beyond the numbers of a drone
    (table,) = tmp_path.glob("parquet/*.parquet")
    rows = pq.read_table(table)
    seen = np.stack(rows["observation"].to_numpy())
    assert seen.shape[1] == 9
    is_evader = rows["drone"].to_numpy() == 3
    assert not seen[is_evader, 3:].any()
    assert seen[~is_evader, 3:].any()
