"""`metapp data upgrade`: public scenes checked, repaired and written for Mitsuba 3."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.needs_mitsuba import needs_mitsuba

CORNELL = """<scene version="0.6.0">
<integrator type="photonmapper"><integer name="maxDepth" value="6"/><integer name="photons" value="1"/></integrator>
<sensor type="perspective"><float name="fov" value="39"/>
  <transform name="toWorld"><lookAt origin="0, 1, 5" target="0, 1, 0" up="0, 1, 0"/></transform>
  <sampler type="halton"><integer name="sampleCount" value="4"/></sampler>
  <film type="hdrfilm"><integer name="width" value="16"/><integer name="height" value="16"/></film></sensor>
<bsdf type="roughdiffuse" id="grey"><float name="alpha" value="0.3"/></bsdf>
<bsdf type="diffuse" id="red"><srgb name="diffuseReflectance" value="#c02020"/></bsdf>
<shape type="rectangle"><transform name="toWorld"><rotate x="1" angle="-90"/></transform><ref id="grey"/></shape>
<shape type="rectangle"><transform name="toWorld"><translate y="1" z="-1"/></transform><ref id="red"/></shape>
<shape type="rectangle"><transform name="toWorld"><rotate x="1" angle="90"/><translate y="2"/></transform>
  <emitter type="area"><rgb name="radiance" value="9"/></emitter></shape>
</scene>"""


@pytest.fixture
def cornell(tmp_path: Path) -> Path:
    path = tmp_path / "cornell.xml"
    path.write_text(CORNELL)
    return path


@pytest.mark.long
@needs_mitsuba
def test_a_public_scene_is_checked_upgraded_and_fitted(cornell: Path, metapp: Callable) -> None:
    checked = metapp("data", "upgrade", cornell, "--dry-run")
    assert checked.code == 1
    assert "line 2: <integrator type=\"photonmapper\">: 'path' of max_depth 6" in checked.out
    assert 'line 2: <integer name="photons">: left out, version 3 has no such parameter' in checked.out
    assert "line 4: <lookAt>: <lookat>" in checked.out
    assert 'line 7: <bsdf type="roughdiffuse" id="grey">: \'diffuse\'' in checked.out
    assert checked.err.rstrip().endswith(f"leave it out, or metapp data upgrade {cornell}")
    assert [path.name for path in cornell.parent.iterdir()] == ["cornell.xml"]

    done = metapp("data", "upgrade", cornell)
    assert done.code == 0
    assert done.out == checked.out
    target = cornell.with_name("cornell-v3.xml")
    assert f"{target}: Mitsuba 3 loads it; " in done.err
    assert cornell.read_text() == CORNELL

    again = metapp("data", "upgrade", cornell)
    assert again.code == 2
    assert "cornell-v3.xml: is there already, expected a new file; add --overwrite to replace it." in again.err
    fine = metapp("data", "upgrade", target, "--dry-run")
    assert (fine.code, fine.out) == (0, "")
    assert "Mitsuba 3 loads it" in fine.err
    fit = metapp("general", "transport", target, "--quiet", "--json")
    assert fit.code == 0
    assert json.loads(fit.out.splitlines()[-1])["tasks"][0]["name"] == "cornell-v3"


@needs_mitsuba
def test_scripts_read_what_was_done(cornell: Path, metapp: Callable, tmp_path: Path) -> None:
    cornell.write_text(CORNELL.replace('type="diffuse"', 'type="coating"'))
    target = tmp_path / "out" / "new.xml"
    done = metapp("data", "upgrade", cornell, "--out", target, "--quiet", "--json")
    assert done.code == 1
    document = json.loads(done.out)
    assert (document["out"], document["loads"]) == (str(target), False)
    element = '<integrator type="photonmapper">'
    assert document["repairs"][0] == {"line": 2, "element": element, "done": "'path' of max_depth 6"}
    assert document["problem"].startswith('line 8: <bsdf type="coating" id="red">: version 3 has no layers; give')
    assert "error: " in done.err
    assert "metapp data upgrade" not in done.err
    assert target.is_file()  # to be edited


def test_misuse_is_named(cornell: Path, metapp: Callable) -> None:
    both = ("--dry-run", "--out", "a.xml")
    assert "expected one of the two; leave one out." in metapp("data", "upgrade", cornell, *both).misuse
    for name, problem in (("none.xml", "No such file"), ("box.json", "no .xml file, expected a scene in XML")):
        path = cornell.with_name(name)
        if name == "box.json":
            path.write_text("{}")
        found = metapp("data", "upgrade", path)
        assert found.code == 1
        assert problem in found.err
    same = metapp("data", "upgrade", cornell, "--out", cornell)
    assert (same.code, cornell.read_text()) == (2, CORNELL)
    assert "is there already" in same.err
