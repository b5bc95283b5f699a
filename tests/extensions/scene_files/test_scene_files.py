"""Meshes, volumes and pictures of scenes: damaged and hostile ones are refused before Mitsuba reads them."""

from __future__ import annotations

import json
import os
import re
import struct
import subprocess
import sys
import time
import tracemalloc
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest

from data_tools.synthetic.cornell import random_scene
from metapp.extensions.scene_files import places
from metapp.extensions.scene_files.files import check_file
from metapp.extensions.scene_files.reading import read_scene, read_task
from metapp.rendering.scenes.loading import load_scene
from tests.marked import long
from tests.needs_mitsuba import needs_mitsuba
from tests.scene_files import CORNERS, FACES, NAN, OBJ, ORDERS, ply, serialized, volume

pytestmark = needs_mitsuba

ROOT = Path(__file__).parents[3]
PAST = ((0, 1, 2), (0, 2, 400_000))
LIGHT = {"type": "area", "radiance": {"type": "rgb", "value": [1, 1, 1]}}

MESHES: dict[str, tuple[bytes, str]] = {
    **{f"{order}.ply": (ply(order, faces=PAST), "a face at vertex 400,000, expected 0 to 3") for order in ORDERS},
    **{f"{order}-one.ply": (ply(order, faces=((0, 1, 4),)), "a face at vertex 4, expected 0 to 3") for order in ORDERS},
    **{f"{order}-below.ply": (ply(order, faces=((0, 1, -1),)), "a face at vertex -1") for order in ORDERS},
    **{f"{order}-none.ply": (ply(order, corners=(), faces=FACES), "no vertices or no faces") for order in ORDERS},
    **{f"{order}-quad.ply": (ply(order, faces=((0, 1, 2, 3),)), "triang") for order in ORDERS},
    **{f"{order}-few.ply": (ply(order, vertex=5), "expected") for order in ORDERS},
    **{f"{order}-many.ply": (ply(order, face=2**31 - 1), "expected") for order in ORDERS},
    **{f"{order}-huge.ply": (ply(order, vertex=2**32 + 4), "a line 'element vertex 4294967300'") for order in ORDERS},
    **{f"{order}-nan.ply": (ply(order, corners=(NAN, *CORNERS)), "numbers|a coordinate nan") for order in ORDERS},
    "large.ply": (ply("ascii", corners=((1e39, 0, 0), *CORNERS)), "a coordinate 1e.39 of a vertex"),
    "float.ply": (ply("binary_little_endian", faces=((0, 1, np.nan),), index="float"), "a list 'vertex_indices'"),
    "fraction.ply": (ply("ascii", faces=((0, 1, "2.9"),)), "a fraction in a column of integers"),
    "joined.ply": (ply("ascii", faces=((0, "1-2"),), face=1), "words that are no numbers|rows of 'face'"),
    "no.ply": (b"\x89PNG", "no end_header"),
    "only.ply": (b"end_header\n", "begins with 'end_header'"),
    "past.serialized": (serialized(faces=PAST), "a face at vertex 400,000"),
    "old.serialized": (serialized(faces=PAST, version=3), "a face at vertex 400,000"),
    "double.serialized": (serialized(faces=PAST, flags=0x2000), "a face at vertex 400,000"),
    "cut.serialized": (serialized()[:30], "ends before its last triangle"),
    "short.serialized": (b"\x1c", "begins with 0x1c"),
    "many.serialized": (serialized(vertex=2**31), "2,147,483,648 vertices and 2 triangles in"),
    "huge.serialized": (serialized(vertex=2**32 + 4), "4,294,967,300 vertices"),
    "bomb.serialized": (serialized(face=10_000_000), "10,000,000 triangles in"),
    "nan.serialized": (serialized(corners=(NAN, *CORNERS)), "a coordinate nan"),
    "none.obj": (b"v 0 0 0\n", "no faces, expected a mesh"),
    "empty.obj": (b"", "no faces, expected a mesh"),
    "past.obj": ((OBJ + "f 1 2 9\n").encode(), "reference to invalid vertex 9"),
    "below.obj": ((OBJ + "f -1 -2 -3\n").encode(), "reference to invalid vertex"),
    "texture.obj": ((OBJ + "f 1/7 2/7 3/7\n").encode(), "reference to invalid texture coordinate 7"),
    "empty.sdfgrid": (volume((0, 0, 0)), "a grid of 0 x 0 x 0 and 1 channels"),
    "channels.sdfgrid": (volume((2, 2, 2), 2**31 - 1), "and 2147483647 channels"),
    "large.sdfgrid": (volume((1290, 1290, 1290)), "48 bytes, expected 8,586,756,048 by its header"),
    "kind.sdfgrid": (volume((2, 2, 2), kind=2, values=np.ones(8)), "encoding 2, expected VOL, 3 and 1"),
    "thin.sdfgrid": (volume((1, 2, 2), values=np.ones(4)), "expected 2 or more along each axis"),
    "nan.sdfgrid": (volume((2, 2, 2), values=[np.nan] * 8), "NaN or infinite values"),
    "short.sdfgrid": (b"VOL\3", "4 bytes, expected a header of 48"),
}  # fmt: skip

