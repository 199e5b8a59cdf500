"""The leaderboard: rows that are made, interrupted and flown again, and what its tables say."""

import json
import re
import sys
from pathlib import Path

import pytest

import bulletuav
from bulletuav.policies.run import read_settings
from bulletuav.report.verification import Verifier
from bulletuav.tasks import find_task

ROOT = Path(__file__).parent.parent
LEARNED = "hover-ppo-0"
SETTINGS = """
version: 1
evaluation: {episodes: 2, seed: 5}
points: {count: 2, episodes: 1}
seeds: [0]
algorithms:
  ppo: {by: fast_ppo, steps: 64, slots: 4, model: {n_steps: 8, batch_size: 32}}
  vdn: {by: vdn, tasks: [crossing], steps: 40, slots: 4, model: {start: 10, batch: 4}}
  maddpg: {by: maddpg, tasks: [crossing], steps: 40, slots: 4, model: {start: 10, batch: 4}}
tasks:
  hover:
    scale: 0.1
    options: {dynamics: point_mass, action: velocity, horizon: 10}
    baselines: [random]
  crossing:
    scale: 0.02
    options: {dynamics: point_mass, num_drones: 2, horizon: 10, lane_spacing: 15.0}
    baselines: []
"""


@pytest.fixture(scope="module")
def benchmark():
    """The benchmark's module."""
    folders = [str(ROOT / "benchmarks"), str(ROOT / "examples")]
    sys.path[:0] = folders
    import leaderboard

    yield leaderboard
    for folder in folders:
        sys.path.remove(folder)


@pytest.fixture(scope="module")
def board(benchmark, tmp_path_factory):
    """A leaderboard that was interrupted in its second row, and gone on with."""
    place = tmp_path_factory.mktemp("leaderboard")
    config, out = place / "leaderboard.yaml", place / "out"
    config.write_text(SETTINGS)
    call = ["--config", str(config), "--out", str(out)]
    evaluate = benchmark.evaluate

    def interrupted(task, policy, *rest, **options):
        if policy == "random":
            return evaluate(task, policy, *rest, **options)
        raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        # One picture is enough, see below
        patch.setattr("leaderboard_tables.plot", lambda *told: None)
        patch.setattr(benchmark, "evaluate", interrupted)
        with pytest.raises(KeyboardInterrupt):
            benchmark.main(call)
        there = {path.name for path in (out / "rows").iterdir()}
        first = (out / "rows" / "hover-random" / "row.json").read_bytes()
        patch.setattr(benchmark, "evaluate", evaluate)
        benchmark.main(call)
    assert there == {"hover-random"}
    assert (out / "rows" / "hover-random" / "row.json").read_bytes() == first, "made twice"
    return out


def test_a_leaderboard_goes_on_where_it_was_interrupted(board):
    rows = {path.name: path for path in (board / "rows").iterdir()}
    names = {"hover-random", LEARNED, "crossing-ppo-0", "crossing-vdn-0", "crossing-maddpg-0"}
    assert set(rows) == names
    assert not list((board / "work").iterdir())
    for name in names - {"hover-random"}:
        files = {path.name for path in rows[name].iterdir()}
        assert files == {"row.json", "run.yaml", "policy.safetensors", "curve.csv"}
        curve = (rows[name] / "curve.csv").read_text().splitlines()
        # A head and two points, and the policy before training
        assert len(curve) == (4 if "ppo" in name else 3)
        told = json.loads((rows[name] / "row.json").read_text())
        assert told["cpu_seconds"]["training"] > 0
        assert not told["reads_swarm"]


