"""The formats: how a small valid file of each is made, and what reads it."""

import json
import pickle
import shutil
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import yaml
from safetensors.numpy import save_file

import bulletuav
from bulletuav.adapters.parquet import read_about, read_table, write_table
from bulletuav.analysis.recording import fly_episode, load, outcomes, save
from bulletuav.analysis.results_folder import ResultsFolder
from bulletuav.analysis.seals import add_seal, hash_files
from bulletuav.bridges.airsim_settings import read_airsim_settings
from bulletuav.city.imports import from_geojson, from_obj
from bulletuav.engine.drones import require_loadable
from bulletuav.envs.snapshot import Snapshot, checksum_of
from bulletuav.geometry.mesh_file import read_obj
from bulletuav.identification.checks import check_log
from bulletuav.identification.logs import read_log
from bulletuav.policies import find_policy
from bulletuav.policies.run import RunConfig
from bulletuav.policies.trained import Trained
from bulletuav.report.film import Film
from bulletuav.report.replay import read_run, write_replay
from bulletuav.report.results import merge
from bulletuav.report.verification import Verifier
from bulletuav.tasks.parts.tracks import (
    RandomTrack,
    find_track_error,
    load_track,
    place_start_blocks,
)
from bulletuav.training.store import Store
from bulletuav.training.study import Study

OPTIONS: dict[str, Any] = {"dynamics": "single_integrator", "num_drones": 2, "horizon": 3}
LEARNED = RunConfig(
    "hover",
    steps=32,
    options={**OPTIONS, "action": "velocity"},
    model={"policy_kwargs": {"net_arch": [4]}},
)
BOX = """# two houses
o house
v 0 0 0
v 20 0 0
v 20 10 0
v 0 10 0
v 0 0 8
v 20 0 8
v 20 10 8
v 0 10 8
f 4 3 2 1
f 5/1/2 6 7 8
f 1 2 6 5
f 2 3 7 6
f 3 4 8 7
f 4 1 5 8
o ramp
v 40 0 0
v 50 0 0
v 40 9 0
v 40 0 5
f -4 -3 -2
f -4 -3 -1
f -3 -2 -1
"""


class Format(NamedTuple):
    """A format.

    Attributes:
        file: Name of the file that is damaged.
        kind: How it is structured, for `damage`.
        make: Writes valid files into a folder.
        read: Reads the files of a folder.
        weight: How many cases are drawn for each of others'.
    """

    file: str
    kind: str
    make: Any
    read: Any
    weight: float = 1.0


def _square(x, y, size):
    ring = [[x, y], [x + size, y], [x + size, y + size], [x, y + size], [x, y]]
    return {"type": "Polygon", "coordinates": [ring]}


def make_geojson(folder):
    tags = ({"height": "12 m"}, {"building:levels": 3, "min_height": 2}, {"building:part": "yes"})
    shapes = [_square(20 * k, 0, 12) for k in range(3)]
    shapes[1] = {
        "type": "MultiPolygon",
        "coordinates": [
            [[[50, 50], [90, 50], [90, 90], [70, 60], [50, 90], [50, 50]]],
            [
                [[100, 50], [140, 50], [140, 90], [100, 90], [100, 50]],
                [[110, 60], [120, 60], [120, 70], [110, 70], [110, 60]],
            ],
        ],
    }
    features = [
        {"type": "Feature", "properties": one, "geometry": shape}
        for one, shape in zip(tags, shapes, strict=True)
    ]
    text = json.dumps({"type": "FeatureCollection", "features": features})
    (folder / "town.geojson").write_text(text)


def read_geojson(folder):
    path = folder / "town.geojson"
    from_geojson(path, metres=True)
    from_geojson(path)


