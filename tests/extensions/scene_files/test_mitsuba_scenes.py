"""A user's scenes, in files and in memory: read as tasks that render again from anywhere, or refused in one line."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from safetensors.torch import save_file

from data_tools.synthetic.cornell import random_scene, to_xml
from metapp.apps.transport.app import Transport
from metapp.extensions.scene_files.scene_places import ScenePlaces
from metapp.extensions.scene_files.scene_reader import find, read_scene, read_task, recognises, resolve_scene_in_memory
from metapp.extensions.scene_files.xml import parse_xml
from metapp.learning.task import problems_of
from metapp.registry import WITHOUT_VARIABLE
from metapp.rendering import variant as mitsuba_variant
from metapp.rendering.paths.path_space import Tracer
from metapp.rendering.scenes.loading import load_scene
from metapp.rendering.scenes.rules import SceneDict
from metapp.rendering.scenes.stored_text import decode_scene
from tests.found_paths import find_paths
from tests.needs_mitsuba import needs_mitsuba

LAMP = '<emitter type="area"><rgb name="radiance" value="4 4 4"/></emitter>'
CAMERA = """<sensor type="perspective"><float name="fov" value="45"/>
    <transform name="to_world"><lookat origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/></transform>
    <film type="hdrfilm"><integer name="width" value="80"/><integer name="height" value="60"/></film></sensor>"""
ROOM = """<shape type="sphere"><boolean name="flip_normals" value="true"/><float name="radius" value="6"/></shape>"""

SMOKE = """<volume name="sigma_t" type="gridvolume"><string name="filename" value="missing.vol"/></volume>
    <spectrum name="a" filename="missing.spd"/>"""
FOG = f'<medium type="heterogeneous" id="fog"><volume name="albedo" type="constvolume"/>{SMOKE}</medium>'


def xml(*parts: str) -> str:
    return '<scene version="3.0.0">' + "".join(parts) + "</scene>"


def ball(inside: str = LAMP) -> str:
    return f'<shape type="sphere"><float name="radius" value="0.5"/>{inside}</shape>'


def write(path: Path, content: str | dict[str, Any]) -> Path:
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def test_scene_files_are_recognised(tmp_path: Path) -> None:
    scene = write(tmp_path / "room.xml", "")
    assert recognises(scene)
    assert recognises(tmp_path)
    assert not recognises(write(tmp_path / "room.obj", ""))
    other = write(tmp_path / "box.json", "")
    write(tmp_path / "manifest.json", "")  # of a data set
    assert find_paths(find, tmp_path) == ([other, scene], [])
    assert find_paths(find, scene)[0] == [scene]
    empty = tmp_path / "empty"
    empty.mkdir()
    assert not recognises(empty)
    with pytest.raises(ValueError, match=r"no scene in this folder, expected \.xml or \.json"):
        find(empty)
    with pytest.raises(ValueError, match="no such file or folder"):
        find(tmp_path / "none.xml")


pytestmark = pytest.mark.usefixtures("few_paths")


@needs_mitsuba
def test_a_dictionary_is_the_task_it_came_from(tmp_path: Path) -> None:
    scene = random_scene(5)
    task = read_task(write(tmp_path / "five.json", scene), samples=300, held_out=100)
    assert task.name == "five"
    assert decode_scene(task.data["scene"]) == scene
    shapes = {"samples": (300, 4), "held_out": (100, 4), "image": (3, 32, 32), "scene": (8192,)}
    assert {key: tuple(value.shape) for key, value in task.data.items()} == shapes
    again = read_task(write(tmp_path / "five.json", scene), samples=300, held_out=100)
    assert all(torch.equal(task.data[key], again.data[key]) for key in task.data)
    assert not torch.equal(task.data["samples"][:100], task.data["held_out"])


@needs_mitsuba
def test_file_names_start_from_the_scenes_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "scenes"
    (folder / "parts").mkdir(parents=True)
    write(folder / "parts" / "lamp.obj", "v -1 1.5 -1\nv 1 1.5 -1\nv 0 1.5 1\nf 1 2 3\nf 3 2 1\n")
    write(folder / "camera.xml", xml(CAMERA))
    lamp = f'<shape type="obj"><string name="filename" value="parts/lamp.obj"/>{LAMP}</shape>'
    write(folder / "room.xml", xml('<include filename="camera.xml"/>', ROOM, lamp))
    task = read_task(folder / "room.xml", samples=64, held_out=16)
    monkeypatch.chdir(tmp_path)
    elsewhere = read_task(write(tmp_path / "room.json", decode_scene(task.data["scene"])), samples=64, held_out=16)
    assert all(torch.equal(task.data[key], elsewhere.data[key]) for key in task.data)
    # and in a dictionary
    sensor = random_scene(0)["sensor"]
    part = {"type": "obj", "filename": "parts/lamp.obj", "emitter": {"type": "area"}}
    write(folder / "room.json", {"type": "scene", "sensor": sensor, "lamp": part})
    assert read_task(folder / "room.json", samples=64, held_out=16).data["image"].max() > 0.5


def textured_scene(name: str) -> str:
    file = f'<string name="filename" value="{name}"/>'
    return ball(f'<bsdf type="diffuse" name="bsdf"><texture type="bitmap" name="reflectance">{file}</texture></bsdf>')


def named_file(scene: SceneDict) -> str:
    name: str = scene["shape 1"]["bsdf"]["reflectance"]["filename"]
    return name


@needs_mitsuba
def test_folders_of_files_are_declared_in_dictionaries_as_in_xml(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    write(tmp_path / "parts" / "lamp.obj", "v -1 1.5 -1\nv 1 1.5 -1\nv 0 1.5 1\nf 1 2 3\nf 3 2 1\n")
    sensor, lamp = random_scene(0)["sensor"], {"type": "obj", "filename": "lamp.obj", "emitter": {"type": "area"}}
    scene = {"type": "scene", "sensor": sensor, "lamp": lamp, "files": {"type": "resources", "path": "parts"}}
    read = read_scene(write(tmp_path / "room.json", scene))
    assert read["lamp"]["filename"] == str((tmp_path / "parts" / "lamp.obj").resolve())
    assert "files" not in read
    assert Tracer(read).greatest_luminance > 0
    inside = {**scene, "lamp": {**lamp, "files": scene["files"]}}
    for changed, problem in (
        ({**scene, "files": {"type": "resources", "path": "none"}}, "the <path> 'none': file not found"),
        ({**scene, "files": {"type": "resources"}}, "a 'resources' 'files', expected a 'path' alone"),
        ({**scene, "files": {"type": "resources", "path": "/"}}, "--scene-root /"),
        (inside, "a 'resources' within another object, expected it beside the sensor"),
    ):
        with pytest.raises(ValueError, match=problem):
            read_scene(write(tmp_path / "room.json", changed))


@needs_mitsuba
def test_names_of_files_as_windows_spells_them_are_found(tmp_path: Path) -> None:
    (tmp_path / "textures").mkdir()
    Image.new("RGB", (4, 4), "red").save(tmp_path / "textures" / "wood.png")
    path, file = tmp_path / "room.xml", (tmp_path / "textures" / "wood.png").resolve()
    for name in (r"textures\wood.png", "Textures/Wood.PNG", r".\TEXTURES\wood.png", str(file).replace("wood", "Wood")):
        assert named_file(read_scene(write(path, xml(CAMERA, textured_scene(name))))) == str(file), name
    include = write(tmp_path / "textures" / "camera.xml", xml(CAMERA))
    included = read_scene(write(path, xml(rf'<include filename="TEXTURES\{include.name}"/>')))
    assert included["sensor 1"]["type"] == "perspective"
    for name, problem in ((r"textures\none.png", "file not found"), (r"C:\wood.png", "name it without its drive")):
        with pytest.raises(ValueError, match=problem):
            read_scene(write(path, xml(CAMERA, textured_scene(name))))
    with pytest.raises(ValueError, match="outside the scene's folder"):
        read_scene(write(include, xml(CAMERA, textured_scene(rf"..\{file.parent.name}\..\Room.xml"))))
    Image.new("RGB", (4, 4), "blue").save(tmp_path / "textures" / "WOOD.png")
    with pytest.raises(ValueError, match="file not found"):  # which of the two is not known
        read_scene(write(path, xml(CAMERA, textured_scene("textures/Wood.PNG"))))
    assert named_file(read_scene(write(path, xml(CAMERA, textured_scene("textures/wood.png"))))) == str(file)


@needs_mitsuba
def test_xml_is_read_as_the_dictionary_of_its_objects(tmp_path: Path) -> None:
    write(tmp_path / "flat.spd", "400 0.5\n700 0.5\n")
    write(tmp_path / "paint.xml", '<bsdf version="0.6" type="diffuse" id="paint.1"/>')
    parts = (
        '<default name="r" value="0.5"/><include filename="paint.xml"/><alias id="paint.1" as="coat"/>',
        '<shape type="sphere" id="shape 2" name="a.b"><float name="radius" value="$r"/>',
        '<ref id="coat" name="bsdf"/></shape>',
        '<shape type="cube"><transform name="toWorld"><scale value="2"/><translate x="$r"/></transform>',
        '<bsdf type="plastic" name="c.d"><integer name="intIOR" value="2"/><boolean name="nonlinear" value="true"/>',
        '<spectrum name="a" value="0.25"/><spectrum name="b" value="400:1, 700:2"/><rgb name="c" value="1"/></bsdf>',
        '<texture name="t" type="bitmap"><float name="uscale" value="2"/></texture>',
        '<point name="p" x="1" y="2" z="3"/><spectrum name="s" filename="flat.spd"/></shape>',
    )
    path = write(tmp_path / "s.xml", xml(*parts).replace("3.0.0", "0.6"))
    scaled, moved = np.diag([2.0, 1, 1, 1]).tolist(), np.diag([2.0, 2, 2, 1])
    moved[0, 3] = 0.5
    plastic = {
        "int_ior": 2,
        "nonlinear": True,
        "a": {"type": "spectrum", "value": 0.25},
        "b": {"type": "spectrum", "value": [[400, 1], [700, 2]]},
        "c": {"type": "rgb", "value": [1, 1, 1]},
    }
    assert parse_xml(path.read_text(), ScenePlaces.from_scene_file(path)).scene == {
        "type": "scene",
        "bsdf 1": {"type": "diffuse", "id": "paint.1"},
        "shape 1": {"type": "sphere", "id": "shape 2", "radius": 0.5, "bsdf": {"type": "ref", "id": "paint.1"}},
        "shape 3": {
            "type": "cube",
            "to_world": moved.tolist(),
            "bsdf 2": {"type": "plastic", **plastic},
            "t": {"type": "bitmap", "to_uv": scaled},
            "p": [1, 2, 3],
            "s": {"type": "spectrum", "filename": str(tmp_path.resolve() / "flat.spd")},
        },
    }
    for name in ("type", "id"):
        with pytest.raises(ValueError, match=f"a parameter named '{name}', expected another name"):
            read_scene(write(path, xml(ball(f'<string name="{name}" value="x"/>'))))


@needs_mitsuba
def test_what_mitsuba_cannot_load_is_named_by_the_line_of_the_users_file(tmp_path: Path) -> None:
    write(tmp_path / "camera.xml", xml(CAMERA))
    begin = '<?xml version="1.0"?>\n<scene version="3.0.0">\n<include filename="camera.xml"/>\n<!-- two\nlines -->\n'
    wrong = '<shape type="sphere"><float name="radius"\n  value="x"/></shape>'
    for part, where in (
        (
            '<integrator type="path"/>\n' + ball('<bsdf type="diffuse"><float name="alpa" value="1"/></bsdf>'),
            '7, <bsdf type="diffuse">',
        ),
        (wrong, '6, <float name="radius" value="x">'),
        ("\n\n" + ball('\n<bsdf type="bumpmap"><bsdf type="diffuse"/></bsdf>'), '9, <bsdf type="bumpmap">'),
    ):
        path = write(tmp_path / "s.xml", f"{begin}{part}\n{ball()}</scene>")
        with pytest.raises(
            ValueError, match=rf"^{path}: no scene that Mitsuba can load: line {where}: .*; change it, or"
        ):
            read_task(path)


@needs_mitsuba
def test_a_scene_in_memory_is_explained_by_its_own_text(mitsuba: Any) -> None:
    """Mitsuba's nodes refer to the text that it parsed: it must live as long as they do."""
    text = xml("\n\n" + ball('<bsdf type="nope" id="größe"/>'))
    for _ in range(3):
        with pytest.raises(ValueError, match=r'line \d+, <bsdf type="nope"[^>]*>: a plugin .nope.'):
            resolve_scene_in_memory(text, "scene")