READS = """
import sys, pathlib
from metapp.extensions.scene_files.reading import read_task
for name in sys.argv[1:]:
    try:
        read_task(pathlib.Path(name), samples=8, held=8)
        print(f"{name}\\tread", flush=True)
    except ValueError as error:
        print(f"{name}\\t{error}", flush=True)
"""


def write_scene(folder: Path, name: str, content: bytes, **more: Any) -> Path:
    """A box and a shape by this file; the file's suffix is its plugin."""
    (folder / name).write_bytes(content)
    shape = {"type": name.rpartition(".")[2], "filename": name, **more}
    path = folder / f"{name}.json"
    path.write_text(json.dumps({**random_scene(0), "more": shape}))
    return path


def refusals(paths: list[Path]) -> dict[str, str]:
    """What reading them said, in a process that may die; "" of those after its death."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", READS, *map(str, paths)], env=environment, capture_output=True, text=True, check=False
    )
    lines = dict(line.split("\t", 1) for line in done.stdout.splitlines())
    return {path.name: lines.get(str(path), f"died with {done.returncode}") for path in paths}


@pytest.mark.parametrize("light", [long(False), long(True)])
def test_damaged_files_are_refused_in_one_line(light: bool, tmp_path: Path) -> None:
    more = {"emitter": LIGHT} if light else {}
    paths = [write_scene(tmp_path, name, content, **more) for name, (content, _) in MESHES.items()]
    begin = time.perf_counter()
    found = refusals(paths)
    assert time.perf_counter() - begin < 60
    wrong = {
        name: found[f"{name}.json"] for name, (_, line) in MESHES.items() if not re.search(line, found[f"{name}.json"])
    }
    assert wrong == {}
    for path in paths:
        said = found[path.name].removeprefix(f"{path}: ")
        assert said != found[path.name]
        assert len(said) <= 300


def test_shapes_within_shapes_are_checked_too(tmp_path: Path) -> None:
    inside = {"type": "ply", "filename": "a.ply"}
    (tmp_path / "a.ply").write_bytes(ply("ascii", faces=PAST))
    for kind, shape in {
        "shapegroup": {"type": "shapegroup", "a": inside},
        "merge": {"type": "merge", "a": inside},
        "instance": {"type": "instance", "group": {"type": "shapegroup", "a": inside}},
    }.items():
        path = tmp_path / f"{kind}.json"
        path.write_text(json.dumps({**random_scene(0), "more": shape}))
        with pytest.raises(ValueError, match=r"names the file 'a\.ply'.* a face at vertex 400,000"):
            read_scene(path)
    path = tmp_path / "group.xml"
    shape = '<shape type="ply"><string name="filename" value="a.ply"/></shape>'
    path.write_text(f'<scene version="3.0.0"><shape type="shapegroup">{shape}</shape></scene>')
    with pytest.raises(ValueError, match=r"names the file 'a\.ply'.* a face at vertex 400,000"):
        read_scene(path)


@pytest.mark.parametrize(
    ("grid", "channels", "line"),
    [
        ((0, 0, 0), 1, "a grid of 0 x 0 x 0"),
        ((2, 2, 2), 2**31 - 1, "2147483647 channels, expected 1 or more along each axis and 1 or 3 or 6 channels"),
        ((-1, -2, 2), 1, "a grid of -1 x -2 x 2"),
        ((1000, 1000, 1000), 6, "48 bytes, expected 24,000,000,048"),
    ],
)
def test_volumes_of_textures_fit_their_files(
    grid: tuple[int, int, int], channels: int, line: str, tmp_path: Path
) -> None:
    (tmp_path / "a.vol").write_bytes(volume(grid, channels))
    texture = {"type": "volume", "volume": {"type": "gridvolume", "filename": "a.vol"}}
    path = tmp_path / "room.json"
    shape = {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": texture}}
    path.write_text(json.dumps({**random_scene(0), "more": shape}))
    with pytest.raises(ValueError, match=line) as caught:
        read_scene(path)
    assert str(caught.value).startswith(f"{path}: names the file 'a.vol'")
    (tmp_path / "a.vol").write_bytes(volume((2, 2, 2), 3, values=np.ones(24)))
    assert load_scene(read_scene(path)).scene


GOOD = {
    **{f"{order}.ply": ply(order) for order in ORDERS},
    **{f"{order}-crlf.ply": ply(order, end="\r\n") for order in ORDERS},
    **{f"{order}-comment.ply": ply(order, header="comment made by \N{SNOWMAN} hand") for order in ORDERS},
    **{f"{order}-{kind}.ply": ply(order, index=kind) for order in ORDERS for kind in ("uchar", "short", "uint")},
    **{f"{order}-double.ply": ply(order, kind="double") for order in ORDERS},
    "blank.ply": ply("ascii", tail=b"\n \n"),
    "v4.serialized": serialized(),
    "v3.serialized": serialized(version=3),
    "double.serialized": serialized(flags=0x2000),
    "two.serialized": serialized(meshes=2),
    "plain.obj": OBJ.encode(),
    "quad.obj": OBJ.replace("f 1 2 3\nf 1 3 4\n", "\tf 1 2 3 4").encode(),
    "grid.sdfgrid": volume((2, 2, 2), values=[-1, 1] * 4),
}  # fmt: skip


@pytest.mark.parametrize("name", GOOD)
def test_files_that_mitsuba_reads_are_let_through(name: str, tmp_path: Path) -> None:
    more = {"shape_index": 1} if name.startswith("two") else {}
    mitsuba_scene = load_scene(read_scene(write_scene(tmp_path, name, GOOD[name], **more))).scene
    faces = [shape.face_count() for shape in mitsuba_scene.shapes() if shape.is_mesh()]
    assert len(mitsuba_scene.shapes()) == len(load_scene(random_scene(0)).scene.shapes()) + 1
    if not name.endswith("sdfgrid"):
        assert 2 in faces


def test_the_mesh_that_is_named_is_checked(tmp_path: Path) -> None:
    both = serialized() + serialized(faces=PAST)
    first = serialized(meshes=1)[:-12]
    table = np.array([0, len(first)], "<u8").tobytes() + (2).to_bytes(4, "little")
    both = first + serialized(faces=PAST)[:-12] + table
    assert read_scene(write_scene(tmp_path, "a.serialized", both))
    with pytest.raises(ValueError, match=r"a face at vertex 400,000"):
        read_scene(write_scene(tmp_path, "a.serialized", both, shape_index=1))
    with pytest.raises(ValueError, match=r"a shape_index of 2 in a file of 2 meshes"):
        read_scene(write_scene(tmp_path, "a.serialized", both, shape_index=2))
    with pytest.raises(ValueError, match=r"a 'shape_index' of -1"):
        read_scene(write_scene(tmp_path, "a.serialized", both, shape_index=-1))


def test_extra_columns_and_tables_are_let_through(tmp_path: Path) -> None:
    head = (
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
        "property uchar red\nproperty uchar green\nproperty uchar blue\nelement edge 1\nproperty int vertex1\n"
        "property int vertex2\nelement face 2\nproperty list int int vertex_index\nend_header\n"
    )
    rows = [f"{x} {y} {z} 255 0 7" for x, y, z in CORNERS] + ["0 1", "3 0 1 2", "3 0 2 3", ""]
    path = write_scene(tmp_path, "a.ply", (head + "\n".join(rows)).encode())
    assert load_scene(read_scene(path)).scene


@pytest.mark.parametrize("order", ["ascii", "binary_little_endian"])
def test_large_meshes_are_checked_to_their_end_in_flat_memory(order: str, tmp_path: Path) -> None:
    count = 200_000
    faces = np.random.default_rng(0).integers(0, 4, (count, 3))
    faces[-1, 2] = 4
    head = ply(order, faces=(), face=count)
    kind = np.dtype([("count", "u1"), ("face", "<i4", 3)])
    table = np.zeros(count, kind)
    table["count"], table["face"] = 3, faces
    text = "".join(f"3 {a} {b} {c}\n" for a, b, c in faces.tolist()).encode()
    path = tmp_path / "a.ply"
    path.write_bytes(head + (text if order == "ascii" else table.tobytes()))
    tracemalloc.start()
    with pytest.raises(ValueError, match=r"a face at vertex 4, expected 0 to 3"):
        check_file("ply", path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 80e6


def test_a_file_is_checked_again_when_it_changes(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    path.write_bytes(ply("ascii"))
    check_file("ply", path)
    path.write_bytes(ply("ascii", faces=PAST))
    with pytest.raises(ValueError, match="a face at vertex"):
        check_file("ply", path)


def test_what_no_check_knows_kills_a_child_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_scene(tmp_path, "a.ply", ply("ascii", faces=PAST))
    monkeypatch.setattr(places, "check_file", lambda *_: None)
    with pytest.raises(ValueError, match=r"the process died \(SIG\w+\) while Mitsuba loads it") as caught:
        read_task(path, samples=8, held=8)
    assert str(caught.value).startswith(f"{path}: ")


def picture(path: Path, value: float) -> None:
    """A map of light, 16 x 8 px, with one texel of this value."""
    values = np.full((8, 16, 3), 0.5, np.float32)
    values[3, 4, 1] = value
    target = oiio.ImageOutput.create(str(path))
    assert target.open(str(path), oiio.ImageSpec(16, 8, 3, "float"))
    target.write_image(values)
    target.close()


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("kind", ["envmap", "bitmap"])
def test_a_map_with_a_texel_that_is_no_number_is_named(kind: str, value: float, tmp_path: Path) -> None:
    picture(tmp_path / "sky.exr", value)
    shape: dict[str, Any] = {"type": kind, "filename": "sky.exr"}
    if kind == "bitmap":
        shape = {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": shape}}
    path = tmp_path / "room.json"
    path.write_text(json.dumps({**random_scene(0), "more": shape}))
    with pytest.raises(ValueError, match=r"names the file 'sky\.exr', .*: 1 values are NaN or infinite") as caught:
        read_scene(path)
    assert str(caught.value).startswith(f"{path}: ")
    picture(tmp_path / "sky.exr", 2.0)
    assert read_scene(path)


def png(width: int, height: int) -> bytes:
    """The beginning of a gray PNG of this size."""
    chunks = ((b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)), (b"IDAT", zlib.compress(bytes(100))))
    parts = (struct.pack(">I", len(b)) + a + b + struct.pack(">I", zlib.crc32(a + b)) for a, b in chunks)
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


@pytest.mark.parametrize(("size", "said"), [((20_000, 20_000), "268,435,456 px or fewer"), ((12_000, 12_000), "bytes")])
def test_pictures_of_scenes_go_by_the_rule_of_photographs(size: tuple[int, int], said: str, tmp_path: Path) -> None:
    (tmp_path / "wall.png").write_bytes(png(*size))
    wall = {"type": "diffuse", "reflectance": {"type": "bitmap", "filename": "wall.png"}}
    path = tmp_path / "room.json"
    path.write_text(json.dumps({**random_scene(0), "more": {"type": "sphere", "bsdf": wall}}))
    with pytest.raises(ValueError, match=rf"names the file 'wall\.png', .*: {size[0]}x{size[1]} px.*{said}"):
        read_scene(path)
