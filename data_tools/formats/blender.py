"""Pictures that Blender's Node Wrangler wires."""

from __future__ import annotations

from data_tools.formats import MATERIALS, AssetWriter, Export


def _writer() -> AssetWriter:
    from data_tools.assets import blender

    return blender


EXPORT = Export("blender", MATERIALS, _writer)
