"""Meshes, volumes and pictures of scenes: damaged and hostile ones are refused, and end no process but a trial's."""

from __future__ import annotations

import json
import os
import re
import struct
import subprocess
import sys
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest

from data_tools.synthetic.cornell import random_scene
from metapp.extensions.scene_files import places as module
from metapp.extensions.scene_files.places import Places, read_text
from metapp.extensions.scene_files.reading import read_scene, read_task
from metapp.rendering.scenes.loading import load_scene
from tests.marked import long
from tests.needs_mitsuba import needs_mitsuba
from tests.scene_files import CORNERS, FACES, NAN, OBJ, ORDERS, ply, serialized, volume

pytestmark = needs_mitsuba

ROOT = Path(__file__).parents[3]
PAST = ((0, 1, 2), (0, 2, 400_000))
LIGHT = {"type": "area", "radiance": {"type": "rgb", "value": [1, 1, 1]}}

BOTH = ("ascii", "binary_little_endian")
REFUSED = "no scene that Mitsuba can load: |the process died"
MESHES: dict[str, tuple[bytes, str]] = {
    **{f"{order}.ply": (ply(order, faces=PAST), "the process died|a face at vertex 400,000") for order in ORDERS},
    **{f"{order}-one.ply": (ply(order, faces=((0, 1, 4),)), "a face at vertex 4, expected 0 to 3") for order in ORDERS},
    **{f"{order}-none.ply": (ply(order, corners=(), faces=FACES), REFUSED) for order in BOTH},
    **{f"{order}-few.ply": (ply(order, vertex=5), "could not parse|read 14 out of 26 bytes") for order in BOTH},
    **{f"{order}-many.ply": (ply(order, face=2**31 - 1), "not parse|read 26 out of") for order in BOTH},
    "no.ply": (b"\x89PNG", REFUSED),
    "past.serialized": (serialized(faces=PAST), "the process died|a face at vertex 400,000"),
    "cut.serialized": (serialized()[:30], "less data than expected"),
    "many.serialized": (serialized(vertex=2**31), REFUSED),
    "bomb.serialized": (serialized(face=10_000_000), REFUSED),
    "nan.serialized": (serialized(corners=(NAN, *CORNERS)), "'more.vertex_positions' holds NaN or infinite values"),
    "empty.obj": (b"", REFUSED),
    "past.obj": ((OBJ + "f 1 2 9\n").encode(), "reference to invalid vertex 9"),
    "texture.obj": ((OBJ + "f 1/7 2/7 3/7\n").encode(), "reference to invalid texture coordinate 7"),
    "empty.sdfgrid": (volume((0, 0, 0)), "a grid of 0 x 0 x 0, 1 channels"),
    "large.sdfgrid": (volume((1290, 1290, 1290)), "48 bytes, expected 1 or more along each axis and 8,586,756,048"),
    "thin.sdfgrid": (volume((1, 2, 2), values=np.ones(4)), REFUSED),
    "nan.sdfgrid": (volume((2, 2, 2), values=[np.nan] * 8), "'more.grid' holds NaN or infinite values"),
    "short.sdfgrid": (b"VOL\3", "a grid of 0 x 0 x 0"),
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


def with_shape(path: Path, shape: dict[str, Any]) -> Path:
    """A box and a shape in it."""
    path.write_text(json.dumps({**random_scene(0), "more": shape}))
    return path


def write_scene(folder: Path, name: str, content: bytes, **more: Any) -> Path:
    """A box and a shape by this file; the file's suffix is its plugin."""
    (folder / name).write_bytes(content)
    shape = {"type": name.rpartition(".")[2], "filename": name, **more}
    return with_shape(folder / f"{name}.json", shape)


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
    (tmp_path / "a.ply").write_bytes(ply("ascii", faces=((0, 1, 4),)))
    for kind in ("shapegroup", "merge"):
        path = with_shape(tmp_path / f"{kind}.json", {"type": kind, "a": {"type": "ply", "filename": "a.ply"}})
        with pytest.raises(ValueError, match=r"the mesh 'more.*' has a face at vertex 4, expected 0 to 3"):
            read_task(path, samples=8, held=8)


GOOD = {
    **{f"{order}.ply": ply(order) for order in ORDERS},
    "v4.serialized": serialized(),
    "double.serialized": serialized(flags=0x2000),
    "quad.obj": OBJ.replace("f 1 2 3\nf 1 3 4\n", "\tf 1 2 3 4").encode(),
    "grid.sdfgrid": volume((2, 2, 2), values=[-1, 1] * 4),
}  # fmt: skip


@pytest.mark.parametrize("name", GOOD)
def test_files_that_mitsuba_reads_are_let_through(name: str, tmp_path: Path) -> None:
    mitsuba_scene = load_scene(read_scene(write_scene(tmp_path, name, GOOD[name]))).scene
    faces = [shape.face_count() for shape in mitsuba_scene.shapes() if shape.is_mesh()]
    assert len(mitsuba_scene.shapes()) == len(load_scene(random_scene(0)).scene.shapes()) + 1
    if not name.endswith("sdfgrid"):
        assert 2 in faces


def test_the_mesh_that_is_named_is_checked(tmp_path: Path) -> None:
    first = serialized()[:-12]
    table = np.array([0, len(first)], "<u8").tobytes() + (2).to_bytes(4, "little")
    both = first + serialized(faces=((0, 1, 4),))[:-12] + table
    assert read_task(write_scene(tmp_path, "a.serialized", both), samples=8, held=8)
    for index, line in ((1, r"a face at vertex 4, expected 0 to 3"), (2, REFUSED), (-1, r"a 'shape_index' of -1")):
        with pytest.raises(ValueError, match=line):
            read_task(write_scene(tmp_path, "a.serialized", both, shape_index=index), samples=8, held=8)


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
    path = with_shape(tmp_path / "room.json", shape)
    with pytest.raises(ValueError, match=r"'more.*\.data' holds NaN or infinite values|lies in|that Mitsuba") as caught:
        read_task(path, samples=8, held=8)
    assert str(caught.value).startswith(f"{path}: ")
    picture(tmp_path / "sky.exr", 2.0)
    assert read_task(path, samples=8, held=8)


def png(width: int, height: int) -> bytes:
    """The beginning of a gray PNG of this size."""
    chunks = ((b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)), (b"IDAT", zlib.compress(bytes(100))))
    parts = (struct.pack(">I", len(b)) + a + b + struct.pack(">I", zlib.crc32(a + b)) for a, b in chunks)
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


