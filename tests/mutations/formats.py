"""Every file format that is read: how to make a small sound file of it, how it is damaged, and what
reads it."""

import gzip
import importlib
import io
import json
import shutil
import sqlite3
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import h5py
import layout_formats as layouts
import map_formats as maps
import network_formats as networks
import numpy as np
import plan_formats as plans
import point_formats as points
import shapely
import structured
import track_formats as tracks
from mutants import BYTES, HDF5, JSON, SAFETENSORS, TEXT, Mutation

from models.training.packed import PackedFrames
from models.training.packing import pack, recording
from placement_env.candidates.poles import load_keep_out, load_poles
from placement_env.candidates.sensor_catalogue import load_sensor_catalogue
from placement_env.fidelity.detector import IOUS
from placement_env.fidelity.hit_model import SURROGATE_FOLDER
from placement_env.fidelity.table import Table, TableOrigin, save_table
from placement_env.search.result import Result
from toolkit.bodies.meshes import MeshEntry, take_mesh, take_meshes
from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.recording_file import Header, Scene, encode
from toolkit.datasets.recording_views import Reads
from toolkit.detection.comparison import Comparison
from toolkit.detection.evaluation import evaluate_recording
from toolkit.detection.schemes import PAPER_SCHEMES as SCHEMES
from toolkit.detection.survey import survey
from toolkit.doctor.stored_file import diagnose_file
from toolkit.frame import Frame
from toolkit.geometry import look, pose
from toolkit.objects import Detections, Objects
from toolkit.runtime.array_files import write_arrays
from toolkit.runtime.cache import Cache, make_key
from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import load_site, save_site
from toolkit.sites.georeference import inverse_project
from toolkit.sites.maps.piece import MapPiece
from toolkit.sites.osm.buildings import make_buildings
from toolkit.sites.osm.map_reader import read_map
from toolkit.sites.osm.netconvert_input import write_osm
from toolkit.sites.osm.paved_areas import find_walks
from toolkit.sites.osm.road_notes import describe_roadless
from toolkit.sites.osm.road_rules import format_types, name_types
from toolkit.sites.osm.roads import find_roads
from toolkit.sites.osm.street_objects import make_barriers, make_furniture, make_trees
from toolkit.sites.osm.traffic_side import choose_side
from toolkit.sites.site import Site, Solid


@dataclass(frozen=True)
class Format:
    """make: writes a sound file; read: all that a command does with it until it computes; share: of
    the mutants, 1 for an ordinary one; owns: whether reading may put the file aside or write into
    it; structured: damage that knows it."""

    make: Callable[[Path], object]
    read: Callable[[Path], object]
    mutations: tuple[Mutation, ...] = BYTES
    share: float = 1.0
    owns: bool = False
    structured: tuple[Mutation, ...] = ()


def calls(name: str) -> Callable[[Path], object]:
    module, _, function = name.partition(":")
    return lambda path: getattr(importlib.import_module(module), function)(path)


def formats() -> dict[str, Format]:
    """Every format by the name of its sound file."""
    return {name: replace(kind, structured=known_damage(name)) for name, kind in _formats().items()}


def known_damage(name: str) -> tuple[Mutation, ...]:
    """Mutations that know the format of a file; none where there are none."""
    if name in layouts.FILES:
        _, name, general = layouts.FILES[name]
        if general is JSON:
            return structured.STRUCTURED_JSON
    for endings, mutations in (
        ((".pcd.bin", ".bin"), (structured.bin_change,)),
        ((".onnx.json",), structured.STRUCTURED_CARD),
        ((".safetensors",), (structured.header_change,)),
        ((".hdf5", ".packed"), structured.STRUCTURED_HDF5),
        ((".geojson",), structured.STRUCTURED_GEOJSON),
        ((".json", ".gltf"), structured.STRUCTURED_JSON),
        ((".yaml",), structured.STRUCTURED_YAML),
        ((".osm.gz",), (structured.osm_gz_change,)),
        ((".xodr",), (*maps.OPENDRIVE, *structured.STRUCTURED_XML)),
        ((".osm",), structured.STRUCTURED_OSM),
        ((".toml",), structured.STRUCTURED_TOML),
        (("y.ply",), (structured.ply_change,)),
        (("t.ply",), (structured.ply_change, structured.text_change)),
        (("text.pcd",), (structured.pcd_change, structured.text_change)),
        ((".pcd",), (structured.pcd_change,)),
        ((".npz",), (structured.npz_change,)),
        ((".npy",), (structured.npy_change,)),
        ((".feather",), (structured.feather_change,)),
        ((".glb",), (structured.glb_change,)),
        ((".stl",), (structured.stl_change,)),
        ((".xyz", ".csv", ".txt", ".obj", ".off"), structured.STRUCTURED_TEXT),
    ):
        if name.endswith(endings):
            return mutations
    return ()