@pytest.mark.parametrize("name", ["hover-random", LEARNED, "crossing-vdn-0", "crossing-maddpg-0"])
def test_a_row_is_flown_again_to_the_bit_wherever_it_is(board, name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    moved = tmp_path / "elsewhere"
    (board / "rows" / name).rename(moved)
    try:
        checks = Verifier().verify(moved)
    finally:
        moved.rename(board / "rows" / name)
    assert {check.what for check in checks} >= {"row.json", "episodes", "estimates"}
    assert all(check.same for check in checks)


@pytest.mark.parametrize("file", ["policy.safetensors", "curve.csv", "run.yaml", "row.json"])
def test_a_changed_byte_of_a_row_is_found(board, file):
    path = board / "rows" / LEARNED / file
    before = path.read_bytes()
    place = before.rindex(b"0")
    path.write_bytes(before[:place] + b"1" + before[place + 1 :])
    try:
        checks = Verifier().verify(path.parent)
    finally:
        path.write_bytes(before)
    assert [check.what for check in checks if not check.same] == [file]


def test_a_row_of_other_settings_is_made_again(board, benchmark):
    told = read_settings(board.parent / "leaderboard.yaml", "settings")
    rows = {row.name: row for row in benchmark.list_rows(told)}
    assert benchmark.read_told(board, rows[LEARNED])
    told["algorithms"]["ppo"]["steps"] = 128
    rows = {row.name: row for row in benchmark.list_rows(told)}
    assert benchmark.read_told(board, rows[LEARNED]) is None
    assert benchmark.read_told(board, rows["hover-random"])
    assert benchmark.read_told(board, rows["crossing-vdn-0"])


@pytest.mark.parametrize("killed", [False, True])
def test_a_row_stands_until_a_new_one_is_made(board, benchmark, killed, monkeypatch):
    told = read_settings(board.parent / "leaderboard.yaml", "settings")
    row = next(row for row in benchmark.list_rows(told) if row.name == "hover-random")
    place, before = board / "rows" / row.name, board / "work" / row.name / "before"
    text = (place / "row.json").read_text()
    rename = Path.rename

    def stop(path, to):
        assert place.exists()
        if killed:  # between the two moves
            rename(path, to)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Path, "rename", stop)
        with pytest.raises(KeyboardInterrupt):
            benchmark.make(row, board)
    assert ((before if killed else place) / "row.json").read_text() == text

    def interrupted(*told, **options):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(benchmark, "evaluate", interrupted)
        with pytest.raises(KeyboardInterrupt):
            benchmark.make(row, board)
    assert (place / "row.json").read_text() == text
    benchmark.make(row, board)
    made, old = (json.loads(one)["hash"] for one in ((place / "row.json").read_text(), text))
    assert made == old
    assert not (board / "work" / row.name).exists()


def test_tables_tell_what_was_flown_and_what_was_not(board, benchmark):
    told = read_settings(board.parent / "leaderboard.yaml", "settings")
    rows = benchmark.list_rows(told)
    lacking = rows[0]._replace(policy="sac", seed=7)
    out = board.parent / "tables"
    (out / "rows").parent.mkdir()
    (out / "rows").symlink_to(board / "rows")
    benchmark.write_tables([*rows, lacking], dict.fromkeys(told["tasks"], "return"), out)
    text = (out / "leaderboard.md").read_text()
    learned = json.loads((board / "rows" / LEARNED / "row.json").read_text())
    found = learned["estimates"]["return"]
    low, mean, high = (learned["estimates"]["safe_success"][key] for key in ("low", "mean", "high"))
    start = f"| `ppo` | what drones observe | 0 | {mean:.2f} [{low:.2f}, {high:.2f}] |"
    assert f"{start} {found['mean']:.1f} [{found['low']:.1f}," in text
    assert "| `random` | nothing | - |" in text
    assert "5 of 6 rows are there." in text
    assert "- `sac`, seed 7: hover" in text
    assert learned["hash"] in (out / "leaderboard.csv").read_text()
    assert (out / "leaderboard.png").read_bytes().startswith(b"\x89PNG")


def test_a_row_flies_again_without_training(board, benchmark, monkeypatch):
    path = board / "rows" / LEARNED
    before = {file.name: file.read_bytes() for file in path.iterdir()}
    monkeypatch.setattr(benchmark, "_train", None)
    monkeypatch.setattr("leaderboard_tables.plot", lambda *args: None)
    call = ["--config", str(board.parent / "leaderboard.yaml"), "--out", str(board)]
    benchmark.main([*call, "--evaluate", "--rows", LEARNED])
    after = {file.name: file.read_bytes() for file in path.iterdir()}
    mine, former = (json.loads(one.pop("row.json")) for one in (after, before))
    assert after == before
    assert mine["hash"] == former["hash"]
    for kind in ("wall_seconds", "cpu_seconds"):
        assert mine[kind]["training"] == former[kind]["training"] > 0
    assert all(check.same for check in Verifier().verify(path))


def test_safe_success_ranks_before_the_score(benchmark, tmp_path):
    from leaderboard_tables import read_entries, verdict

    rows = []
    for policy, success, score in [("a", 0.5, 90.0), ("b", 1.0, 10.0), ("c", 0.998, 20.0)]:
        row = benchmark.list_rows(read_settings(ROOT / "benchmarks" / "leaderboard.yaml", "s"))[0]
        row = row._replace(policy=policy)
        estimates = {
            name: {"mean": mean, "low": mean, "high": mean, "episodes": 2}
            for name, mean in (("safe_success", success), ("return", score))
        }
        record = {**row._asdict(), "reads_swarm": False, "episodes": 2, "estimates": estimates}
        folder = tmp_path / "rows" / row.name
        folder.mkdir(parents=True)
        (folder / "row.json").write_text(json.dumps(record))
        rows.append(row)
    ones = read_entries(rows, {rows[0].task: "return"}, tmp_path)[rows[0].task]
    assert [one.policy for one in ones] == ["c", "b", "a"]
    by_policy = {one.policy: one for one in ones}
    assert verdict(by_policy["a"], by_policy["b"]) == "misses it"
    assert verdict(by_policy["b"], by_policy["a"]) == "beats it"
    equal = by_policy["b"]._replace(success=by_policy["c"].success)
    assert verdict(equal, by_policy["c"]) == "misses it"
    assert verdict(by_policy["c"], equal) == "beats it"
    assert verdict(equal, equal) == "ties with it"


