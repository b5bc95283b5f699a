"""The core without the extension."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from metapp.registry import WITHOUT


def test_without_it_surfaces_have_no_exports_and_brdfs_keep_theirs(
    metapp: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(WITHOUT, "assets")
    assert "texture has none; leave it out" in metapp("meta", "texture", "--export", "png16").misuse
    forms = "bsdf, bsdf-spectral, cpp, glsl, hlsl, materialx, merl, mitsuba, nbrdf, onnx, osl, slang, wgsl"
    assert f"brdf expects one of {forms}" in metapp("meta", "brdf", "--export", "png16").misuse