def _formats() -> dict[str, Format]:
    read_weights = networks.read_weights
    clouds = {
        "binary.ply": points.ply,
        "text.ply": points.ply_text,
        "binary.pcd": points.pcd("binary"),
        "text.pcd": points.pcd("ascii"),
        "compressed.pcd": points.pcd("binary_compressed"),
        "open3d.pcd": points.open3d_pcd,
        "cloud.npz": points.open3d_pcd,
        "cloud.las": points.las,
        "cloud.laz": points.las,
        "cloud.xyz": points.xyz,
        "cloud.csv": points.csv,
        "cloud.npy": points.npy,
        "kitti.bin": points.bin,
        "sweep.feather": points.feather,
    }
    poses = {"poses.json": points.poses_json, "poses.txt": points.poses_text}
    meshes = dict.fromkeys(
        ("mesh.obj", "mesh.ply", "mesh.stl", "mesh.off", "mesh.glb"), points.mesh
    )
    texts = (".xyz", ".csv", "text.ply", "text.pcd", ".txt", ".obj", ".off")
    return {
        "plan.json": Format(plans.make_plan, plans.read_plan, JSON),
        "live.json": Format(plans.make_project, plans.read_project, JSON, 0.5),
        "plan-site.json": Format(plans.make_plan_site, plans.read_plan_site, JSON, 0.5),
        "result.json": Format(plans.make_result, Result.load, JSON, 0.5),
        **{
            name: Format(plans.make_picture, read, BYTES, 0.3)
            for name, read in (
                ("picture.png", plans.read_picture),
                ("picture.jpg", plans.read_picture),
                ("logo.png", plans.read_logo),
            )
        },
        "recording.hdf5": Format(_recording, _read_recording, HDF5, 4),
        "published.hdf5": Format(_published, _read_recording, HDF5, 3),
        "frames.packed": Format(_packed, _read_packed, HDF5, 3),
        "network.safetensors": Format(networks.weights, read_weights, SAFETENSORS, 2),
        "classes.safetensors": Format(networks.class_weights, read_weights, SAFETENSORS, 2),
        "card.onnx.json": Format(networks.card, networks.read_card, JSON, 2),
        "published.pth": Format(
            networks.published_checkpoint, networks.read_published_checkpoint, BYTES, 0.5
        ),
        "checkpoint.pt": Format(networks.checkpoint, networks.read_checkpoint, BYTES, 1),
        **{
            name: Format(
                make, points.read_cloud, TEXT if name.endswith(texts) else (*BYTES, *TEXT[-2:])
            )
            for name, make in clouds.items()
        },
        **{
            name: Format(make, points.read_poses, JSON if name.endswith("json") else TEXT)
            for name, make in poses.items()
        },
        "site.json": Format(_site, calls("toolkit.sites.files:load_site"), JSON, 2),
        "poles.geojson": Format(_poles, _read_poles, JSON, 2),
        "map.osm": Format(_osm, _read_osm, TEXT, 2),
        "map.osm.gz": Format(_osm_packed, _read_osm),
        "map.json": Format(_overpass, _read_osm, JSON),
        "sensors.toml": Format(_catalogue, _read_catalogue, TEXT),
        "meshes.toml": Format(_mesh_catalogue, _read_mesh_catalogue, TEXT),
        "map.xodr": Format(maps.make_opendrive, maps.read_whole_map, TEXT),
        "table.npz": Format(
            _table,
            calls("placement_env.fidelity.table:load_table"),
            (*BYTES, _another_table, _another_table),
            1,
        ),
        "surrogate.json": Format(
            _surrogate, calls("placement_env.fidelity.hit_model:load_models"), JSON
        ),
        "answers.sqlite": Format(_cache, _read_cache, BYTES, 1, owns=True),
        **{
            name: Format(make, _read_mesh, TEXT if name.endswith(texts) else BYTES, 0.7)
            for name, make in meshes.items()
        },
        "mesh.gltf": Format(points.text_mesh, _read_mesh, JSON, 0.7),
        **{name: Format(*file) for name, file in tracks.FILES.items()},
        **{
            name: Format(layouts.maker(name), layouts.reader(name), mutations, 0.4)
            for name, (_, _, mutations) in layouts.FILES.items()
        },
    }


