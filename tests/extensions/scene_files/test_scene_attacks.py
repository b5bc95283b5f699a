"""Scene files that are no scenes, or made to run code, read files, end the process or hang it: refused in a line."""

import ctypes
import importlib.util
import json
import os
import re
import shutil
import struct
import subprocess
import sys
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from data_tools.synthetic.cornell import random_scene
from metapp.extensions.scene_files.scene_places import ScenePlaces, read_scene_text
from metapp.extensions.scene_files.scene_reader import read_scene, read_task
from metapp.rendering.paths.path_space import Tracer
from metapp.rendering.scenes.loading import load_scene
from metapp.rendering.variant import load_mitsuba
from tests.needs_mitsuba import needs_mitsuba
from tests.scene_files import CORNERS, NAN_CORNER, OBJ, PLY_FORMATS, ply_file, serialized_file, volume_file

pytestmark = needs_mitsuba

ROOT = Path(__file__).parents[3]
EVIL = '__attribute__((constructor)) static void run(void) { fclose(fopen(MARK, "w")); }'
LAMP = '<emitter type="area"><rgb name="radiance" value="4 4 4"/></emitter>'
CAMERA = """<sensor type="perspective"><float name="fov" value="45"/>
    <transform name="to_world"><lookat origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/></transform></sensor>"""
BALL = f'<shape type="sphere"><float name="radius" value="0.5"/>{LAMP}</shape>'
ITSELF = '<shape type="evil"/>'


def xml(*parts: str, before: str = "", version: str = "3.0.0") -> str:
    return f'{before}<scene version="{version}">{CAMERA}{BALL}{"".join(parts)}</scene>'


def in_json(part: Any, **more: Any) -> str:
    return json.dumps({**random_scene(0), "more": part, **more})


@pytest.fixture
def evil(tmp_path: Path) -> Callable[[Path, str], Path]:
    """Puts a library that leaves a mark when it is loaded into a folder's `plugins`; returns the mark's path."""
    if not shutil.which("gcc"):
        pytest.skip("gcc builds the library: apt-get install gcc libc6-dev")
    source, library, mark = tmp_path / "evil.c", tmp_path / "evil.so", tmp_path / "mark"
    source.write_text(f'#include <stdio.h>\n#define MARK "{mark}"\n{EVIL}\n')
    subprocess.run(["gcc", "-shared", "-fPIC", "-o", library, source], check=True)

    def put(folder: Path, name: str) -> Path:
        (folder / "plugins").mkdir(parents=True, exist_ok=True)
        shutil.copy(library, folder / "plugins" / f"{name}.so")
        return mark

    return put


def test_hostile_library_runs_its_code_when_loaded(tmp_path: Path, evil: Callable[[Path, str], Path]) -> None:
    mark = evil(tmp_path, "evil")
    assert not mark.exists()
    ctypes.CDLL(str(tmp_path / "plugins" / "evil.so"))
    assert mark.exists()


INCLUDED = '<scene version="3.0.0"><shape type="evil"/></scene>'
CODE = {
    "plain.xml": xml(ITSELF),
    "entity.xml": xml('<shape type="&a;"/>', before='<!DOCTYPE scene [<!ENTITY a "evil">]>'),
    "dollar.xml": xml('<default name="f" value="part.txt"/>', '<include filename="$f"/>'),
    "nested.xml": xml('<include filename="below/part.txt"/>'),
    "above.xml": xml('<shape type="../plugins/evil"/>'),
    "case.xml": xml('<Include filename="part.txt"/>'),
    "utf7.xml": xml("+ADw-shape type=+ACI-evil+ACI-/+AD4-", ITSELF, before='<?xml version="1.0" encoding="UTF-7"?>'),
    "plain.json": in_json({"type": "evil"}),
    "above.json": in_json({"type": "../plugins/evil"}),
    "path.xml": xml('<path value="."/>', ITSELF),
    "resources.xml": xml('<shape type="resources"><string name="path" value="."/></shape>', ITSELF),
    "resources.json": in_json({"type": "evil"}, files={"type": "resources", "path": "."}),
    "resources-within.json": in_json({"type": "sphere", "part": {"type": "resources", "path": "."}}),
    "xml.json": json.dumps({"xml": xml(ITSELF), "folder": "."}),
    "include-xml.json": json.dumps({"xml": xml('<include filename="part.txt"/>'), "folder": "below"}),
}