def make_overpass(folder):
    ring = [(0, 0), (0.0004, 0), (0.0004, 0.0003), (0, 0.0003)]
    nodes = [{"type": "node", "id": k, "lon": x, "lat": y} for k, (x, y) in enumerate(ring)]
    tags = {"building": "yes", "height": "9 m"}
    ways = [
        {"type": "way", "id": 10, "nodes": [0, 1, 2, 3, 0], "tags": tags},
        {"type": "way", "id": 11, "nodes": [0, 1, 2]},
        {"type": "way", "id": 12, "geometry": [{"lon": x, "lat": y} for x, y in ring[2:]]},
    ]
    ways[2]["geometry"].append({"lon": 0, "lat": 0})
    members = [{"type": "way", "ref": ref, "role": "outer"} for ref in (11, 12)]
    relation = {"type": "relation", "id": 20, "members": members}
    relation["tags"] = {**tags, "type": "multipolygon"}
    text = json.dumps({"version": 0.6, "elements": [*nodes, *ways, relation]})
    (folder / "town.json").write_text(text)


def make_cityjson(folder):
    low = [[x, y, 0] for x, y in ((0, 0), (9000, 0), (9000, 9000), (0, 9000))]
    high = [[x, y, 7000] for x, y, _ in low]
    roof = [[4, 5, 6, 7]]
    solid = {"type": "Solid", "lod": "1.2", "boundaries": [[[[0, 3, 2, 1]], roof]]}
    flat = {"type": "MultiSurface", "lod": "0", "boundaries": [[[0, 1, 2, 3]]]}
    objects = {
        "a": {"type": "Building", "geometry": [solid, flat], "children": ["b"]},
        "b": {"type": "BuildingPart", "geometry": [flat], "parents": ["a"]},
        "c": {"type": "Building", "geometry": [flat], "attributes": {"measuredHeight": 5}},
    }
    transform = {"scale": [0.001, 0.001, 0.001], "translate": [0, 0, 2]}
    content = {"type": "CityJSON", "version": "2.0", "transform": transform}
    text = json.dumps({**content, "CityObjects": objects, "vertices": low + high})
    (folder / "town.json").write_text(text)


def read_json_city(folder):
    from_geojson(folder / "town.json", side=200.0)


def make_urdf(folder):
    shutil.copy(bulletuav.load_airframe("cf2x").urdf, folder / "own.urdf")


def read_urdf(folder):
    require_loadable([bulletuav.load_airframe(folder / "own.urdf")])


def make_hull_urdf(folder):
    text = bulletuav.load_airframe("cf2x").urdf.read_text()
    start = text.index("<geometry>", text.index("<collision>"))
    end = text.index("</geometry>", start)
    mesh = '<geometry><mesh filename="hull.obj" scale="0.004 0.006 0.006"/>'
    (folder / "own.urdf").write_text(text[:start] + mesh + text[end:])
    corners = [(x, y, z) for z in (-4, 4) for x, y in ((-10, -5), (10, -5), (10, 5), (-10, 5))]
    vertices = "".join(f"v {x} {y} {z}\n" for x, y, z in corners)
    (folder / "hull.obj").write_text(vertices + BOX[BOX.index("f 4") : BOX.index("o ramp")])


def make_visual_urdf(folder):
    text = bulletuav.load_airframe("cf2x").urdf.read_text()
    start = text.index("<geometry>", text.index("<visual>"))
    end = text.index("</geometry>", start)
    mesh = '<geometry><mesh filename="body.obj" scale="0.001 0.001 0.001"/>'
    (folder / "own.urdf").write_text(text[:start] + mesh + text[end:])
    (folder / "body.obj").write_text("mtllib no.mtl\nvt 0 1\nvn 0 0 1\n" + BOX)


def read_hull_urdf(folder):
    read_obj(folder / "hull.obj")
    read_urdf(folder)


def make_track(folder):
    gates = "".join(
        f"[[gates]]\nposition = [{x}, {y}, 3]\nyaw = {yaw}\nshape = '{shape}'\nsize = 1.5\n"
        for x, y, yaw, shape in ((0, 0, 0, "square"), (20, 0, 90, "round"), (20, 20, 180, "round"))
    )
    (folder / "own.toml").write_text(gates)


def make_csv_track(folder):
    rows = "x,y,z,yaw,shape,size\n0,0,3,0,square,1.5\n20,0,3,90,round,\n20,0,3,-90,round,\n"
    (folder / "own.csv").write_text(rows)