def published():
    """Read the published tables: a dict of cells for each row, with its task."""
    text = (ROOT / "docs" / "results" / "leaderboard" / "leaderboard.md").read_text()
    for part in re.split(r"(?m)^## (?!Completeness)", text)[1:]:
        task, *lines = part.splitlines()
        table = [line for line in lines if line.startswith("|")]
        heads, _, *rows = ([cell.strip() for cell in line.strip("| ").split("|")] for line in table)
        for row in rows:
            yield {"task": task, **dict(zip(heads, row, strict=True))}


@pytest.mark.parametrize("task", bulletuav.list_tasks())
def test_no_published_row_earns_more_for_less_success(task):
    def low_and_high(cell):
        low, high = re.search(r"\[(\S+), (\S+)\]", cell).groups()
        return float(low), float(high)

    rows = [row for row in published() if row["task"] == task]
    score = "return" if "return" in rows[0] else "team 0 return"
    kind = find_task(task)
    baseline, *_ = kind.baseline.split(" vs ")
    by_policy = {row["policy"]: row for row in rows}
    # A baseline that needs pictures is no row: learned rows observe vectors
    base = by_policy.get(f"`{baseline}`") or by_policy[f"`{kind.oracle}`"]
    for row in rows:
        is_less_safe = low_and_high(row["safe success"])[1] < low_and_high(base["safe success"])[0]
        earns_more = low_and_high(row[score])[0] > low_and_high(base[score])[1]
        assert not (is_less_safe and earns_more), row["policy"]


def test_intervals_over_seeds_are_students(benchmark):
    from leaderboard_tables import over_seeds

    def row(mean):
        one = {"mean": mean, "low": mean - 9, "high": mean + 9, "episodes": 50}
        return {"estimates": {"return": one}, "episodes": 50}

    alone = over_seeds([row(2.0)], "return")
    assert (alone.low, alone.high, alone.episodes) == (-7.0, 11.0, 50)
    # t of 2 degrees of freedom is 4.3027 (any table), times 1 / sqrt(3)
    three = over_seeds([row(1.0), row(2.0), row(3.0)], "return")
    assert three.mean == 2.0
    assert three.high - three.mean == pytest.approx(4.3027 / 3**0.5, abs=1e-4)
    assert three.mean - three.low == pytest.approx(three.high - three.mean)
    assert three.episodes == 150


def test_unknown_rows_are_refused_with_the_nearest(benchmark):
    told = read_settings(ROOT / "benchmarks" / "leaderboard.yaml", "settings")
    with pytest.raises(ValueError, match="crossing-ppo-0"):
        benchmark.chosen(benchmark.list_rows(told), ["crosing-ppo-0"])


def test_tables_are_not_written_without_recorded_rows(benchmark, tmp_path, monkeypatch):
    out, manifest = tmp_path / "docs" / "results" / "leaderboard", tmp_path / "manifest.json"
    manifest.write_text(
        '{"files": {"docs/results/leaderboard/rows/hover-random": {"row.json": []}}}'
    )
    monkeypatch.setattr(benchmark, "OUT", out)
    monkeypatch.setattr(benchmark, "MANIFEST", manifest)
    with pytest.raises(SystemExit, match="hover-random.*fetch --all"):
        benchmark.require_rows(out)
    benchmark.require_rows(tmp_path / "again")
    (out / "rows" / "hover-random").mkdir(parents=True)
    (out / "rows" / "hover-random" / "row.json").write_text("{}")
    benchmark.require_rows(out)


def test_the_settings_have_all_tasks_and_three_seeds(benchmark):
    told = read_settings(ROOT / "benchmarks" / "leaderboard.yaml", "settings")
    assert sorted(told["tasks"]) == bulletuav.list_tasks()
    rows = benchmark.list_rows(told)
    assert len({row.name for row in rows}) == len(rows)
    for name, one in told["algorithms"].items():
        mine = {(row.task, row.seed) for row in rows if row.policy == name}
        assert mine == {
            (task, seed) for task in one.get("tasks", told["tasks"]) for seed in (0, 1, 2)
        }


