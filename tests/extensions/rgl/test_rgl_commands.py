"""Exports of a run to RGL files, which Mitsuba loads, and the core without the extension."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from metapp.registry import WITHOUT_VARIABLE
from tests.needs_mitsuba import needs_mitsuba

pytestmark = pytest.mark.usefixtures("small_spheres")
NETWORKS = 1


@pytest.mark.long
@needs_mitsuba
def test_scenes_load_and_show_the_same(metapp: Callable, fit_networks: Callable) -> None:
    """A new process, as a user's script would, renders the fit and the table that Mitsuba knows."""
    run = fit_networks("meta", "--rule", "meta-curvature")
    assert metapp("export", run, "mitsuba").code == 0
    lines = """
import json, sys, numpy
import metapp.mitsuba, mitsuba
mitsuba.set_variant("llvm_ad_rgb")
scenes = (mitsuba.load_file(name) for name in sys.argv[1:])
print(json.dumps([numpy.array(mitsuba.render(scene)).mean((0, 1)).tolist() for scene in scenes]))
"""
    scenes = [run / "m0" / "mitsuba" / "m0" / f"m0{suffix}.xml" for suffix in ("", "_builtin")]
    process = subprocess.run([sys.executable, "-c", lines, *scenes], capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr
    fit, table = json.loads(process.stdout)
    np.testing.assert_allclose(fit, table, rtol=0.01)


def test_without_the_extension_its_command_is_refused_and_others_work(
    metapp: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    Path("a.bsdf").write_bytes(b"tensor_file")
    monkeypatch.setenv(WITHOUT_VARIABLE, "rgl")
    assert "No such command 'bsdf'" in metapp("data", "bsdf", "a.bsdf").misuse
    forms = "cpp, glsl, hlsl, materialx, merl, nbrdf, osl, wgsl"
    assert f"brdf expects one of {forms}" in metapp("meta", "brdf", "--export", "bsdf").misuse
    assert "a.bsdf" in metapp("meta", "brdf", "a.bsdf").refusal