def make_airsim_settings(folder):
    camera = {"CaptureSettings": [{"ImageType": 0, "Width": 64, "FOV_Degrees": 90}], "X": 0.5}
    sensor = {"SensorType": 6, "PointsPerSecond": 1000, "DataFrame": "SensorLocalFrame"}
    vehicle = {"VehicleType": "SimpleFlight", "X": 4, "Cameras": {"a": camera}}
    values = {
        "ClockSpeed": 1.5,
        "OriginGeopoint": {"Latitude": 47.6, "Longitude": -122.1, "Altitude": 122},
        "Recording": {"RecordInterval": 0.1, "Cameras": [{"CameraName": "0", "ImageType": 0}]},
        "Vehicles": {"Ann": {**vehicle, "Sensors": {"Lidar": sensor}}},
    }
    (folder / "settings.json").write_text(json.dumps(values))


def read_vehicle_settings(folder):
    read_airsim_settings(folder / "settings.json")


def make_json_track(folder):
    gates = [{"name": "a", "position": [0, 0, 3]}, {"position": [20, 0, 3], "heading": 20.0}]
    gates.append({"position": [40, 0, 3], "quaternion": [0, 0, 0.6, 0.8]})
    order = ["a", 1, {"gate": 2, "reverse": True}, {"gate": "a", "reverse": True}]
    (folder / "own.json").write_text(json.dumps({"gates": gates, "order": order}))


def read_csv_track(folder):
    read_track(folder, "own.csv")


def read_json_track(folder):
    read_track(folder, "own.json")


def read_track(folder, name="own.toml"):
    gates = load_track(folder / name, RandomTrack(4, 20.0, (2.0, 4.0), 0.0, "mixed", 1.5))
    try:
        starts = place_start_blocks(gates, 2)
    except ValueError as error:  # of a race, which has a name for its track
        raise ValueError(f"{folder}: {error}") from None
    find_track_error(gates, starts, 0.1, 0.0)


def make_run(folder):
    config = RunConfig(
        "crossing",
        "ppo",
        0,
        64,
        2,
        {**OPTIONS, "observation": ["goal"], "weights": {"conflict": 1.0}, "difficulty": "easy"},
        ({}, {"num_drones": 3}),
        {"up": 0.8, "window": 10},
        model={"learning_rate": [1e-3, 1e-5], "policy_kwargs": {"net_arch": [8, 8]}},
        evaluation={"horizon": 5},
    )
    (folder / "run.yaml").write_text(config.text())


def read_run_yaml(folder):
    RunConfig.read(folder / "run.yaml")


def make_study(folder):
    make_run(folder)
    run = yaml.safe_load((folder / "run.yaml").read_text())
    del run["version"]
    space = {
        "model": {"gamma": {"low": 0.9, "high": 0.99, "log": True}},
        "options.weights.conflict": {"choices": [0.5, 1.0]},
        "worlds": {"low": 1, "high": 8, "step": 1},
    }
    study = {"version": 1, "run": run, "space": space, "metric": "return", "trials": 4, "batch": 2}
    (folder / "study.yaml").write_text(yaml.safe_dump(study, sort_keys=False))


def read_study(folder):
    Study.read(folder / "study.yaml")


def make_recording(folder):
    aviary = bulletuav.Aviary("crossing", 1, **OPTIONS, sensors=["imu"])
    recording = fly_episode(aviary, find_policy("straight", "crossing")(aviary), 1)
    save(recording, aviary, "straight", 1, folder)
    aviary.close()


def seal_again(folder, name="run.json"):
    """Damage that somebody sealed: whoever can write a file can write its seal."""
    try:
        about = json.loads((folder / name).read_text())
        if isinstance(about.get("files"), dict):
            about["files"] = hash_files(folder, about["files"])
        (folder / name).write_text(json.dumps(add_seal(about)))
    except (ValueError, AttributeError, RecursionError, OSError):
        pass


def read_recording(folder):
    outcomes(load(folder))
    seal_again(folder)
    recording, title = read_run(folder)
    write_replay(recording, title, folder / "page.html", str(folder))


