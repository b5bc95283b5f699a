"""Fitted materials and textures as other programs take them: glTF, USD, MaterialX, Mitsuba, Blender, pictures."""

from __future__ import annotations

from metapp.door import Export

_MATERIALS = ("svbrdf_stationary", "svbrdf_nonstationary")  # applications whose fits are maps of a material
_FLAT = (*_MATERIALS, "texture")
_HERE = "metapp.extensions.assets"

OFFERS = (
    Export("asset", _FLAT, f"{_HERE}.pictures:write_asset", of_surface=True),
    Export("blender", _MATERIALS, f"{_HERE}.pictures:write_blender", of_surface=True),
    Export("exr", _FLAT, f"{_HERE}.pictures:write_exr", of_surface=True),
    Export("gltf", _MATERIALS, f"{_HERE}.gltf:write_gltf", of_surface=True),
    Export("materialx", _MATERIALS, f"{_HERE}.materialx:write_materialx", of_surface=True),
    Export("mitsuba", _MATERIALS, f"{_HERE}.mitsuba:write_mitsuba", of_surface=True),
    Export("png16", _FLAT, f"{_HERE}.pictures:write_png16", of_surface=True),
    Export("usd", _MATERIALS, f"{_HERE}.usd:write_usd", of_surface=True, needs=("pxr", "usd-core")),
)
