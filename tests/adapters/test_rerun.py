"""Files of recorded flights for Rerun: read again, they give the same numbers."""

import numpy as np
import pytest
from exported import DRONES, PARTS, ROWS, TETRAHEDRON, made_flight

from bulletuav.report.figures import drone_colours

pytest.importorskip("rerun", reason="needs the extra rerun, which is large")

from rerun.chunk import RrdReader

from bulletuav.adapters.rerun import write_rrd

FLIGHT = made_flight()
NANOSECONDS = [0, 20833333, 41666667, 62500000, 83333333, 104166667, 125000000, 145833333]
"""Times of k/48 s"""


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("rerun") / "flight.rrd"
    write_rrd(FLIGHT, drone_colours(DRONES), path)
    return path


@pytest.fixture(scope="module")
def columns(path):
    """Columns of each entity by name: lists of rows, each a list of what is in it."""
    found = {}
    for chunk in RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        own = found.setdefault(chunk.entity_path, {})
        for name in batch.schema.names:
            if name == "time":
                own[f"{name} static={chunk.is_static}"] = batch[name].cast("int64").to_pylist()
            elif name != "rerun.controls.RowId":
                own[name] = batch[name].to_pylist()
    return found


def one_each(column):
    """What rows of one value hold."""
    assert all(len(row) == 1 for row in column)
    return np.array([row[0] for row in column])


def test_motions_come_back_in_single_precision(columns):
    for i, rows in enumerate(ROWS):
        own = columns[f"/world/drones/{i}"]
        place = one_each(own["Transform3D:translation"])
        turn = one_each(own["Transform3D:quaternion"])
        np.testing.assert_array_equal(place, np.float32(FLIGHT["position"][:rows, i]))
        np.testing.assert_array_equal(turn, np.float32(FLIGHT["quaternion"][:rows, i]))
        assert own["time static=False"] == NANOSECONDS[:rows]


def test_curves_come_back_to_the_bit(columns):
    curves = {"altitude": FLIGHT["position"][..., 2]}
    curves |= {name: FLIGHT[name] for name in ("reward", "separation", "info/reward/progress")}
    for name, values in curves.items():
        own = columns[f"/{name}"]
        told = np.array(own["Scalars:scalars"])
        assert own["time static=False"] == NANOSECONDS[-len(values) :]
        assert own["SeriesLines:names"] == [["drone_0", "drone_1", "drone_2"]]
        assert len(set(own["SeriesLines:colors"][0])) == DRONES
        for i, rows in enumerate(ROWS):
            flown = rows - (len(NANOSECONDS) - len(values))
            assert told[:flown, i].tobytes() == values[:flown, i].astype(float).tobytes()
            assert np.isnan(told[flown:, i]).all()


def test_names_of_infos_may_be_odd(columns):
    assert r"/info/odd\ name" in columns
    assert "/info/odd_name" in columns
    assert "/info/several" not in columns


def test_paths_and_goals_are_there(columns):
    strips = columns["/world/paths"]["LineStrips3D:strips"][0]
    for i, rows in enumerate(ROWS):
        np.testing.assert_array_equal(strips[i], np.float32(FLIGHT["position"][:rows, i]))
    goals = np.array(columns["/world/goals"]["Points3D:positions"])
    np.testing.assert_array_equal(goals, np.float32(FLIGHT["goal"]))


def test_drones_obstacles_and_cities_have_shapes(columns):
    half = np.float32([0.3, 0.2, 0.1])
    ball, tube, box = (columns[f"/world/drones/2/{k}"] for k in range(len(PARTS)))
    np.testing.assert_array_equal(ball["Ellipsoids3D:half_sizes"], [[half]])
    assert (tube["Cylinders3D:lengths"], tube["Cylinders3D:radii"]) == (
        [[np.float32(0.2)]],
        [[half[0]]],
    )
    np.testing.assert_array_equal(box["Boxes3D:half_sizes"], [[half]])
    assert box["Boxes3D:colors"] == [[0xFF8000FF]]
    np.testing.assert_array_equal(tube["Transform3D:translation"], np.float32([[[0.1, 0, 0]]]))
    obstacle = columns["/world/obstacles/0/shape"]["Mesh3D:vertex_positions"][0]
    assert sorted(map(list, obstacle)) == sorted(TETRAHEDRON)
    corners = np.array(columns["/world/city"]["Mesh3D:vertex_positions"][0])
    assert len(corners) == 8 + 4
    np.testing.assert_array_equal(corners[:8].max(axis=0), [2, 3, 4])
    np.testing.assert_array_equal(corners[8:].min(axis=0), [5, 5, 0])
    moved = one_each(columns["/world/obstacles/0"]["Transform3D:translation"])
    np.testing.assert_array_equal(moved, np.float32(FLIGHT["obstacle"][:, 0]))


def test_the_file_tells_how_to_show_it(path):
    reader = RrdReader(path)
    (recording,), (blueprint,) = reader.recordings(), reader.blueprints()
    assert recording.application_id == blueprint.application_id == "bulletuav"
    views = {chunk.entity_path for chunk in reader.stream(store=blueprint).to_chunks()}
    assert sum(name.startswith("/view/") and name.count("/") == 2 for name in views) == 4


def test_where_rerun_is_off_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.setenv("RERUN", "off")
    with pytest.raises(RuntimeError, match="variable RERUN: unset it"):
        write_rrd(FLIGHT, drone_colours(DRONES), tmp_path / "flight.rrd")
    assert not list(tmp_path.iterdir())