@needs_mitsuba
def test_an_environment_is_a_light(tmp_path: Path) -> None:
    sky = '<emitter type="constant"><rgb name="radiance" value="0.5 0.5 0.5"/></emitter>'
    task = read_task(write(tmp_path / "sky.xml", xml(CAMERA, ball(""), sky)), samples=500, held_out=500)
    edge, middle = task.data["image"][:, 0], task.data["image"][:, 16, 16]
    torch.testing.assert_close(edge, torch.full_like(edge, 0.5))
    torch.testing.assert_close(middle, torch.full_like(middle, 0.25))  # Mitsuba's default reflects half


@needs_mitsuba
def test_a_medium_that_nothing_refers_to_is_left_out(tmp_path: Path) -> None:
    plain, part = xml(CAMERA, ball()), write(tmp_path / "part.xml", xml(FOG))
    expected = read_scene(write(tmp_path / "plain.xml", plain))
    for name, more in (("fog", FOG), ("included", f'<include filename="{part.name}"/>')):
        assert read_scene(write(tmp_path / f"{name}.xml", xml(more, CAMERA, ball()))) == expected, name
    scene = random_scene(0)
    smoke = {"type": "heterogeneous", "phase": {"type": "evil"}}
    assert read_scene(write(tmp_path / "smoke.json", {**scene, "smoke": smoke})) == scene
    assert Tracer(expected).greatest_luminance == pytest.approx(4)


