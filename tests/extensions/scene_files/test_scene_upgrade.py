"""Public scenes for Mitsuba 3: each repair keeps what the scene means, and what is left is named."""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import tostring

import pytest

from metapp.extensions.scene_files.reading import read_scene, read_task
from metapp.extensions.scene_files.upgrade.repairs import Repair, repair
from metapp.extensions.scene_files.upgrade.upgrade import lines, upgraded, verdict, write
from metapp.extensions.scene_files.xml import SceneElement, parse
from metapp.rendering.scenes.loading import load_any, load_scene
from tests.needs_mitsuba import needs_mitsuba

CAMERA = """<sensor type="perspective"><float name="fov" value="45"/>
    <transform name="toWorld"><lookAt origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/></transform>
    <sampler type="sobol"><integer name="sampleCount" value="$spp"/><integer name="scramble" value="1"/></sampler>
    <film type="ldrfilm"><integer name="width" value="32"/><integer name="height" value="24"/>
    <string name="fileFormat" value="png"/><boolean name="banner" value="false"/>
    <boolean name="attachLog" value="true"/>
    <string name="pixelFormat" value="spectrumAlpha"/><rfilter type="gaussian"><float name="stddev" value="0.5"/>
    </rfilter></film></sensor>"""
LAMP = """<shape type="sphere"><float name="radius" value="0.4"/>
    <luminaire type="area"><spectrum name="radiance" value="4"/></luminaire></shape>"""
NESTED = """<integrator type="adaptive"><float name="maxError" value="0.05"/>
    <integrator type="bdpt"><integer name="maxDepth" value="5"/></integrator></integrator>"""
BOX = """<bsdf type="lambertian" id="wall"><rgb name="diffuseReflectance" value="#804020"/></bsdf>
    <bsdf type="roughconductor" id="metal"><float name="alphaU" value="0.1"/><float name="alphaV" value="0.2"/></bsdf>
    <shape type="cube"><boolean name="flipNormals" value="true"/>
    <transform name="toWorld"><scale value="5"/></transform><ref id="wall"/></shape>
    <shape type="rectangle"><transform name="toWorld"><translate z="-2"/></transform><ref id="metal"/></shape>"""


def old(*parts: str, version: str = "0.6.0") -> str:
    return f'<scene version="{version}">' + "".join(parts) + "</scene>"


def repaired(*parts: str, version: str = "0.6.0") -> tuple[SceneElement, list[Repair], list[Repair]]:
    root = parse(old(*parts, version=version), strict=False)
    return root, *repair(root)


def test_conductors_keep_their_default_material_and_lose_air_outside() -> None:
    root, done, _ = repaired('<bsdf type="roughconductor"><float name="extEta" value="1"/></bsdf>')
    assert [(part.get("name"), part.get("value")) for part in root[0]] == [("material", "Cu")]
    assert [repair.done for repair in done] == ['no material: "Cu", the default of version 0.6', "left out, it is 1"]
    wet = '<bsdf type="conductor"><rgb name="eta" value="3"/><float name="extEta" value="1.5"/></bsdf>'
    assert repaired(wet)[1] == []


def test_textures_keep_their_colours() -> None:
    texture = """<bsdf type="diffuse"><texture type="ldrtexture" name="diffuseReflectance">
        <string name="filterType" value="ewa"/><float name="uscale" value="2"/>
        <float name="gamma" value="1"/><float name="maxAnisotropy" value="8"/></texture></bsdf>"""
    part = repaired(texture)[0][0][0]
    assert part.get("type") == "bitmap"
    assert {one.get("name"): one.get("value") for one in part} == {
        "filterType": "bilinear",
        "uscale": "2",
        "raw": "true",
    }


@pytest.mark.parametrize(
    ("written", "value"),
    [
        ('<rgb name="reflectance" value="#ff8000"/>', (1, 0.2158605, 0)),
        ('<srgb name="reflectance" value="1, 0.5, 0"/>', (1, 0.2140411, 0)),
        ('<spectrum name="reflectance" value="0.1, 0.2, 0.3"/>', (0.1, 0.2, 0.3)),
    ],
)
def test_colours_are_linear(written: str, value: tuple[float, ...]) -> None:
    colour = repaired(f'<bsdf type="diffuse">{written}</bsdf>')[0][0][0]
    assert colour.tag == "rgb"
    assert [float(part) for part in colour.get("value", "").split(",")] == pytest.approx(value, abs=1e-6)


