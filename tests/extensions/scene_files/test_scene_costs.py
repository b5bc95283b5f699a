"""Files of scenes that are small and become large in memory, and files of spectra: refused by their headers."""

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest

from metapp.extensions.scene_files.data_files import data_file_bytes
from metapp.extensions.scene_files.scene_places import ScenePlaces
from metapp.rendering.scenes.rules import SceneChecker
from tests.needs_mitsuba import needs_mitsuba
from tests.scene_files import OBJ, PLY_FORMATS, ply_file, serialized_file, volume_file

pytestmark = needs_mitsuba

MEBIBYTE = 2**20


def check(folder: Path, *parts: dict[str, Any]) -> None:
    places = ScenePlaces((folder,), (folder,))
    SceneChecker(places).check_object({"type": "scene", **{f"part{i}": part for i, part in enumerate(parts)}})


def packed_zeros(flags: int, vertices: int, faces: int) -> bytes:
    """A file of `serialized` of zeros, whole up to 64 MiB."""
    content = struct.pack("<I", flags) + b"lamp\0" + struct.pack("<QQ", vertices, faces)
    deflate = zlib.compressobj(1)
    body = b"".join(deflate.compress(part) for part in (content, *(bytes(MEBIBYTE) for _ in range(64))))
    return struct.pack("<HH", 0x041C, 4) + body + deflate.flush()


def test_compressed_meshes_are_bounded_by_what_they_state(tmp_path: Path) -> None:
    bomb = packed_zeros(0x1000, 10**8, 1)
    padding = bytes(2 * MEBIBYTE)  # so that the file could hold what it states
    several = serialized_file()[:-12]
    for content, index in (
        (bomb + padding + struct.pack("<QI", 0, 1), 0),
        (several + bomb + padding + struct.pack("<QQI", 0, len(several), 2), 1),
    ):
        (tmp_path / "a.serialized").write_bytes(content)
        shape = {"type": "serialized", "filename": "a.serialized", "shape_index": index}
        with pytest.raises(ValueError, match=r"'a.serialized', with which all files .* take 4,4\d+,.* expected 3,221,"):
            check(tmp_path, shape)
        if index:
            check(tmp_path, {**shape, "shape_index": 0})


def test_counts_beyond_the_file_are_refused(tmp_path: Path) -> None:
    files = {f"{form}.ply": ply_file(form, vertex=10**9) for form in PLY_FORMATS}
    files |= {f"{form}-faces.ply": ply_file(form, face=10**9) for form in PLY_FORMATS}
    files |= {"a.serialized": serialized_file(face=10**9), "b.serialized": serialized_file(vertex=2**63)}
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(ValueError, match=r"vertices and .* faces, expected [\d,]+ at most in a file of its size"):
            check(tmp_path, {"type": name.rpartition(".")[2], "filename": name})


def test_whole_files_are_measured(tmp_path: Path) -> None:
    files = {"a.obj": OBJ.encode(), "a.serialized": serialized_file(), "a.vol": volume_file((2, 2, 2), values=[1] * 8)}
    files |= {f"{form}.ply": ply_file(form) for form in PLY_FORMATS}
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
        kind = name.rpartition(".")[2].replace("vol", "gridvolume")
        assert 32 <= data_file_bytes(kind, tmp_path / name) <= 2_000
        check(tmp_path, {"type": kind, "filename": name})


def write_picture(path: Path, width: int, height: int) -> None:
    """Write a black picture, line by line."""
    spec = oiio.ImageSpec(width, height, 3, "half" if path.suffix in (".exr", ".hdr") else "uint8")
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec)
    output.write_image(np.zeros((height, width, 3), np.uint8))
    assert output.close()


@pytest.mark.parametrize("suffix", ["png", "jpg", "exr", "hdr", "tga", "bmp"])
def test_pictures_are_measured_by_their_headers(suffix: str, tmp_path: Path) -> None:
    write_picture(tmp_path / f"a.{suffix}", 64, 32)
    assert data_file_bytes("bitmap", tmp_path / f"a.{suffix}") == 64 * 32 * 16
    assert data_file_bytes("envmap", tmp_path / f"a.{suffix}") == 64 * 32 * 64


def test_all_pictures_of_a_scene_are_counted(tmp_path: Path) -> None:
    write_picture(tmp_path / "a.png", 4096, 2048)  # 128 MiB as a texture, 512 MiB as an environment map
    texture, sky = ({"type": kind, "filename": "a.png"} for kind in ("bitmap", "envmap"))
    wood = {"type": "twosided", "below": {"type": "normalmap", "map": texture}}
    check(tmp_path, *[wood] * 24)
    check(tmp_path, sky, *[wood] * 20)
    for parts in ([wood] * 25, [sky, *[wood] * 21]):
        with pytest.raises(ValueError, match=r"'a.png', with which all files .* take 3,[\d,]+ bytes, expected"):
            check(tmp_path, *parts)


BAD_SPECTRA = {
    "400 0.1\n500 nan\n": "line 2: a value of nan",
    "400 0.1\n-1 inf\n": "line 2: a wavelength of -1",
    "400 0.1\n500 inf\n": "line 2: a value of inf",
    "400 0.1\n": "a spectrum of 1 rows, expected two or more",
    "# nothing\n": "a spectrum of 0 rows, expected two or more",
    "# head\n\n500 0.1\n400 0.2\n": "line 4: a wavelength of 400 nm after 500",
    "400 0.1\n400 0.2\n": "line 2: a wavelength of 400 nm after 400",
    "400 0.1\n500 -0.1\n": "line 2: a value of -0.1",
    "400 0.1\n500 red\n": "line 2: '500 red', expected a wavelength and a value",
    "400,0.1\n500,0.1\n": "line 1: '400,0.1', expected a wavelength and a value",
    "400 0.1\n500 0.1 0.2\n": "line 2: '500 0.1 0.2', expected a wavelength and a value",
    "# \n" * 2**19: "more than 1,048,576 bytes",
}


@pytest.mark.parametrize("content", BAD_SPECTRA)
def test_files_of_spectra_are_refused_by_line(content: str, tmp_path: Path) -> None:
    (tmp_path / "a.spd").write_text(content)
    spectrum = {"type": "spectrum", "filename": "a.spd"}
    with pytest.raises(ValueError, match=f"names the file 'a.spd', which Mitsuba cannot take: {BAD_SPECTRA[content]}"):
        check(tmp_path, {"type": "diffuse", "reflectance": spectrum})


def test_ordinary_files_of_spectra_are_allowed(tmp_path: Path) -> None:
    for content in ("400 0.1\n500 0", "# 1/m\n400\t0.1\r\n\r\n  500 1e3\r\n"):
        (tmp_path / "a.spd").write_bytes(content.encode())
        check(tmp_path, {"type": "diffuse", "reflectance": {"type": "spectrum", "filename": "a.spd"}})