def _frames(shared: bool) -> tuple[Any, list[Any]]:
    """A site and three frames of two cameras and a lidar, or of two cameras alone, over two cars
    and a truck."""
    camera = DepthCamera(width=40, height=30, stride=2)
    sensors: tuple[Sensor, ...] = (
        Sensor("north", camera, look((-14.0, 0.0, 5.0), 0.0, 0.4)),
        Sensor("south", camera, look((14.0, 3.0, 6.0), 3.1, 0.5)),
    )
    if not shared:
        sensors += (
            Sensor("lidar", SpinningLidar(channels=8, azimuth_step=0.2), pose(0.0, -14.0, 4.0)),
        )
    wall = Solid(np.array([[15.0, -5], [16, -5], [16, 5], [15, 5]]), 0.0, 3.0, "wall")
    site = Site("yard", np.array([-12.8, -12.8, 12.8, 12.8]), solids=(wall,), sensors=sensors)
    rng = np.random.default_rng(4)
    frames = []
    for k in range(3):
        boxes = np.array(
            [
                [k, 0, 0.8, 4.4, 1.8, 1.6, 0.3],
                [-6, 5, 0.8, 4, 1.8, 1.6, -1],
                [5, -6, 1.5, 9, 2.5, 3, 2.0],
            ]
        )
        measured = tuple(
            rng.uniform(4, 16, sensor.model.shape).astype(np.float32) for sensor in sensors
        )
        frames.append(Frame(sensors, measured, Objects(boxes, np.array([0, 0, 3])), 0.5 * k, k))
    return site, frames


def _recording(path: Path) -> None:
    site, frames = _frames(shared=False)
    scenes = [Scene(frame, np.zeros(len(frame.objects), np.int64)) for frame in frames]
    path.write_bytes(encode(Header(site, frames[0].sensors, ("car",)), scenes))


def _published(path: Path) -> None:
    """In the published layout alone, at a built-in site."""
    _, frames = _frames(shared=True)
    scenes = [Scene(frame, np.zeros(len(frame.objects), np.int64)) for frame in frames]
    path.write_bytes(encode(Header(load_site("tjunction"), frames[0].sensors), scenes))
    with h5py.File(path, "r+") as file:
        del file["coview"]
        for group in file["cameras"].values():
            for name in list(group.attrs):
                del group.attrs[name]


def _read_recording(path: Path) -> None:
    """As `doctor`, `survey` and `evaluate` read it."""
    for finding in diagnose_file(path):
        one_line(str(finding))
    with CoopDataset(path) as dataset:
        list(dataset)
        if len(dataset):
            survey(dataset)
            evaluate_recording(
                dataset,
                lambda points: Detections.empty(),
                Comparison(schemes=("early",)),
                reads=Reads(frames=2),
            )


def _packed(path: Path) -> None:
    site, frames = _frames(shared=False)
    empty = [np.zeros(sensor.model.shape, np.float32) + 17 for sensor in frames[0].sensors]
    pack([recording(frames, site.area, 4.0, empty=empty)], path)


def _read_packed(path: Path) -> None:
    packed = PackedFrames(path)
    for k in range(len(packed)):
        packed.points(k, np.random.default_rng(0))
        packed.objects(k)


def _site(path: Path) -> None:
    save_site(_frames(shared=False)[0], path)


