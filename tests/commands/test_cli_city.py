"""Cities on the command line: `bulletuav city`, and `--city` of the commands that fly."""

import json

import numpy as np
import pytest
from PIL import Image

from bulletuav.city.imports import from_obj
from bulletuav.cli import main

FILES = {"map.png", "city.obj", "statistics.json", "city.png"}
FLY = [
    "fly",
    "lidar_navigation",
    "--horizon",
    "20",
    "--animation",
    "none",
    "--dynamics",
    "rigid_body",
]
SMALL = ["--set", "area=250", "--set", "num_layouts=1", "--set", "leg=100"]


def make(out, *words):
    """Run `bulletuav city`; returns the statistics that it wrote."""
    main(["city", *words, "--out", str(out)])
    assert {path.name for path in out.iterdir()} == FILES
    return json.loads((out / "statistics.json").read_text())


def one_line(words, capsys):
    """What a command that fails says, in its one line on standard error."""
    with pytest.raises(SystemExit) as end:
        main(words)
    out, err = capsys.readouterr()
    assert end.value.code == 2
    assert out == ""
    lines = [line for line in err.splitlines() if line]
    assert len(lines) == 1
    return lines[0]


def test_all_files_are_written_and_the_statistics_are_those_of_the_city(tmp_path, capsys):
    told = make(
        tmp_path, "--kind", "high_rise", "--side", "300", "--seed", "2", "--irregularity", "0.5"
    )
    city = from_obj(tmp_path / "city.obj", side=300.0)
    assert (told["name"], told["side_m"], told["buildings"]) == (
        "high_rise",
        300,
        len(city.heights),
    )
    numbers = {name: row["realised"] for name, row in told["statistics"].items()}
    assert numbers["built-up share"] == pytest.approx(0.5)
    assert numbers["built-up share"] == pytest.approx(city.coverage, rel=1e-6)
    assert numbers["buildings per km2"] == pytest.approx(len(city.heights) / 0.09)
    assert numbers["Rayleigh scale of heights, m"] == pytest.approx(
        np.sqrt((city.heights**2).mean() / 2), rel=1e-6
    )
    assert numbers["mean height, m"] == pytest.approx(city.heights.mean(), rel=1e-6)
    assert numbers["greatest height, m"] == pytest.approx(city.heights.max(), rel=1e-6)
    aims = [row["target"] for row in told["statistics"].values()][:3]
    assert aims == [0.5, 300, 50]
    for name in ("map.png", "city.png"):
        picture = np.asarray(Image.open(tmp_path / name).convert("RGB"))
        assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 3, (
            name
        )  # ground, and walls and roofs in several tones
    said = capsys.readouterr().out
    for name in FILES:
        assert f"wrote {tmp_path / name}" in said


def test_the_same_seed_gives_the_same_files(tmp_path):
    words = ["--kind", "suburban", "--side", "200", "--irregularity", "1"]
    for folder, seed in (("one", "5"), ("two", "5"), ("other", "6")):
        make(tmp_path / folder, *words, "--seed", seed)
    for name in FILES:
        one, two, other = (
            (tmp_path / folder / name).read_bytes() for folder in ("one", "two", "other")
        )
        assert one == two, name
        assert one != other, name


