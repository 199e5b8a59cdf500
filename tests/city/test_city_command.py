import argparse
import json

import pytest
from city.meshes import ELL, prism, written
from matplotlib.image import imread

from bulletuav.city.imports import from_obj
from bulletuav.commands import city
from bulletuav.commands.parsers.city import add_arguments


def run(*words):
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    city.run(parser.parse_args(list(words)))


def test_a_generated_city(tmp_path, capsys):
    out = tmp_path / "dense"
    run("--kind", "dense", "--seed", "3", "--irregularity", "0.5", "--out", str(out))
    told = json.loads((out / "statistics.json").read_text())
    assert (told["name"], told["side_m"]) == ("dense", 500)
    assert told["statistics"]["built-up share"] == {"realised": pytest.approx(0.5), "target": 0.5}
    assert told["statistics"]["greatest height, m"]["target"] is None
    assert len(from_obj(out / "city.obj", side=500).heights) == told["buildings"]
    assert imread(out / "map.png").shape[0] > 800
    printed = capsys.readouterr().out
    for word in ("city dense", "buildings per km2", "KS test", "map.png", "statistics.json"):
        assert word in printed


def test_terrain(tmp_path, capsys):
    words = ["--kind", "wooded_hills", "--side", "120", "--relief", "10", "--tree-density", "50"]
    run(*words, "--out", str(tmp_path))
    written = json.loads((tmp_path / "statistics.json").read_text())
    assert (written["name"], written["side_m"], written["trees"]) == ("own", 120, 72)
    assert written["statistics"]["relief, m"] == {"realised": pytest.approx(10), "target": None}
    assert written["statistics"]["trees per hectare"]["realised"] == pytest.approx(50)
    assert (tmp_path / "city.obj").read_text().count("\no ") == 144 + 8 * 8
    assert imread(tmp_path / "map.png").shape[0] > 800
    assert "steepest slope" in capsys.readouterr().out
    for words, message in (
        (["--kind", "hills", "--alpha", "0.3"], "--alpha has no meaning for terrain such as hills"),
        (["--relief", "3"], "--relief has no meaning for a generated city"),
        (["--kind", "forest", "--wavelength", "50"], "wavelength has no effect in terrain"),
    ):
        with pytest.raises(ValueError, match=message):
            run(*words, "--out", str(tmp_path))


def test_an_imported_city_and_one_number_of_ones_own(tmp_path, capsys):
    run("--gamma", "40", "--side", "200", "--out", str(tmp_path))
    told = json.loads((tmp_path / "statistics.json").read_text())
    assert told["name"] == "own"
    assert told["statistics"]["Rayleigh scale of heights, m"]["target"] == 40
    assert told["statistics"]["built-up share"]["target"] == 0.3
    run("--import", str(tmp_path / "city.obj"), "--scale", "2", "--out", str(tmp_path / "again"))
    again = json.loads((tmp_path / "again" / "statistics.json").read_text())
    high = "greatest height, m"
    assert again["statistics"][high]["realised"] == pytest.approx(
        2 * told["statistics"][high]["realised"]
    )
    assert "KS test" not in capsys.readouterr().out.rpartition("statistic ")[2]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--kind", "urbane"], "unknown kind of city 'urbane': did you mean 'urban'"),
        (["--metres"], "--metres has no meaning for a generated city"),
        (
            ["--import", "a.obj", "--default-height", "3"],
            "--default-height has no meaning for an import of a.obj",
        ),
        (
            ["--import", "a.geojson", "--kind", "urban"],
            "--kind has no meaning for an import of a.geojson",
        ),
        (["--import", "a.stl"], "unknown kind of file 'a.stl' with ending '.stl'"),
        (["--seed", "-1"], "seed is -1: a whole number"),
    ],
)
def test_words_without_a_meaning(tmp_path, words, message):
    with pytest.raises(ValueError, match=message):
        run(*words, "--out", str(tmp_path))


def test_what_an_import_mended_is_told(tmp_path, capsys):
    ring = [[0, 0], [30, 0], [30, 10], [10, 10], [10, 30], [0, 30], [0, 0]]
    features = [
        {"type": "Feature", "properties": {"height": height}, "geometry": geometry}
        for height, geometry in (
            ("40 ft", {"type": "Polygon", "coordinates": [ring]}),
            (3, {"type": "Point", "coordinates": [5, 5]}),
        )
    ]
    path = tmp_path / "town.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    words = ["--import", str(path), "--metres", "--side", "80"]
    run(*words, "--out", str(tmp_path / "out"))
    told = json.loads((tmp_path / "out" / "statistics.json").read_text())["import"]
    assert told["counts"] == {"skipped": 1, "unit": 1}
    assert told["notes"][0]["where"] == "feature 1 (from 0)"
    assert told["splits"] == []
    printed = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "changes on import of town.geojson" in printed
    assert "feature 1 (from 0)" in printed
    with pytest.raises(ValueError, match=r"feature 1 \(from 0\): it is a Point"):
        run(*words, "--strict", "--out", str(tmp_path / "out"))


def test_split_meshes_are_told(tmp_path, capsys):
    path = tmp_path / "town.obj"
    path.write_text(written(("house", prism(ELL, 12)[0] + [0, 0, 400], prism(ELL, 12)[1])))
    run("--import", str(path), "--side", "100", "--out", str(tmp_path / "out"))
    told = json.loads((tmp_path / "out" / "statistics.json").read_text())
    assert told["import"]["counts"] == {"moved": 1}
    assert told["import"]["splits"][0]["pieces"] == 2
    assert told["statistics"]["greatest height, m"]["realised"] == pytest.approx(12)
    assert "at most 0.00%" in capsys.readouterr().out
    run("--import", str(path), "--elevation", "keep", "--out", str(tmp_path / "out"))
    told = json.loads((tmp_path / "out" / "statistics.json").read_text())
    assert told["statistics"]["greatest height, m"]["realised"] == pytest.approx(412)