def _poles(path: Path) -> None:
    def feature(shape: str, coordinates: Any, **properties: Any) -> Any:
        return {
            "type": "Feature",
            "properties": properties,
            "geometry": {"type": shape, "coordinates": coordinates},
        }

    features = [
        *(
            feature(
                "Point", [x, 3.0], name=f"p{x}", height=6, price_factor=1.5, capacity_kbit=900.0
            )
            for x in range(4)
        ),
        feature("Polygon", [[[9, 9], [12, 9], [12, 12], [9, 9]]], keep_out=True),
        feature("MultiPolygon", [[[[19, 9], [22, 9], [22, 12], [19, 9]]]], kind="keep_out"),
    ]
    path.write_text(
        json.dumps({"type": "FeatureCollection", "coview_site": 1, "features": features})
    )


def _read_poles(path: Path) -> None:
    site = _frames(shared=True)[0]
    load_poles(path, site)
    load_keep_out(path, site)


def _osm(path: Path) -> None:
    places = [
        (-90, 0),
        (0, 0),
        (90, 0),
        (0, -90),
        (5, 90),
        (20, 20),
        (40, 20),
        (40, 40),
        (20, 40),
        (12, 9),
        (-9, 12),
    ]
    degrees = inverse_project(np.array(places, float), (13.4, 52.5))
    nodes = [
        f'<node id="{i}" lat="{lat:.7f}" lon="{lon:.7f}"/>'
        for i, (lon, lat) in enumerate(degrees.tolist(), 1)
    ]
    nodes[9] = nodes[9].replace(
        "/>", '><tag k="highway" v="street_lamp"/><tag k="height" v="7 m"/></node>'
    )
    nodes[10] = nodes[10].replace("/>", '><tag k="natural" v="tree"/></node>')
    ways = [
        ((1, 2, 3), {"highway": "secondary", "lanes": "2", "maxspeed": "50", "layer": "0"}),
        ((4, 2, 5), {"highway": "residential", "width": "6"}),
        ((6, 7, 8, 9, 6), {"building": "yes", "building:levels": "3", "height": "12 m"}),
        ((7, 8), {"barrier": "wall", "height": "2"}),
    ]
    for i, (corners, tags) in enumerate(ways, 100):
        inside = "".join(f'<nd ref="{k}"/>' for k in corners)
        inside += "".join(f'<tag k="{key}" v="{value}"/>' for key, value in tags.items())
        nodes.append(f'<way id="{i}">{inside}</way>')
    relation = (
        '<relation id="300"><member type="way" ref="102" role="outer"/><tag k="type" '
        'v="multipolygon"/></relation>'
    )
    path.write_text(
        "\n".join(['<?xml version="1.0"?>', '<osm version="0.6">', *nodes, relation, "</osm>", ""])
    )


def _osm_packed(path: Path) -> None:
    _osm(path)
    path.write_bytes(gzip.compress(path.read_bytes(), mtime=0))


def _overpass(path: Path) -> None:
    """The same map as Overpass gives it in JSON."""
    _osm(path)
    elements = []
    for element in ElementTree.fromstring(path.read_text()):
        row: dict[str, object] = {"type": element.tag, "id": int(element.get("id", "0"))}
        row |= {
            key: float(element.get(key, "0")) for key in ("lat", "lon") if key in element.attrib
        }
        nodes = [int(nd.get("ref", "0")) for nd in element.iter("nd")]
        row |= {"nodes": nodes} if nodes else {}
        members = [
            {**member.attrib, "ref": int(member.get("ref", "0"))}
            for member in element.iter("member")
        ]
        row |= {"members": members} if members else {}
        elements.append(
            {**row, "tags": {str(tag.get("k")): tag.get("v") for tag in element.iter("tag")}}
        )
    path.write_text(json.dumps({"version": 0.6, "generator": "Overpass API", "elements": elements}))


def _catalogue(path: Path) -> None:
    path.write_text(
        'currency = "EUR"\npole_price = 4000\n[[sensor]]\nname = "camera"\nmodel = "DepthCamera"\nprice = 1500\n'
        'fov_deg = 90\nwidth = 320\nheight = 240\n[[sensor]]\nname = "lidar"\nmodel = "SpinningLidar"\n'
        "price = 6000\nchannels = 64\nazimuth_step_deg = 0.2\nmax_range = 100\n"
    )


