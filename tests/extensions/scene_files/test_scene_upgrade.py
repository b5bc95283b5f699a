"""Public scenes for Mitsuba 3: each repair keeps what the scene means, and what is left is named."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from xml.etree.ElementTree import tostring

import numpy as np
import pytest

from metapp.extensions.scene_files.reading import read_scene, read_task
from metapp.extensions.scene_files.upgrade.repairs import Repair, repair
from metapp.extensions.scene_files.upgrade.upgrade import lines, upgraded, verdict, write
from metapp.extensions.scene_files.xml import SceneElement, parse
from metapp.rendering.scenes.loading import load_any, load_scene
from metapp.rendering.variant import load_mitsuba
from tests.needs_mitsuba import needs_mitsuba

MU = (np.arange(400) + 0.5) / 400
COS, PHI = (part.ravel() for part in np.meshgrid(MU, 2 * np.pi * (np.arange(800) + 0.5) / 800, indexing="ij"))
WO = np.stack([np.sqrt(1 - COS**2) * np.cos(PHI), np.sqrt(1 - COS**2) * np.sin(PHI), COS])
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
BOX = """<bsdf type="phong" id="wall"><float name="exponent" value="40"/>
    <rgb name="diffuseReflectance" value="#804020"/>
    <spectrum name="specularReflectance" value="0.3"/></bsdf>
    <bsdf type="ward" id="metal"><float name="alphaU" value="0.1"/><float name="alphaV" value="0.2"/></bsdf>
    <shape type="cube"><boolean name="flipNormals" value="true"/>
    <transform name="toWorld"><scale value="5"/></transform><ref id="wall"/></shape>
    <shape type="rectangle"><transform name="toWorld"><translate z="-2"/></transform><ref id="metal"/></shape>"""


def old(*parts: str, version: str = "0.6.0") -> str:
    return f'<scene version="{version}">' + "".join(parts) + "</scene>"


def repaired(*parts: str, version: str = "0.6.0") -> tuple[SceneElement, list[Repair], list[Repair]]:
    root = parse(old(*parts, version=version), strict=False)
    return root, *repair(root)


def bsdf(xml: str) -> Callable[[float, np.ndarray], np.ndarray]:
    """The red reflectance, times cosine, of a repaired BSDF: of an incident angle in degrees and directions [3, N]."""
    import drjit

    mi = load_mitsuba()
    text = tostring(repaired(xml)[0][0], encoding="unicode").replace("<bsdf", '<bsdf version="3.0.0"', 1)
    made = mi.load_string(text)

    def reflected(degrees: float, outgoing: np.ndarray) -> np.ndarray:
        point = drjit.zeros(mi.SurfaceInteraction3f, outgoing.shape[1])
        point.wi = mi.Vector3f(*map(float, incident(degrees)))
        return np.array(made.eval(mi.BSDFContext(), point, mi.Vector3f(outgoing.astype(np.float32))))[0]

    return reflected


def incident(degrees: float) -> np.ndarray:
    return np.array([math.sin(math.radians(degrees)), 0.0, math.cos(math.radians(degrees))])


def mirrored(degrees: float) -> np.ndarray:
    return (incident(degrees) * (-1, 1, 1))[:, None]


def phong(kd: float, ks: float, exponent: float) -> Callable[[float, np.ndarray], np.ndarray]:
    """As Mitsuba 0.6 defines it."""

    def reflected(degrees: float, outgoing: np.ndarray) -> np.ndarray:
        about = np.clip(mirrored(degrees)[:, 0] @ outgoing, 0, None)
        return (kd / np.pi + ks * (exponent + 2) / (2 * np.pi) * about**exponent) * outgoing[2]

    return reflected


def ward(kd: float, ks: float, along: float, across: float) -> Callable[[float, np.ndarray], np.ndarray]:
    """As Mitsuba 0.6 defines the balanced variant."""

    def reflected(degrees: float, outgoing: np.ndarray) -> np.ndarray:
        half = incident(degrees)[:, None] + outgoing
        slopes = (half[0] / (along * half[2])) ** 2 + (half[1] / (across * half[2])) ** 2
        lobe = (half**2).sum(0) / (np.pi * along * across * half[2] ** 4) * np.exp(-slopes)
        return (kd / np.pi + ks * lobe) * outgoing[2]

    return reflected


def albedo(reflected: Callable[[float, np.ndarray], np.ndarray], degrees: float) -> float:
    return float(reflected(degrees, WO).mean()) * 2 * np.pi


def under_even_light(reflected: Callable[[float, np.ndarray], np.ndarray]) -> float:
    """The mean albedo over incident directions, weighted with the cosine; by the midpoint rule over its square."""
    squares = (np.arange(12) + 0.5) / 12
    return float(np.mean([albedo(reflected, math.degrees(math.acos(math.sqrt(square)))) for square in squares]))


PHONG = """<bsdf type="phong"><float name="exponent" value="{}"/><rgb name="diffuseReflectance" value="{}"/>
    <rgb name="specularReflectance" value="0.4"/></bsdf>"""
WARD = """<bsdf type="ward"><float name="alphaU" value="{}"/><float name="alphaV" value="{}"/>
    <rgb name="diffuseReflectance" value="0"/><rgb name="specularReflectance" value="0.4"/></bsdf>"""


@needs_mitsuba
@pytest.mark.parametrize("exponent", [10, 60, 400])
def test_a_phong_lobe_keeps_its_form_and_its_light(exponent: int) -> None:
    """Its form at normal incidence, its albedo under even light: within 3.1 % at an exponent of 10, 1 % at 60."""
    mine, theirs = bsdf(PHONG.format(exponent, 0)), phong(0, 0.4, exponent)
    lobe, expected = mine(0, WO), theirs(0, WO)
    assert np.abs(lobe / lobe.sum() - expected / expected.sum()).sum() < 0.005
    assert under_even_light(mine) == pytest.approx(under_even_light(theirs), rel=0.04)
    both, separate = bsdf(PHONG.format(exponent, 0.3)), phong(0.3, 0, exponent)
    np.testing.assert_allclose(both(40, WO), mine(40, WO) + separate(40, WO), rtol=2e-4, atol=1e-5)


@needs_mitsuba
@pytest.mark.parametrize(("along", "across", "share"), [(0.05, 0.05, 0.03), (0.1, 0.2, 0.06), (0.3, 0.3, 0.13)])
def test_a_ward_lobe_is_one_of_microfacets(along: float, across: float, share: float) -> None:
    """Its peak is the same; microfacets reflect more beside it, by about the mean square of the alphas."""
    mine, theirs = bsdf(WARD.format(along, across)), ward(0, 0.4, along, across)
    for degrees in (0, 30, 60):
        peak = theirs(degrees, mirrored(degrees))
        np.testing.assert_allclose(mine(degrees, mirrored(degrees)), peak, rtol=0.001)
        assert albedo(mine, degrees) == pytest.approx(albedo(theirs, degrees), rel=share)


@needs_mitsuba
def test_reflectances_above_one_are_scaled_as_in_version_0_6() -> None:
    mine = bsdf(PHONG.format(30, 0.8))
    scale = 0.99 / 1.2
    assert albedo(mine, 0) == pytest.approx(scale * (0.8 + 0.4 * 2 / 3), rel=1e-3)
    colours = """<bsdf type="phong"><rgb name="diffuseReflectance" value="0.9 0 0"/>
        <rgb name="specularReflectance" value="0 0.9 0.9"/></bsdf>"""  # no weight leaves both below 1
    assert albedo(bsdf(colours), 0) == pytest.approx(0.9, rel=1e-3)


@pytest.mark.parametrize("value", ["nan", "inf", "-1", "", "a lot"])
def test_numbers_that_are_none_are_left(value: str) -> None:
    for xml in (PHONG.format(value, 0), WARD.format(value, 0.1)):
        assert repaired(xml)[0][0].get("type") in ("phong", "ward")


@needs_mitsuba
def test_a_mixture_is_the_sum_of_its_parts() -> None:
    parts = "".join(f'<bsdf type="diffuse"><rgb name="reflectance" value="{v}"/></bsdf>' for v in (0.2, 0.4, 0.9))
    for weights in ("0.5, 0.25, 0.25", "0.1, 0.2, 0.3", "1, 0, 0"):
        mine = bsdf(f'<bsdf type="mixturebsdf"><string name="weights" value="{weights}"/>{parts}</bsdf>')
        expected = np.dot([float(w) for w in weights.split(",")], (0.2, 0.4, 0.9))
        assert albedo(mine, 20) == pytest.approx(expected, rel=1e-3)


@needs_mitsuba
def test_metals_keep_their_default_and_the_medium_outside() -> None:
    copper = bsdf('<bsdf type="roughconductor"><float name="alpha" value="0.2"/></bsdf>')
    assert albedo(copper, 0) > 0.85  # version 3 has none: 1, but copper's red is below
    named = '<bsdf type="roughconductor"><string name="material" value="Cu"/><float name="alpha" value="0.2"/></bsdf>'
    np.testing.assert_array_equal(copper(30, WO), bsdf(named)(30, WO))
    wet = """<bsdf type="roughconductor"><rgb name="eta" value="3"/><rgb name="k" value="4"/>
        <float name="extEta" value="1.5"/><float name="alpha" value="0.2"/></bsdf>"""
    eta, k = 3 / 1.5, 4 / 1.5
    mirror = ((eta - 1) ** 2 + k**2) / ((eta + 1) ** 2 + k**2)  # as it is at normal incidence
    peak = bsdf(wet)(0, mirrored(0)) * 4 * np.pi * 0.2**2
    np.testing.assert_allclose(peak, mirror, rtol=1e-4)


def test_textures_keep_their_coordinates_and_their_colours() -> None:
    """Version 0.6 scales coordinates, then moves them."""
    texture = """<bsdf type="diffuse"><texture type="ldrtexture" name="diffuseReflectance">
        <string name="filterType" value="ewa"/><float name="uscale" value="2"/><float name="voffset" value="0.5"/>
        <float name="gamma" value="1"/><float name="maxAnisotropy" value="8"/></texture></bsdf>"""
    root, _, _ = repaired(texture)
    part = root[0][0]
    assert (part.get("type"), part.get("name")) == ("bitmap", "reflectance")
    assert {one.get("name"): one.get("value") for one in part if one.tag != "transform"} == {
        "filter_type": "bilinear",
        "raw": "true",
    }
    steps = part.find("transform")
    assert steps is not None
    found = [(step.tag, step.get("x"), step.get("y")) for step in steps]
    assert found == [("scale", "2", "1"), ("translate", "0", "0.5")]


def test_a_textured_phong_keeps_its_texture() -> None:
    texture = '<texture type="checkerboard" name="{}Reflectance"/>'
    one, done, _ = repaired(f'<bsdf type="phong" id="a">{texture.format("diffuse")}</bsdf>')
    assert one[0].get("type") == "principled"
    assert [part.get("name") for part in one[0]] == ["base_color", "eta", "roughness"]
    assert any("principled, as the diffuse part has a texture" in repair.done for repair in done)
    both, _, _ = repaired(f'<bsdf type="phong">{texture.format("diffuse")}{texture.format("specular")}</bsdf>')
    assert [part.get("name") for part in both[0]] == ["weight", None, None]
    assert both[0][1][0].get("name") == "reflectance"


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


def test_light_of_a_blackbody_is_plancks() -> None:
    lamp = '<emitter type="area"><blackbody name="radiance" temperature="5000K" scale="2"/></emitter>'
    found = repaired(lamp)[0][0][0]
    assert found.tag == "spectrum"
    values = dict(pair.split(":") for pair in found.get("value", "").split(", "))
    greatest = max(values, key=lambda nm: float(values[nm]))
    assert greatest == "580"  # Wien: 2897.77 um K / 5000 K
    assert float(values["580"]) == pytest.approx(2 * 12_797, rel=0.001)  # W / (m^2 sr nm): 4.0957e-6 T^5 1e-9


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
    _, _, left = repaired(glass)
    first, second = lines(left)
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
    with pytest.raises(ValueError, match=r"box-v3\.xml: there already, expected a new file; .* --out FILE"):
        write(found.root, beside)


@needs_mitsuba
def test_a_light_of_one_number_is_white(box: Path) -> None:
    write(upgraded(box).root, target := box.with_name("v3.xml"))
    assert load_scene(read_scene(target)).brightest == pytest.approx(4.0, rel=1e-4)


@needs_mitsuba
@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (old(BOX), r"line 1, <bsdf type=\"phong\" id=\"wall\">: a plugin 'phong', expected one of Mitsuba's own; "
         r"leave it out, or metapp data upgrade .*s\.xml$"),
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
