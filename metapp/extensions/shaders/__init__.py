"""Fitted BRDFs as source code of shaders: one file without data beside it, with eval, sample and pdf."""

from __future__ import annotations

from metapp.registry import Export, Registry

_HERE = "metapp.extensions.shaders.files"
NBRDF = ("w1", "b1", "w2", "b2", "w3", "b3")  # 675 weights; other networks are distilled into it


def register(registry: Registry) -> None:
    """Add a form for each language."""
    for name in ("cpp", "glsl", "hlsl", "materialx", "osl", "slang", "wgsl"):
        registry.exports["brdf", name] = Export(f"{_HERE}:write_{name}", holds=NBRDF)