AIM = '<transform name="to_world"><lookat origin="2, 2, 2" target="0, 0, 0" up="0, 1, 0"/></transform>'


@needs_mitsuba
@pytest.mark.parametrize(
    ("kind", "inside"),
    [
        ("point", '<point name="position" value="2, 2, 2"/>'),
        ("directional", '<vector name="direction" value="-1, -1, -1"/>'),
        ("spot", AIM),
    ],
)
def test_lights_that_no_path_meets_by_chance_are_sampled(tmp_path: Path, kind: str, inside: str) -> None:
    floor = '<shape type="disk"><transform name="to_world"><scale value="3"/></transform></shape>'
    lamp = f'<emitter type="{kind}">{inside}</emitter>'
    task = read_task(write(tmp_path / "lamp.xml", xml(CAMERA, floor, ball(""), lamp)), samples=300, held_out=100)
    assert task.data["next_event"].tolist() == [1]
    assert (len(task.data["samples"]), len(task.data["held_out"])) == (300, 100)
    assert not problems_of(task, Transport.tensors)
    assert task.data["image"].max() > 0


def old(*parts: str) -> str:
    return xml(*parts).replace("3.0.0", "0.6.0").replace("to_world", "toWorld").replace("flip_normals", "flipNormals")


@needs_mitsuba
def test_an_older_scene_is_read_where_mitsuba_knows_its_elements_and_plugins(tmp_path: Path) -> None:
    (tmp_path / "old").mkdir()
    before = write(tmp_path / "old" / "box.xml", old(CAMERA, ROOM, ball()))
    assert "toWorld" in before.read_text()
    new = write(tmp_path / "box.xml", xml(CAMERA, ROOM, ball()))
    one, other = (read_task(path, samples=64, held_out=16).data["image"] for path in (before, new))
    assert torch.equal(one, other)