def read_film(folder):
    seal_again(folder)
    recording, title = read_run(folder)
    film = Film(recording, title, size=(64, 48), source=str(folder))
    try:
        film.picture(0.0)
    finally:
        film.close()


def read_verified(folder):
    seal_again(folder)
    Verifier().verify(folder)


def make_evaluation(folder):
    bulletuav.evaluate("crossing", "straight", 1, out=folder, **OPTIONS).save(folder)


def read_results(folder):
    about = json.loads((folder / "about").read_text())
    ResultsFolder(folder, about)


def make_results(folder):
    make_evaluation(folder)
    shutil.copy(folder / "run.json", folder / "about")


def read_summary(folder):
    seal_again(folder, "summary.json")
    Verifier().verify(folder)


def make_pieces(folder):
    bulletuav.evaluate("crossing", "straight", 1, out=folder, piece="1/1", **OPTIONS)
    piece = next((folder / "pieces").iterdir())
    for name in ("run.json", "episodes.csv"):
        shutil.move(piece / name, folder / name)
    piece.rmdir()


def read_pieces(folder):
    piece = folder / "pieces" / "1-of-1"
    piece.mkdir(parents=True, exist_ok=True)
    for name in ("run.json", "episodes.csv"):
        shutil.copy(folder / name, piece / name)
        (folder / name).unlink()
    merge(folder)


def make_cases(folder):
    (folder / "pieces").mkdir()
    cases = {"runs": ["a", "b"], "against": "straight"}
    (folder / "cases.json").write_text(json.dumps(cases))


def read_cases(folder):
    (folder / "pieces").mkdir(exist_ok=True)
    shutil.copy(folder / "cases.json", folder / "pieces" / "cases.json")
    merge(folder)


@cache
def flown():
    return bulletuav.Aviary("hover", 1, **OPTIONS, action="velocity")


def make_policy(folder):
    rng = np.random.default_rng(0)
    observed = flown().observer.space().shape[0]
    sizes = {"mlp_extractor.policy_net.0": (4, observed), "action_net": (3, 4)}
    arrays = {"action.low": -np.ones(3, np.float32), "action.high": np.ones(3, np.float32)}
    for name, shape in sizes.items():
        arrays[f"{name}.weight"] = rng.normal(size=shape).astype(np.float32)
        arrays[f"{name}.bias"] = np.zeros(shape[0], np.float32)
    save_file(arrays, folder / "policy.safetensors")


def read_policy(folder):
    policy = Trained(flown(), LEARNED, folder / "policy.safetensors")
    policy.act(flown().reset(seeds=0), flown().swarm)


def make_log(folder):
    names = "t,x,y,z,qx,qy,qz,qw,vx,vy,vz,w1,w2,w3,w4,vbat,current"
    airframe = bulletuav.load_airframe("cf2x")
    speed = airframe.hover_speed()
    rows = [
        f"{k / 100:.2f},{0.01 * np.sin(k / 9):.5f},0.001,{1 + 0.01 * np.cos(k / 7):.5f},0,0,0,1,"
        f"{np.cos(k / 9) / 9:.4f},0,{-np.sin(k / 7) / 7:.4f},"
        + ",".join(f"{speed + k % 5:.1f}" for _ in range(4))
        + f",{4.1 - k / 1000:.3f},1.5"
        for k in range(60)
    ]
    (folder / "log.csv").write_text("\n".join([names, *rows]) + "\n")


def read_flight_log(folder):
    log = read_log(folder / "log.csv", {}, 4)
    check_log(log, bulletuav.load_airframe("cf2x"))


def make_training(folder):
    make_policy(folder)
    (folder / "checkpoints" / "000").mkdir(parents=True)
    shutil.move(folder / "policy.safetensors", folder / "checkpoints" / "000")
    (folder / "run.yaml").write_text("# versions\n" + LEARNED.text())
    row = {"steps": 16, "decisions": 16, "stage": 0, "seconds": 1.0, "return": 0.5}
    state = {"rows": [row], "curriculum": {"stage": 0, "successes": []}}
    (folder / "state.json").write_text(json.dumps(state))
    (folder / "updates.csv").write_text("steps,loss\n8,1.5\n16,\n")


