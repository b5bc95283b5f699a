"""Meshes and volumes of scenes, mutated: files of bytes, text and packed streams beside a scene that names them."""

from __future__ import annotations

import json
import random
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from tests.scene_files import CORNERS, FACES, OBJ, ORDERS, ply, serialized, volume
from torture.mutate import mutate_bytes
from torture.seeds import SCENE, Files

SCENE_FILE = "box.json"
_PACKED = 4  # bytes before the packed stream of .serialized


def _scene(name: str, kind: str, **more: Any) -> bytes:
    from data_tools.synthetic.cornell import random_scene

    shape: dict[str, Any] = {"type": kind, "filename": name, **more}
    if kind == "gridvolume":
        texture = {"type": "volume", "volume": shape}
        shape = {"type": "sphere", "radius": 0.2, "bsdf": {"type": "diffuse", "reflectance": texture}}
    return json.dumps({**random_scene(0), "more": shape}).encode()


def _ball() -> tuple[list[tuple[float, ...]], list[tuple[int, int, int]]]:
    """Corners and faces of a ball of 8 x 6 places."""
    angles = [(2 * np.pi * i / 8, np.pi * (j + 0.5) / 6) for j in range(6) for i in range(8)]
    corners = [(np.cos(a) * np.sin(b) / 4, np.cos(b) / 4, np.sin(a) * np.sin(b) / 4) for a, b in angles]
    quads = [(j * 8 + i, j * 8 + (i + 1) % 8, j * 8 + 8 + i) for j in range(5) for i in range(8)]
    return [tuple(float(f"{x:.4f}") for x in corner) for corner in corners], quads


def meshes() -> list[Files]:
    """A square and a ball in each format, alone and as lights."""
    light = {"emitter": {"type": "area"}}
    ball, faces = _ball()
    files = {f"{order}.ply": ply(order) for order in ORDERS}
    files |= {f"{order}-ball.ply": ply(order, corners=ball, faces=faces, index="uchar") for order in ORDERS}
    files |= {
        "a.obj": (OBJ + "vt 0 0\nvn 0 0 1\nf 1/1/1 2/1/1 3/1/1\nf 1//1 2//1 3//1 4//1\n").encode(),
        "a.serialized": serialized(meshes=2),
        "ball.serialized": serialized(corners=ball, faces=faces, flags=0x2000),
        "old.serialized": serialized(version=3, corners=CORNERS, faces=FACES),
    }
    sets = []
    for name, content in files.items():
        kind = name.rpartition(".")[2]
        sets += [{SCENE_FILE: _scene(name, kind, **more), name: content} for more in ({}, light)]
    return sets


def volumes() -> list[Files]:
    """A grid of signed distances, and grids of one and three channels."""
    rng = np.random.default_rng(0)
    grid = rng.random((3, 4, 5)) - 0.5
    return [
        {SCENE_FILE: _scene("a.vol", "sdfgrid"), "a.vol": volume((5, 4, 3), values=grid)},
        {SCENE_FILE: _scene("a.vol", "gridvolume"), "a.vol": volume((5, 4, 3), values=grid)},
        {SCENE_FILE: _scene("a.vol", "gridvolume"), "a.vol": volume((2, 2, 2), 3, values=rng.random(24))},
    ]


def old_scenes() -> list[Files]:
    """Scenes of version 0.6, whose parameters have names in camel case, with a mesh."""
    old = SCENE.replace('version="3.0.0"', 'version="0.6.0"')
    for new, before in {"max_depth": "maxDepth", "to_world": "toWorld", "sample_count": "sampleCount"}.items():
        old = old.replace(f'"{new}"', f'"{before}"')
    mesh = '<shape type="ply"><string name="filename" value="a.ply"/><boolean name="faceNormals" value="true"/></shape>'
    sampler = old.replace('type="independent"', 'type="ldsampler"')
    return [{"box.xml": text.encode()} for text in (old, sampler)] + [
        {"box.xml": old.replace("</scene>", f"{mesh}</scene>").encode(), "a.ply": ply("ascii")}
    ]


def write(rng: random.Random, folder: Path, valid: list[Files]) -> Path:
    """A scene and its file, the latter mutated; half of the packed streams unpacked before and packed after."""
    files = rng.choice(valid)
    name = next(name for name in files if name != SCENE_FILE)
    others = [content for other in valid for key, content in other.items() if key != SCENE_FILE]
    content = files[name]
    if name.endswith(".serialized") and rng.random() < 0.7:
        stream = zlib.decompressobj()
        unpacked = stream.decompress(content[_PACKED:])
        packed = zlib.compress(mutate_bytes(rng, unpacked, [unpacked]), 1)
        content = content[:_PACKED] + packed + stream.unused_data
    else:
        content = mutate_bytes(rng, content, others)
    (folder / SCENE_FILE).write_bytes(files[SCENE_FILE])
    (folder / name).write_bytes(content)
    return folder / SCENE_FILE