@pytest.mark.parametrize("name", CODE)
def test_no_scene_runs_a_library(name: str, tmp_path: Path, evil: Callable[[Path, str], Path]) -> None:
    below = tmp_path / "below"
    mark = evil(tmp_path, "evil")
    evil(below, "evil")
    harmless = '<scene version="3.0.0"><shape type="cube"/></scene>'
    # what is checked in one folder must not be another file in the next
    (tmp_path / "part.txt").write_text(INCLUDED)
    (below / "part.txt").write_text('<scene version="3.0.0"><include filename="inner.txt"/></scene>')
    (below / "inner.txt").write_text(INCLUDED)
    (tmp_path / "inner.txt").write_text(harmless)
    path = tmp_path / name
    path.write_text(CODE[name])
    with pytest.raises(ValueError, match=r".") as caught:
        read_task(path, samples=64, held_out=16)
    assert_one_line(caught.value, path)
    assert not mark.exists()
    stored = {"xml": CODE[name]} if name.endswith("xml") else json.loads(CODE[name])
    with pytest.raises(ValueError, match=r"."):
        load_scene(stored)
    assert not mark.exists()


@pytest.mark.long
def test_no_library_in_the_working_folder_is_run(tmp_path: Path, evil: Callable[[Path, str], Path]) -> None:
    """Mitsuba looks in the folder that it is started in first; all that we do with a scene, its later plugins too."""
    # without importing Mitsuba, which in this process would go on looking in this test's folder
    spec = importlib.util.find_spec("mitsuba")
    assert spec is not None
    assert spec.origin is not None
    for plugin in (Path(spec.origin).parent / "plugins").iterdir():
        mark = evil(tmp_path, plugin.stem)
    (tmp_path / "room.json").write_text(json.dumps(random_scene(0)))
    lines = (
        "from pathlib import Path\nfrom metapp.extensions.scene_files.scene_reader import read_scene\n"
        "from metapp.rendering.paths.path_space import Tracer, render_reference\n"
        "print(render_reference(Tracer(read_scene(Path('room.json'))), 4, 4).shape)"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    process = subprocess.run(
        [sys.executable, "-c", lines], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    )
    assert "torch.Size([3, 4, 4])" in process.stdout
    assert not mark.exists()


def assert_one_line(error: ValueError, path: Path) -> None:
    output = str(error).removeprefix(f"{path}: ")
    assert output != str(error)
    assert "\n" not in output
    assert len(output) <= 300


NESTED = 50_000
MATERIAL = '<bsdf type="conductor"><string name="material" value="{}"/></bsdf>'
NAMED = '<string name="filename" value="{}"/>'
FILE = f'<bsdf type="diffuse"><texture name="reflectance" type="bitmap">{NAMED}</texture></bsdf>'
SPECTRUM = '<shape type="cube"><spectrum name="a" filename="{}"/></shape>'
GROWING = "".join(f'<default name="a{i}" value="{f"$a{i - 1}" * 10 if i else "x" * 10}"/>' for i in range(10))
PLACE = "string (line 99, col 1): "  # as Mitsuba names a place
CYCLE = '<bsdf type="twosided" id="a"><ref id="b"/></bsdf><bsdf type="twosided" id="b"><ref id="a"/></bsdf>'
LAUGH = "".join(f'<!ENTITY l{i + 1} "{f"&l{i};" * 10}">' for i in range(12))
SPHERE = {"type": "sphere"}
SAMPLER = '<sampler type="{}"><{} name="sampleCount" value="{}"/></sampler>'
LAMP_SHAPE = f'<shape type="cube">{LAMP.replace("4 4 4", "{}")}</shape>'
TWICE = SAMPLER.format("ldsampler", "integer", 4).replace("/><", '/><integer name="sample_count" value="9"/><')
ORTHOGRAPHIC = CAMERA.replace("perspective", "orthographic").replace('<float name="fov" value="45"/>', "")
BEAM = '<emitter type="directionalarea"/>'
SHUTTER = '<shape type="sphere"><point name="center" value="0, 0, 4"/></shape>'
AWAY = '<lookat origin="0, 9, 0" target="0, 99, 0" up="1, 0, 0"/>'
PROJECTOR = f'<shape type="sphere"/><emitter type="projector"><transform name="to_world">{AWAY}</transform></emitter>'
FOG = '<shape type="cube"><medium name="interior" type="homogeneous"/></shape>'
SMOKY = {"type": "cube", "interior": {"type": "ref", "id": "smoke"}}
MESH = f'<shape type="obj">{NAMED.format("a.obj")}</shape>'


def camera(**film: int) -> dict[str, Any]:
    return {**random_scene(0)["sensor"], "film": {"type": "hdrfilm", **film}}


def glowing(texture: dict[str, Any]) -> dict[str, Any]:
    return {**SPHERE, "emitter": {"type": "area", "radiance": texture}}


BAD: dict[str, tuple[str, str]] = {
    "empty.xml": ("", "not readable as XML"),
    "cut.json": ('{"type": "scene"', "not readable as JSON"),
    "bsdf.xml": ('<bsdf version="3.0.0" type="diffuse"/>', "an XML document of <bsdf>, expected a scene"),
    "dark.xml": (f'<scene version="3.0.0">{CAMERA}</scene>', "no emitter, expected an area light, an environment, a p"),
    "beam.xml": (xml(f"<shape type='cube'>{BEAM}</shape>"), "an emitter DirectionalArea.*small area light"),
    "blind.xml": (xml().replace(CAMERA, ""), "no sensor, expected a perspective one"),
    "lens.xml": (xml().replace(CAMERA, ORTHOGRAPHIC), "a sensor Orthographic.*expected a perspective one"),
    "turned.xml": (
        f'<scene version="3.0.0">{CAMERA}{PROJECTOR}</scene>',
        r"0 of [\d,]+ paths meet a light \(its only light is a projector\), expected 256 or more",
    ),
    "closed.xml": (xml(SHUTTER), r"0 of [\d,]+ paths meet a light, expected 256 or more.*; point the camera"),
    "fog.xml": (xml(FOG), "a participating medium, 'homogeneous', expected surfaces alone: .*; leave it out of the sh"),
    "smoke.json": (in_json(SMOKY, smoke={"type": "homogeneous", "id": "other"}), "a participating medium, 'homogen"),
    "mesh.xml": (xml(MESH), "names the file 'a.obj': file not found; put it in the scene's folder"),
    "laughs.xml": (xml(before=f'<!DOCTYPE scene [<!ENTITY l0 "ha">{LAUGH}]>'), "a DOCTYPE"),
    "deep.xml": (xml('<bsdf type="twosided">' * NESTED, "</bsdf>" * NESTED), "64 within each other"),
    "many.xml": (xml('<shape type="cube"/>' * 200_001), "more than 200,000 elements"),
    "growing.xml": (xml(GROWING), "a <default> 'a3'"),
    "material.xml": (xml(MATERIAL.format("../../../../tmp/x")), "expected plain text, no path"),
    "passwd.xml": (xml(FILE.format("/etc/passwd")), "names the file '/etc/passwd' outside.*--scene-root /etc"),
    "link.xml": (xml(FILE.format("link")), "names the file 'link' outside the scene's folder"),
    "fifo-bitmap.xml": (xml(FILE.format("fifo")), "no regular file"),
    "fifo-spectrum.xml": (xml(SPECTRUM.format("fifo")), "no regular file"),
    "place.xml": (xml(f'<bsdf type="diffuse"><float name="{PLACE}" value="nan"/></bsdf>'), "a value of 'string"),
    "spectrum.xml": (xml(SPECTRUM.format("/etc/passwd")), "outside"),
    "folder.xml": (xml('<path value="/etc"/>'), "the <path> '/etc' outside the scene's folder.*--scene-root /etc"),
    "fifo.xml": (xml('<include filename="fifo"/>'), "includes 'fifo', which cannot be read: no regular file"),
    "exponential.xml": (xml('<include filename="half0.xml"/>'), "more than 64 includes"),
    "itself.xml": (xml('<include filename="itself.xml"/>'), "'itself.xml', which cannot be read: it includes it"),
    "cycle.xml": (xml(CYCLE), "no scene that Mitsuba can load: .*circular"),
    "scenes.xml": (xml('<scene version="3.0.0"/>'), "line 2, <scene version=.*: unexpected attribute"),
    "version.xml": (xml(version="3;rm"), "a version '3;rm'"),
    "samples.json": (in_json({"type": "ldsampler", "sample_count": 4e9}), "a 'sample_count' of 4000000000, expected"),
    "camel.xml": (xml(SAMPLER.format("ldsampler", "integer", 4_000_000), version="0.6"), "a 'sample_count' of 4000"),
    "twice.xml": (xml(TWICE, version="0.6"), "line 2, <sampler .*integer \"sampleCount\": 4"),
    "bright.xml": (xml(LAMP_SHAPE.format("1e39 1e39 1e39")), "a light of luminance inf|that Mitsuba can load"),
    "endless.xml": (xml(LAMP_SHAPE.format("1e999 1e999 1e999")), "a 'rgb' with .*, expected 'value' of finite numbers"),
    "film.json": (in_json(SPHERE, sensor=camera(width=0)), "a 'width' of 0, expected 1 to 32,768"),
    "crop.json": (in_json(SPHERE, sensor=camera(crop_width=0)), "a film of 0 x 576 px, expected 1 or more"),
    "merge.json": (in_json({"type": "merge"}), "a 'merge' without shapes"),
    "black.json": (in_json(glowing({"type": "blackbody", "temperature": -1})), "a 'temperature' of -1, expected 1 to"),
    "warm.json": (in_json(glowing({"type": "blackbody", "temperature": 5000})), "Mitsuba can trace.*BlackBody"),
    "infinite.json": (in_json({**SPHERE, "b": {"type": "principled", "roughness": 1e30}}), "paths carry NaN"),
    "spectrum.json": (in_json({**SPHERE, "r": {"type": "spectrum", "filename": "/etc/passwd"}}), "outside the scene's"),
    "deep.json": ('{"type":"scene","a":' * NESTED + "1" + "}" * NESTED, "not readable as JSON|scene within"),
    "deeplist.json": ('{"type": "scene", "a": ' + "[" * NESTED + "]" * NESTED + "}", "readable as JSON|'a'"),
    "text.json": (json.dumps({"type": "scene", "xml": 3}), "an 'xml' that is no text"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_scenes_are_refused_at_once(name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "link").symlink_to("/etc/passwd")
    for number in range(33):
        twice = f'<include filename="half{number + 1}.xml"/>' * 2 * (number < 32)
        (tmp_path / f"half{number}.xml").write_text(f'<scene version="3.0.0">{twice}</scene>')
    content, expected = BAD[name]
    path = tmp_path / name
    path.write_text(content)
    begin = time.perf_counter()
    with pytest.raises(ValueError, match=expected) as caught:
        read_task(path, samples=64, held_out=16)
    assert_one_line(caught.value, path)
    assert time.perf_counter() - begin < 20  # hangs are without end
    assert capfd.readouterr() == ("", "")


def test_a_stored_scene_reads_no_files_but_those_of_scenes_read_before(tmp_path: Path) -> None:
    mesh = tmp_path / "lamp.obj"
    mesh.write_text("v -1 1.5 -1\nv 1 1.5 -1\nv 0 1.5 1\nf 1 2 3\n")
    stored = {**random_scene(0), "more": {"type": "obj", "filename": str(mesh)}}
    with pytest.raises(ValueError, match=r"expected none in a stored scene; give the scene file"):
        load_scene(stored)
    with pytest.raises(ValueError, match=r"expected none in a stored scene|file not found"):
        load_scene({"xml": xml(f'<include filename="{tmp_path}/part.xml"/>'), "folder": str(tmp_path)})
    path = tmp_path / "room.json"
    path.write_text(json.dumps({**stored, "more": {"type": "obj", "filename": "lamp.obj"}}))
    assert read_scene(path) == stored
    assert len(load_scene(stored).scene.shapes()) == len(load_scene(random_scene(0)).scene.shapes()) + 1


def test_xml_becomes_a_dictionary_of_checked_objects(tmp_path: Path) -> None:
    path = tmp_path / "room.xml"
    inside = '<default name="size" value="0.25"/><shape type="cube"><float name="r" value="$size"/></shape>'
    declared = '<?xml version="1.0" encoding="UTF-16"?>'  # Python's parser goes by the text, Mitsuba's might not
    path.write_text(xml(inside, '<!-- <shape type="evil"/> -->', "<![CDATA[<evil/>]]>", "<?evil?>", before=declared))
    result = read_scene(path)
    text = json.dumps(result)
    assert text.isascii()
    assert not [forbidden for forbidden in ("$", "evil", "<", "default", "&") if forbidden in text]
    assert result["shape 2"] == {"type": "cube", "r": 0.25}
    assert read_scene(path) == result
    path = path.with_suffix(".json")
    path.write_text(text)
    assert read_scene(path) == result


# Scenes in the style of Mitsuba's public ones


def write(path: Path, content: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content)
    return path


def picture(path: Path) -> None:
    import numpy as np

    mi = load_mitsuba()
    path.parent.mkdir(parents=True, exist_ok=True)
    values = np.linspace(0.2, 2, 8 * 16 * 3, dtype=np.float32).reshape(8, 16, 3)
    mi.Bitmap(values if path.suffix == ".exr" else (values * 100).astype(np.uint8)).write(str(path))


def preview(*parts: str) -> str:
    """A ball under a map, as materials are shown."""
    texture = '<texture type="bitmap" name="reflectance"><string name="filename" value="textures/grid.png"/></texture>'
    sky = '<emitter type="envmap"><string name="filename" value="textures/sky.exr"/><float name="scale" value="3"/>'
    ball = f'<bsdf type="twosided" id="grid"><bsdf type="diffuse">{texture}</bsdf></bsdf>'
    ball += '<shape type="sphere"><ref id="grid"/></shape>'
    return f'<scene version="3.0.0">{CAMERA}{"".join(parts)}{sky}</emitter>{ball}</scene>'


def test_files_come_from_a_folder_that_the_user_names(tmp_path: Path, evil: Callable[[Path, str], Path]) -> None:
    data, scenes = tmp_path / "data", tmp_path / "scenes"
    picture(data / "common" / "textures" / "sky.exr")
    picture(data / "common" / "textures" / "grid.png")
    named = write(scenes / "named.xml", preview('<path value="../data/common"/>'))
    with pytest.raises(ValueError, match=r"the <path> '\.\./data/common' outside.*: --scene-root .*/data/common$"):
        read_scene(named)
    assert read_task(named, samples=64, held_out=16, roots=[data]).data["image"].max() > 0.5
    plain = write(scenes / "plain.xml", preview())
    with pytest.raises(ValueError, match=r"names the file 'textures/sky\.exr': file not found"):
        read_scene(plain)
    brightest = Tracer(read_scene(plain, [data / "common"])).greatest_luminance
    assert brightest == pytest.approx(6, rel=0.01)  # 2 of the map, times its scale
    # but plugins never do
    mark = evil(data / "common", "cylinder")
    evil(data / "common", "evil")
    own_scene = preview('<path value="../data/common"/>', '<shape type="cylinder"/>')
    Tracer(read_scene(write(scenes / "own.xml", own_scene), [data]))
    with pytest.raises(ValueError, match="a plugin 'evil'"):
        read_scene(write(scenes / "evil.xml", preview('<path value="../data/common"/>', ITSELF)), [data])
    assert not mark.exists()


# Meshes, volumes and pictures of scenes


PAST = ((0, 1, 2), (0, 2, 400_000))
LIGHT = {"type": "area", "radiance": {"type": "rgb", "value": [1, 1, 1]}}

MESHES: dict[str, tuple[bytes, str]] = {
    **{f"{form}.ply": (ply_file(form, faces=PAST), "the process died|a face at vertex 400,000")
       for form in PLY_FORMATS},
    "one.ply": (ply_file("ascii", faces=((0, 1, 4),)), "a face at vertex 4, expected 0 to 3"),
    "few.ply": (ply_file("binary_little_endian", vertex=5), "could not parse|read 14 out of 26 bytes"),
    "past.serialized": (serialized_file(faces=PAST), "the process died|a face at vertex 400,000"),
    "bomb.serialized": (serialized_file(face=10_000_000), "0 faces, expected [0-9,]+ at most in a file of its size"),
    "nan.serialized": (serialized_file(corners=(NAN_CORNER, *CORNERS)),
                       "'more.vertex_positions' holds NaN or infinite values"),
    "past.obj": ((OBJ + "f 1 2 9\n").encode(), "reference to invalid vertex 9"),
    "empty.sdfgrid": (volume_file((0, 0, 0)), "a grid of 0 x 0 x 0, 1 channels"),
    "large.sdfgrid": (volume_file((1290, 1290, 1290)),
                      "48 bytes, expected 1 or more along each axis and 8,586,756,048"),
    "nan.sdfgrid": (volume_file((2, 2, 2), values=[np.nan] * 8), "'more.grid' holds NaN or infinite values"),
}  # fmt: skip

READS = """
import sys, pathlib
from metapp.extensions.scene_files.scene_reader import read_task
for name in sys.argv[1:]:
    try:
        read_task(pathlib.Path(name), samples=8, held_out=8)
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
    process = subprocess.run(
        [sys.executable, "-c", READS, *map(str, paths)], env=environment, capture_output=True, text=True, check=False
    )
    lines = dict(line.split("\t", 1) for line in process.stdout.splitlines())
    return {path.name: lines.get(str(path), f"died with {process.returncode}") for path in paths}


@pytest.mark.long
def test_damaged_files_are_refused_in_one_line(tmp_path: Path) -> None:
    paths = [write_scene(tmp_path, name, content, emitter=LIGHT) for name, (content, _) in MESHES.items()]
    begin = time.perf_counter()
    found = refusals(paths)
    assert time.perf_counter() - begin < 60
    wrong = {
        name: found[f"{name}.json"] for name, (_, line) in MESHES.items() if not re.search(line, found[f"{name}.json"])
    }
    assert wrong == {}
    for path in paths:
        output = found[path.name].removeprefix(f"{path}: ")
        assert output != found[path.name]
        assert len(output) <= 300


def png(width: int, height: int) -> bytes:
    """The beginning of a gray PNG of this size."""
    chunks = ((b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)), (b"IDAT", zlib.compress(bytes(100))))
    parts = (struct.pack(">I", len(b)) + a + b + struct.pack(">I", zlib.crc32(a + b)) for a, b in chunks)
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


@pytest.mark.parametrize(
    ("name", "content", "line"),
    [
        ("a.vol", volume_file((2, 2, 2), 2**31 - 1), "2147483647 channels"),
        (
            "a.vol",
            volume_file((1000, 1000, 1000), 6),
            "48 bytes, expected 1 or more along each axis and 24,000,000,048",
        ),
        ("a.png", png(20_000, 20_000), "20000x20000 px.*268,435,456 px or fewer"),
    ],
)
def test_texture_files_that_do_not_fit_their_plugin_are_refused(
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
        (tmp_path / name).write_bytes(volume_file((2, 2, 2), 3, values=np.ones(24)))
        assert load_scene(read_scene(path)).scene


# Files of scenes, at the limits of their names and sizes


def refused(message: str, call: Callable[..., Any], *words: Any) -> None:
    with pytest.raises(ValueError, match=message):
        call(*words)


def test_files_up_to_the_allowed_length_are_read_and_longer_ones_refused(tmp_path: Path) -> None:
    file, places = tmp_path / "x.xml", ScenePlaces((tmp_path,), (tmp_path,), most_bytes=10)
    for content, text in ((b"", ""), (b"x" * 10, "x" * 10), (b"\xef\xbb\xbfab", "ab")):  # without a byte order mark
        file.write_bytes(content)
        assert read_scene_text(file, 10) == text
        assert places.resolve_file("x.xml") == file
    file.write_bytes(b"x" * 11)
    refused("more than 10 characters", read_scene_text, file, 10)
    refused("of 11 bytes, expected 10 at most", places.resolve_file, "x.xml")
    file.write_bytes(b"\xff")
    refused("not text in UTF-8", read_scene_text, file)
    refused("No such file", read_scene_text, tmp_path / "none")
    refused("no regular file", read_scene_text, tmp_path)