def _read_catalogue(path: Path) -> None:
    """Read it, and cast the rays of its models as a search does first."""
    for each in load_sensor_catalogue(path).models:
        assert each.model.rays().ndim == 3


def _mesh_catalogue(path: Path) -> None:
    path.write_text(
        '[[mesh]]\nfile = "box.stl"\nlabel = "vehicle"\nup = "z"\nforward = "x"\nscale = 1.0\n'
    )


def _read_mesh(path: Path) -> None:
    take_mesh(path, Path(path.name), MeshEntry())


def _read_mesh_catalogue(path: Path) -> None:
    with tempfile.TemporaryDirectory() as folder:
        points.mesh(Path(folder, "box.stl"))
        (shutil.copy if path.is_file() and not path.is_symlink() else shutil.move)(
            path, Path(folder, "meshes.toml")
        )
        take_meshes(folder)


def _read_osm(path: Path) -> None:
    """Run all of `import_osm` but SUMO's netconvert, which sees only what is written anew."""
    MapPiece(path, centre=(13.4, 52.5), size=(60, 60))
    town, window = read_map(path, (13.4, 52.5), 0.3), shapely.box(-60, -60, 60, 60)
    lefthand, _ = choose_side(town, window, None)
    pieces, _ = find_roads(town, window, lefthand=lefthand)
    write_osm(pieces, town)
    format_types(name_types(piece.rules for piece in pieces if piece.rules is not None))
    describe_roadless(town, window)
    find_walks(town, window)
    street = shapely.box(-60, -4, 60, 4)
    make_buildings(town, window, street)
    make_barriers(town, window, street)
    make_trees(town, window, street)
    make_furniture(town, window, street)


def _table(path: Path) -> None:
    ap = np.linspace(0, 1, 8 * len(SCHEMES) * len(IOUS)).reshape(8, len(SCHEMES), len(IOUS))
    origin = TableOrigin("yard", ("a", "b", "c"), "p", 3, 9, "r", "d", 0, "c")
    save_table(Table(origin, ap, ap.copy(), ap[..., 0].copy()), path)


def _another_table(content: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    """Sound arrays that make no table."""
    with np.load(io.BytesIO(content)) as file:
        arrays = {name: file[name] for name in file}
    name = sorted(arrays)[int(rng.integers(len(arrays)))]
    if name == "origin":
        what, text = JSON[-1](arrays[name].tobytes(), rng)
        arrays[name] = np.frombuffer(text, np.uint8)
    else:
        what = str(rng.choice(["gone", "text", "nan", "short", "whole"]))
        changed = {"text": np.array(["a"]), "nan": arrays[name] * np.nan, "short": arrays[name][1:]}
        arrays[name] = changed.get(what, arrays[name].astype(int))
        if what == "gone":
            del arrays[name]
    with tempfile.TemporaryDirectory() as folder:
        write_arrays(Path(folder, "table.npz"), arrays)
        return f"{name} is {what}", Path(folder, "table.npz").read_bytes()


def _surrogate(path: Path) -> None:
    path.write_text(json.dumps(json.loads((SURROGATE_FOLDER / "general.json").read_text())[:2]))


def _cache(path: Path) -> None:
    cache = Cache(path)
    cache.put({make_key(k): (np.arange(20.0 * k),) for k in range(20)})
    cache.close()
    with sqlite3.connect(path) as database:
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")


def _read_cache(path: Path) -> None:
    cache = Cache(path)
    for k, value in enumerate(cache.get([make_key(k) for k in range(20)])):
        if value is not None and not np.array_equal(value[0], np.arange(20.0 * k)):
            raise RuntimeError("the cache answers with a figure that was never put in")
    cache.put({make_key("more"): (np.arange(3),)})
    cache.close()


def one_line(message: str) -> None:
    """RuntimeError where a message to the user is empty or of several lines."""
    if not message.strip() or len(message.strip().splitlines()) > 1:
        raise RuntimeError(f"no message in one line: {message!r:.200}")


warnings.simplefilter("ignore")