def read_training(folder):
    checkpoint = folder / "checkpoints" / "000"
    checkpoint.mkdir(parents=True, exist_ok=True)
    (checkpoint / "policy.safetensors").touch()
    store = Store(folder, LEARNED)
    assert store.finished in (True, False)


def make_parquet(folder):
    columns = {"episode": np.arange(20, dtype=np.int32), "action": np.ones((20, 3))}
    write_table(columns, [{"episode": 0, "seed": 1}], folder / "table.parquet")


def read_parquet(folder):
    read_about(folder / "table.parquet")
    read_table(folder / "table.parquet")


def make_snapshot(folder):
    aviary = flown()
    aviary.reset(seeds=3)
    snapshot = aviary.save_state()
    (folder / "state.bin").write_bytes(np.ascontiguousarray(snapshot.data).tobytes())
    (folder / "form.pickle").write_bytes(pickle.dumps(snapshot.form))


def read_snapshot(folder):
    aviary = flown()
    aviary.reset(seeds=3)
    content = np.frombuffer((folder / "state.bin").read_bytes(), np.uint8)[None]
    form = pickle.loads((folder / "form.pickle").read_bytes())
    try:
        # As written by hand: the checksum is that of the damaged bytes
        aviary.load_state(Snapshot(content, form, checksum_of(content, form)))
    except ValueError as error:
        raise ValueError(f"{folder}: {error}") from None  # bytes have no name
    for _ in range(2):
        aviary.step(np.zeros((1, 2, 3)))


def make_obj(folder):
    (folder / "town.obj").write_text(BOX)


def read_city(folder):
    from_obj(folder / "town.obj")


FORMATS = {
    "obj": Format("town.obj", "text", make_obj, read_city),
    "geojson": Format("town.geojson", "json", make_geojson, read_geojson, 2),
    "overpass": Format("town.json", "json", make_overpass, read_json_city, 2),
    "cityjson": Format("town.json", "json", make_cityjson, read_json_city, 2),
    "urdf": Format("own.urdf", "text", make_urdf, read_urdf, 2),
    "urdf mesh": Format("hull.obj", "text", make_hull_urdf, read_hull_urdf),
    "visual mesh": Format("body.obj", "text", make_visual_urdf, read_urdf),
    "track": Format("own.toml", "text", make_track, read_track, 2),
    "csv track": Format("own.csv", "text", make_csv_track, read_csv_track),
    "json track": Format("own.json", "json", make_json_track, read_json_track, 2),
    "airsim settings": Format(
        "settings.json", "json", make_airsim_settings, read_vehicle_settings, 2
    ),
    "run.yaml": Format("run.yaml", "yaml", make_run, read_run_yaml, 2),
    "study.yaml": Format("study.yaml", "yaml", make_study, read_study),
    "trajectory.npz": Format("trajectory.npz", "npz", make_recording, read_recording, 2),
    "flight run.json": Format("run.json", "json", make_recording, read_verified, 0.5),
    "film": Format("trajectory.npz", "npz", make_recording, read_film, 0.2),
    "results run.json": Format("run.json", "json", make_results, read_results),
    "episodes.csv": Format("episodes.csv", "text", make_results, read_results),
    "summary.json": Format("summary.json", "json", make_evaluation, read_summary, 0.3),
    "pieces run.json": Format("run.json", "json", make_pieces, read_pieces, 0.3),
    "cases.json": Format("cases.json", "json", make_cases, read_cases),
    "policy.safetensors": Format("policy.safetensors", "safetensors", make_policy, read_policy, 2),
    "log.csv": Format("log.csv", "text", make_log, read_flight_log),
    "state.json": Format("state.json", "json", make_training, read_training),
    "training run.yaml": Format("run.yaml", "yaml", make_training, read_training, 0.5),
    "updates.csv": Format("updates.csv", "text", make_training, read_training),
    "parquet": Format("table.parquet", "parquet", make_parquet, read_parquet),
    "snapshot": Format("state.bin", "bytes", make_snapshot, read_snapshot),
}