@needs_mitsuba
@pytest.mark.parametrize(
    ("part", "problem"),
    [
        ('<bsdf type="lambertian"/>', r"line 3, <bsdf type=\"lambertian\">: a plugin 'lambertian'"),
        (
            '\n<animation name="toWorld"/>',
            'no scene .*: line 4, <animation name="toWorld">: .*unsupported.*; change it',
        ),
        ('<integrator type="$i"/>', r"'\$i', expected a <default> before it"),
        (
            '<integrator type="path"><boolean name="strictNormals" value="true"/></integrator>',
            "no scene that Mitsuba can load: .*strict_?[nN]ormals",
        ),
    ],
)
def test_what_version_3_lacks_is_named_with_the_version_of_the_scene(tmp_path: Path, part: str, problem: str) -> None:
    remedy = r"change this scene of version 0\.6\.0 to 3\.0\.0 by hand"
    path = write(tmp_path / "s.xml", old(CAMERA, ball(), part))
    with pytest.raises(ValueError, match=rf"^{path}: {problem}.*, or {remedy}: .*\.$"):
        read_task(path)
    with pytest.raises(ValueError, match=rf"^{path}: {problem}") as caught:
        read_task(write(path, xml(CAMERA, ball(), part)))
    assert "by hand" not in str(caught.value)


def test_a_missing_libllvm_is_not_the_scenes_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def none() -> Path:
        raise ValueError("libLLVM: found none, expected 19 or newer for Mitsuba; apt-get install libllvm19 libatomic1.")

    monkeypatch.setattr(mitsuba_variant, "find_llvm", none)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(ValueError, match=r"^libLLVM: found none, expected 19"):
        read_task(write(tmp_path / "box.json", random_scene(0)))


# In memory


def small_scene(transform: Any) -> dict[str, Any]:
    return {
        "type": "scene",
        "camera": {"type": "perspective", "fov": np.float32(40), "to_world": transform},
        "ball": {"type": "sphere", "center": (0, np.float64(0.25), 0), "bsdf": {"type": "diffuse"}},
        "light": {"type": "constant", "radiance": {"type": "rgb", "value": np.array([1.0, 2.0, 3.0])}},
    }