@pytest.fixture(scope="module")
def pair(benchmark):
    """Two drones of one team, and a batch of what they see."""
    import torch

    import bulletuav

    torch.manual_seed(0)
    env = bulletuav.batch_env(
        "converge", 64, num_drones=2, dynamics="point_mass", action="discrete"
    )
    seen = torch.from_numpy(env.reset(seed=0)[0])
    yield env, seen
    env.close()


@pytest.mark.parametrize("name", ["vdn", "qmix"])
def test_value_decomposition_finds_who_earned_what_the_team_is_paid(pair, name):
    import torch
    from team_critics import LEARNERS, Plan

    env, seen = pair
    learner = LEARNERS[name](env, Plan("crossing", {}, tau=1.0, rate=3e-3))
    for _ in range(150):
        action = learner.random(seen)
        # The first earns by choice 2 and the second by choice 3, but the first is paid for both
        paid = (action[:, 0, 0] == 2).float() + (action[:, 1, 0] == 3).float()
        told = torch.ones(64, 2, 3)
        told[..., 0] = torch.stack([paid, torch.zeros(64)], -1)
        told[..., 2] = 0  # and all ends there
        learner.learn(seen, action, told, seen)
    best = learner.actor(seen).argmax(-1)
    assert (best[:, 0] == 2).all()
    assert (best[:, 1] == 3).all()


def test_mixed_values_rise_with_those_of_drones_that_fly(pair):
    import torch
    from team_critics import Mixer

    env, seen = pair
    torch.manual_seed(0)
    mixer = Mixer(env)
    value = torch.randn(64, 2)
    with torch.no_grad():
        mixed = mixer(value, torch.ones(64, 2), seen)
        assert mixed.shape == (64, 1)
        for drone in range(2):
            more = value.clone()
            more[:, drone] += 1
            assert (mixer(more, torch.ones(64, 2), seen) > mixed).all()
        # The weights depend on observations, and a drone that does not fly has no part
        other = mixer(value, torch.ones(64, 2), seen.flip(0))
        assert not torch.allclose(other, mixed)
        flies = torch.tensor([1.0, 0.0]).expand(64, 2)
        hidden = torch.cat([value[:, :1], value[:, 1:] + 5], 1)
        changed = torch.stack([seen[:, 0], seen[:, 1] + 5], 1)
        assert torch.equal(mixer(value, flies, seen), mixer(hidden, flies, changed))
        assert (mixer(value, torch.zeros(64, 2), seen) == 0).all()


def test_maddpg_learns_by_a_critic_that_sees_what_others_do(pair):
    import torch
    from team_critics import Maddpg, Plan

    import bulletuav

    _, seen = pair
    env = bulletuav.batch_env("converge", 1, num_drones=2, dynamics="point_mass")
    learner = Maddpg(env, Plan("crossing", {}, rate=3e-3))
    joint = learner._joint(seen, torch.zeros(64, 2, 3), torch.ones(64, 2, 1))
    half = joint.shape[-1] // 2
    assert torch.equal(joint[:, 0, :half], joint[:, 1, half:])  # who comes first is oneself
    aim = torch.tensor([0.5, -0.5])
    for _ in range(300):
        action = learner.random(seen)
        error = (action[..., 0] - aim).square().sum(1, keepdim=True)
        told = torch.ones(64, 2, 3)
        told[..., 0], told[..., 2] = -error, 0
        learner.learn(seen, action, told, seen)
    done = torch.tanh(learner.actor(seen))[..., 0].mean(0)
    assert done.tolist() == pytest.approx([0.5, -0.5], abs=0.2)
    env.close()


def test_maddpg_learns_nothing_where_nobody_flies(pair):
    import torch
    from team_critics import Maddpg, Plan

    import bulletuav

    _, seen = pair
    env = bulletuav.batch_env("converge", 1, num_drones=2, dynamics="point_mass")
    learner = Maddpg(env, Plan("crossing", {}))
    before = [part.clone() for part in (*learner.actor.parameters(), *learner.critic.parameters())]
    learner.learn(seen, learner.random(seen), torch.zeros(64, 2, 3), seen)
    after = (*learner.actor.parameters(), *learner.critic.parameters())
    assert all(torch.equal(old, new) for old, new in zip(before, after, strict=True))
    env.close()


def test_team_critics_can_learn_from_the_first_decision_on(benchmark, tmp_path):
    import team_critics

    plan = team_critics.Plan("converge", {"dynamics": "point_mass"}, 2, 64, start=0, batch=4)
    team_critics.train("vdn", plan, 0, tmp_path / "never", lambda steps, keep: None)
    assert (tmp_path / "never" / "policy.safetensors").exists()