@pytest.mark.parametrize(
    ("version", "kind"),
    [
        ("0.6.0", "guided_path"),
        ("3.0.0", "path_guiding_integrator"),
        ("3.0.0", "$integrator"),
        ("0.6.0", "sppm"),
        ("0.5.0", "metapp_guided_path"),
    ],
)
def test_other_integrators_are_path_of_the_same_depth(version: str, kind: str) -> None:
    depth = '<integer name="maxDepth" value="7"/>'
    more = f'{depth}<string name="budgetType" value="spp"/><float name="budget" value="$b"/>'
    root, done, _ = repaired(f'<integrator type="{kind}">{more}</integrator>', version=version)
    assert root[0].get("type") == "path"
    assert [(part.get("name"), part.get("value")) for part in root[0]] == [("max_depth", "7")]
    assert [one.element for one in done if one.done.startswith("left out")] == [
        '<string name="budgetType">',
        '<float name="budget">',
    ]


def test_what_version_3_has_stays() -> None:
    scene = """<integrator type="direct"><integer name="shading_samples" value="2"/></integrator>
        <bsdf type="roughplastic"><string name="distribution" value="ggx"/><float name="alpha" value="0.1"/></bsdf>
        <emitter type="constant"><spectrum name="radiance" value="2"/></emitter>
        <emitter type="sunsky"/>"""
    root = parse(old(scene, version="3.5.0"), strict=False)
    before = tostring(root)
    assert repair(root) == ([], [])
    assert tostring(root) == before


def test_what_no_repair_replaces_is_named() -> None:
    glass = '\n<bsdf type="coating" id="varnish"><bsdf type="ward"/></bsdf><emitter type="sunsky"/>'
    lamp = '<emitter type="area"><blackbody name="radiance" temperature="5000K"/></emitter>'
    _, _, left = repaired(glass, lamp)
    first, lobe, second, third = lines(left)
    assert "<bsdf type=\"ward\">: version 3 has no such lobe; give 'blendbsdf'" in lobe
    assert '<blackbody name="radiance">: version 3 has none for RGB; give a <spectrum>' in third
    assert first.startswith('line 2: <bsdf type="coating" id="varnish">: version 3 has no layers; give')
    assert second.startswith('line 2: <emitter type="sunsky">: axes and units differ in version 3; give')


@pytest.fixture
def box(tmp_path: Path) -> Path:
    """A scene of version 0.6 with an include, a mesh in a folder and defaults."""
    folder = tmp_path / "box"
    (folder / "parts").mkdir(parents=True)
    (folder / "parts" / "floor.obj").write_text("v -2 -1 -2\nv 2 -1 -2\nv 0 -1 2\nf 1 3 2\n")
    inside = '<string name="filename" value="floor.obj"/><float name="maxSmoothAngle" value="30"/>'
    (folder / "parts" / "floor.xml").write_text(old(f'<shape type="obj">{inside}</shape>'))
    include = '<include filename="parts/floor.xml"/>'
    path = folder / "box.xml"
    path.write_text(old('<default name="spp" value="16"/>', NESTED, CAMERA, LAMP, BOX, include))
    return path