@needs_mitsuba
def test_scene_dictionaries_in_memory_become_tasks(mitsuba: Any) -> None:
    matrix = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -5], [0, 0, 0, 1]])
    plain = json.loads(json.dumps(small_scene(matrix.tolist()), default=lambda value: value.tolist()))
    plain["ball"]["center"] = [0, 0.25, 0]
    for transform in (matrix, mitsuba.ScalarTransform4f(matrix), mitsuba.Transform4f(matrix.tolist())):
        result = resolve_scene_in_memory(small_scene(transform), "object")
        assert result == plain
    for point in (mitsuba.ScalarPoint3f(1, 2, 3), mitsuba.Point3f(1, 2, 3)):
        around = {"type": "scene", "a": {"type": "sphere", "center": point}}
        assert resolve_scene_in_memory(around, "object")["a"]["center"] == [1, 2, 3]


@needs_mitsuba
def test_loaded_mitsuba_scenes_are_taken_as_scenes(mitsuba: Any) -> None:
    result = resolve_scene_in_memory(mitsuba.cornell_box(), "object")
    assert len(load_scene(result).scene.emitters()) == 1
    loaded = mitsuba.load_dict({"type": "diffuse"})
    with pytest.raises(ValueError, match=r"object: \w+ as 'bsdf', expected numbers, text, a transform or a dictionary"):
        resolve_scene_in_memory({"type": "scene", "a": {"type": "sphere", "bsdf": loaded}}, "object")


@needs_mitsuba
def test_scene_texts_in_memory_become_tasks(tmp_path: Path) -> None:
    text = "<scene version='3.0.0'><shape type='sphere'/></scene>"
    (tmp_path / "file.xml").write_text(text)
    assert resolve_scene_in_memory(text, "object") == read_scene(tmp_path / "file.xml")


WITHIN: dict[str, Any] = {"type": "scene"}
WITHIN["scene"] = WITHIN


@pytest.mark.parametrize(
    ("source", "line"),
    [
        (3, "object: int, expected a path, a scene as Mitsuba's load_dict takes it, or XML text"),
        ({"type": "scene", "a": object()}, "object: object as 'a', expected numbers"),
        (WITHIN, "object: objects within each other, more than 64 deep, expected fewer"),
    ],
)
def test_objects_that_are_no_scene_are_refused_in_one_line(source: object, line: str) -> None:
    with pytest.raises(ValueError, match=line) as caught:
        resolve_scene_in_memory(source, "object")
    assert "\n" not in str(caught.value)


@needs_mitsuba
def test_without_the_extension_scenes_are_dictionaries_without_files(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(WITHOUT_VARIABLE, "scene_files")
    box = random_scene(0)
    assert len(load_scene(box).scene.emitters()) == 1
    with pytest.raises(ValueError, match=r"a scene in XML, .*; XML needs the extension scene_files"):
        load_scene({"xml": to_xml(box)})
    mesh = {"type": "ply", "filename": "/etc/hostname"}
    with pytest.raises(ValueError, match=r"names the file '/etc/hostname', .* need the extension scene_files"):
        load_scene({**box, "more": mesh})


@needs_mitsuba
def test_our_exported_scenes_are_read_while_their_fit_lies_beside(tmp_path: Path) -> None:
    weights = {"w1": (21, 6), "w2": (21, 21), "w3": (3, 21), "b1": (21, 1), "b2": (21, 1), "b3": (3, 1)}
    rng = torch.Generator().manual_seed(0)
    fit = {name: torch.rand(shape, generator=rng) * 0.1 for name, shape in weights.items()}
    save_file(fit, tmp_path / "paint.safetensors")
    bsdf = '<bsdf type="neural_brdf"><string name="filename" value="paint.safetensors"/></bsdf>'
    lamp = f'<shape type="sphere"><point name="center" x="0" y="3" z="0"/>{LAMP}</shape>'
    scene = write(tmp_path / "paint.xml", xml(CAMERA, ball(bsdf), lamp))
    task = read_task(scene, samples=64, held_out=16)
    assert torch.isfinite(task.data["samples"]).all()
    (tmp_path / "paint.safetensors").write_bytes(b"no fit")
    with pytest.raises(ValueError, match=r"paint\.xml: no scene .* expected the \.safetensors file of a BRDF fit"):
        read_task(scene, samples=64, held_out=16)
    (tmp_path / "paint.safetensors").unlink()
    with pytest.raises(ValueError, match=r"file not found; put it in the scene's folder\.$"):
        read_scene(scene)
    write(tmp_path / "paint_builtin.xml", "")
    with pytest.raises(ValueError, match=r"put it in the scene's folder; or take paint_builtin\.xml beside it"):
        read_scene(scene)