def test_what_was_written_can_be_read_again(tmp_path):
    first = make(tmp_path / "first", "--side", "250", "--irregularity", "1", "--seed", "1")
    again = make(
        tmp_path / "again", "--import", str(tmp_path / "first" / "city.obj"), "--side", "250"
    )
    assert again["buildings"] == first["buildings"]
    assert again["name"] == "city"
    for name, row in again["statistics"].items():
        assert row["target"] is None
        if "street" not in name:
            assert row["realised"] == pytest.approx(
                first["statistics"][name]["realised"], rel=1e-6
            ), name


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--kind", "urbane"], "unknown kind of city 'urbane': did you mean 'urban'"),
        (
            ["--alpha", "1.5"],
            "alpha is 1.5: the built-up fraction of the ground must be between 0 and 1",
        ),
        (["--alpha", "nan"], "alpha is nan"),
        (["--beta", "0"], "beta is 0.0: a positive number"),
        (["--gamma", "-3"], "gamma is -3.0: a positive number"),
        (["--gamma", "high"], "invalid float value: 'high'"),
        (["--irregularity", "2"], "irregularity is 2.0: a number from 0"),
        (["--side", "10"], "side is 10.0 m: two blocks need at least"),
        (["--side", "inf"], "side is inf"),
        (["--seed", "-1"], "seed is -1"),
        (["--seed", "1.5"], "invalid int value: '1.5'"),
        (["--import", "nowhere.obj"], "nowhere.obj"),
        (["--import", "nowhere.geojson"], "nowhere.geojson"),
        (["--import", "town.stl"], "unknown kind of file 'town.stl' with ending '.stl'"),
        (
            ["--import", "town.obj", "--seed", "1"],
            "--seed has no meaning for an import of town.obj",
        ),
        (["--scale", "2"], "--scale has no meaning for a generated city"),
        (["--king", "urban"], "unknown argument --king: did you mean --kind"),
    ],
)
def test_bad_words_for_a_city_end_in_one_line(words, message, capsys, tmp_path):
    assert message in one_line(["city", *words, "--out", str(tmp_path / "city")], capsys)
    assert not (tmp_path / "city").exists()


@pytest.mark.parametrize("content", ["", "v 0 0 0\n", "v 0 0 zero\n", "v 0 0 0\nf 1 2 3\n"])
def test_an_obj_that_is_none_ends_in_one_line(content, capsys, tmp_path):
    (tmp_path / "bad.obj").write_text(content)
    assert "bad.obj" in one_line(
        ["city", "--import", str(tmp_path / "bad.obj"), "--out", str(tmp_path)], capsys
    )


def test_flying_through_a_city_with_the_policy_that_knows_it(tmp_path, capsys):
    main([*FLY, "--city", "suburban", *SMALL, "--out", str(tmp_path)])
    assert (tmp_path / "tracks.png").stat().st_size > 10_000
    assert not (tmp_path / "flight.gif").exists()
    about = json.loads((tmp_path / "run.json").read_text())
    assert about["policy"] == "planner"
    assert about["options"]["city"] == "suburban"
    assert "drone_2" in capsys.readouterr().out


@pytest.mark.parametrize("city", ["0.2,400,10", "(0.2,400,10)", "[0.2,400,10]"])
def test_flying_through_a_city_of_three_numbers(tmp_path, city):
    main([*FLY, "--city", city, *SMALL, "--policy", "straight", "--out", str(tmp_path)])
    assert json.loads((tmp_path / "run.json").read_text())["options"]["city"] == [0.2, 400, 10]


def test_flying_through_a_city_of_a_file(tmp_path):
    make(tmp_path / "city", "--kind", "suburban", "--side", "250")
    path = str(tmp_path / "city" / "city.obj")
    main(
        [
            *FLY,
            "--city",
            path,
            "--set",
            "leg=100",
            "--policy",
            "straight",
            "--out",
            str(tmp_path / "out"),
        ]
    )
    assert json.loads((tmp_path / "out" / "run.json").read_text())["options"]["city"] == path


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--city", "suburb"], "unknown kind of city 'suburb': did you mean 'suburban'"),
        (["--city", "nowhere.obj"], "nowhere.obj"),
        (["--city", "nowhere.geojson"], "nowhere.geojson"),
        (["--city", "0.2,400"], "city is (0.2, 400): a list or tuple of 3 values is needed"),
        (["--city", "2,400,10"], "alpha is 2"),
        (["--city", "urban,dense,urban"], "alpha is 'urban'"),
        (["--city", "urban", "--set", "city=dense"], "city is given twice"),
        (["--city", "urban", "--set", "num_layouts=0"], "num_layouts is 0"),
        (["--city", "urban", "--set", "area=10"], "area is 10 m"),
    ],
)
def test_bad_cities_to_fly_in_end_in_one_line(words, message, capsys, tmp_path):
    assert message in one_line([*FLY, *words, "--out", str(tmp_path / "out")], capsys)
    assert not (tmp_path / "out").exists()


def test_a_city_for_a_task_without_one_ends_in_one_line(capsys, tmp_path):
    said = one_line(
        ["fly", "hover", "--city", "urban", "--animation", "none", "--out", str(tmp_path / "out")],
        capsys,
    )
    assert "city" in said
