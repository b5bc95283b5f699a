"""Fitted materials and textures as other programs take them: glTF, USD, MaterialX, Mitsuba, Blender, pictures."""

from __future__ import annotations

from metapp.registry import Export, Registry

_MATERIALS = ("svbrdf_stationary", "svbrdf_nonstationary")  # applications whose fits are maps of a material
_HERE = "metapp.extensions.assets"


def register(registry: Registry) -> None:
    """Add the exports."""
    for app in (*_MATERIALS, "texture"):
        registry.exports[app, "asset"] = Export(f"{_HERE}.pictures:write_asset", of_surface=True)
        registry.exports[app, "exr"] = Export(f"{_HERE}.pictures:write_exr", of_surface=True)
        registry.exports[app, "png16"] = Export(f"{_HERE}.pictures:write_png16", of_surface=True)
    for app in _MATERIALS:
        registry.exports[app, "blender"] = Export(f"{_HERE}.pictures:write_blender", of_surface=True)
        registry.exports[app, "gltf"] = Export(f"{_HERE}.gltf:write_gltf", of_surface=True)
        registry.exports[app, "materialx"] = Export(f"{_HERE}.materialx:write_materialx", of_surface=True)
        registry.exports[app, "mitsuba"] = Export(f"{_HERE}.mitsuba:write_mitsuba", of_surface=True)
        registry.exports[app, "usd"] = Export(f"{_HERE}.usd:write_usd", of_surface=True, needs=("pxr", "usd-core"))