@needs_mitsuba
def test_an_upgraded_scene_is_read_from_everywhere(box: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = box.read_bytes()
    found = upgraded(box)
    beside, elsewhere = box.with_name("box-v3.xml"), tmp_path / "other" / "box.xml"
    write(found.root, beside)
    write(found.root, elsewhere)
    assert box.read_bytes() == before
    assert 'value="parts/floor.obj"' in beside.read_text()
    assert f'value="{box.parent.resolve()}/parts/floor.obj"' in elsewhere.read_text()
    monkeypatch.chdir(tmp_path)
    scene = read_scene(beside)
    assert read_scene(elsewhere, [box.parent]) == scene
    assert verdict(beside) == ("", "")
    assert read_task(beside, samples=64, held=16).data["image"].max() > 1
    _, loaded = load_any(scene)
    assert loaded.integrator().class_name() == "PathIntegrator"
    assert loaded.sensors()[0].sampler().sample_count() == 16
    assert upgraded(beside)[1:] == ([], [])  # nothing is left to do


@needs_mitsuba
def test_a_light_of_one_number_is_white(box: Path) -> None:
    write(upgraded(box).root, target := box.with_name("v3.xml"))
    assert load_scene(read_scene(target)).brightest == pytest.approx(4.0, rel=1e-4)


@needs_mitsuba
@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (old(BOX), r"line 1, <bsdf type=\"lambertian\" id=\"wall\">: a plugin 'lambertian', expected one of Mitsuba's "
         r"own; leave it out, or metapp data upgrade .*s\.xml$"),
        (old('\n<animation name="toWorld"/>'), r"line 2: an element '<animation name>', expected those of Mitsuba 3; .*"
         r"metapp data upgrade .*s\.xml$"),
        (old(CAMERA.replace("$spp", "4").replace("lookAt", "lookat")), r"a plugin 'sobol'.* metapp data upgrade .*$"),
        (old('<integrator type="path"><boolean name="strictNormals" value="true"/></integrator>'),
         r"Mitsuba can load: .*strict_normals.*; metapp data upgrade .*s\.xml$"),
        (old('<integrator type="$i"/>', version="3.0.0"), r"'\$i', expected a <default> .* metapp data upgrade .*$"),
    ],
)  # fmt: skip
def test_readers_name_the_first_unsupported_element_and_the_remedy(tmp_path: Path, content: str, problem: str) -> None:
    path = tmp_path / "s.xml"
    path.write_text(content)
    with pytest.raises(ValueError, match=problem):
        read_task(path)


PASSWORDS = '<shape type="obj"><string name="filename" value="/etc/passwd"/></shape>'
HOSTILE: dict[str, tuple[str, str]] = {
    "entity": ('<!DOCTYPE scene [<!ENTITY a "b">]><scene version="0.6.0"/>', "a DOCTYPE, expected a scene without one"),
    "outside": (old(PASSWORDS), "outside the scene's folder"),
    "include": (old('<include filename="../../../../../../etc/passwd"/>'), "outside the scene's folder|file not found"),
    "missing": (old('<shape type="obj"><string name="filename" value="no.obj"/></shape>'), "file not found"),
    "nothing": ("", "not readable as XML"),
    "other": ("<a/>", "a version '' of <a>"),
    "deep": ("<scene version='0.6.0'>" + "<bsdf>" * 70, "within each other"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_upgrades_read_no_more_than_scenes_may(tmp_path: Path, name: str) -> None:
    content, problem = HOSTILE[name]
    path = tmp_path / "scene.xml"
    path.write_text(content)
    with pytest.raises(ValueError, match=f"scene.xml: .*({problem})"):
        upgraded(path)


@needs_mitsuba
def test_a_library_beside_a_scene_is_never_run(tmp_path: Path) -> None:
    path = tmp_path / "scene.xml"
    (tmp_path / "evil.so").write_bytes(b"no library")
    path.write_text(old(LAMP, '<bsdf type="evil"/>', '<shape type="../evil"/>'))
    write(upgraded(path).root, target := tmp_path / "v3.xml")
    assert "a plugin 'evil', expected one of Mitsuba's own" in verdict(target).problem


@needs_mitsuba
def test_what_mitsuba_refuses_has_the_line_of_the_written_file(tmp_path: Path) -> None:
    path = tmp_path / "scene.xml"
    path.write_text(
        old(
            LAMP.replace("luminaire", "emitter"),
            '<bsdf type="plastic"><float name="shine" value="2"/></bsdf>',
            version="3.0.0",
        )
    )
    write(upgraded(path).root, target := tmp_path / "v3.xml")
    written = target.read_text().splitlines()
    place = next(number for number, text in enumerate(written, 1) if "plastic" in text)
    assert f"(line {place}, col" in verdict(target).problem
    assert '"shine"' in verdict(path).problem
    assert "(line" not in verdict(path).problem


@needs_mitsuba
def test_lights_that_path_tracers_find_no_light_of_are_a_limit_of_metapp(tmp_path: Path) -> None:
    path = tmp_path / "scene.xml"
    lamp = '<shape type="rectangle"><emitter type="directionalarea"/></shape>'
    path.write_text(old(CAMERA.replace("$spp", "4"), lamp))
    write(upgraded(path).root, target := tmp_path / "v3.xml")
    problem, limit = verdict(target)
    assert not problem
    assert "an emitter DirectionalArea" in limit
