"""glTF 2.0, one .glb."""

from __future__ import annotations

from data_tools.formats import MATERIALS, AssetWriter, Export


def _writer() -> AssetWriter:
    from data_tools.assets import gltf

    return gltf


EXPORT = Export("gltf", MATERIALS, _writer)