@pytest.mark.parametrize(
    ("name", "content", "line"),
    [
        ("a.vol", volume((0, 0, 0)), "a grid of 0 x 0 x 0"),
        ("a.vol", volume((2, 2, 2), 2**31 - 1), "2147483647 channels"),
        ("a.vol", volume((-1, -2, 2)), "a grid of -1 x -2 x 2"),
        ("a.vol", volume((1000, 1000, 1000), 6), "48 bytes, expected 1 or more along each axis and 24,000,000,048"),
        ("a.png", png(20_000, 20_000), "20000x20000 px.*268,435,456 px or fewer"),
        ("a.png", png(12_000, 12_000), "12000x12000 px.*bytes"),
    ],
)
def test_textures_fit_their_files_and_the_rule_of_photographs(
    name: str, content: bytes, line: str, tmp_path: Path
) -> None:
    texture: dict[str, Any] = {"type": "bitmap", "filename": name}
    if name == "a.vol":
        texture = {"type": "volume", "volume": {"type": "gridvolume", "filename": name}}
    (tmp_path / name).write_bytes(content)
    shape = {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": texture}}
    path = with_shape(tmp_path / "room.json", shape)
    with pytest.raises(ValueError, match=rf"^{path}: names the file '{name}', .*{line}"):
        read_scene(path)
    if name == "a.vol":
        (tmp_path / name).write_bytes(volume((2, 2, 2), 3, values=np.ones(24)))
        assert load_scene(read_scene(path)).scene


# Files of scenes, at the limits of their names and sizes


def refused(message: str, call: Callable[..., Any], *words: Any) -> None:
    with pytest.raises(ValueError, match=message):
        call(*words)


def test_files_are_as_long_as_is_allowed_and_no_longer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for limit in ("TEXT_BYTES", "_DATA_BYTES"):
        monkeypatch.setattr(module, limit, 10)
    file, places = tmp_path / "x.xml", Places((tmp_path,), (tmp_path,))
    for content, text in ((b"", ""), (b"x" * 10, "x" * 10), (b"\xef\xbb\xbfab", "ab")):  # without a byte order mark
        file.write_bytes(content)
        assert read_text(file) == text
        assert places.file("x.xml") == file
    file.write_bytes(b"x" * 11)
    refused("more than 10 bytes", read_text, file)
    refused("of 11 bytes, expected 10 at most", places.file, "x.xml")
    file.write_bytes(b"\xff")
    refused("not text in UTF-8", read_text, file)
    refused("No such file", read_text, tmp_path / "none")
    refused("no regular file", read_text, tmp_path)
