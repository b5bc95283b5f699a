"""Fitted maps as EXR."""

from __future__ import annotations

from data_tools.formats import MATERIALS, TEXTURES, AssetWriter, Export


def _writer() -> AssetWriter:
    from data_tools.assets import exr

    return exr


EXPORT = Export("exr", MATERIALS + TEXTURES, _writer)
