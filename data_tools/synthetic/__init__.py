"""The embedded data sets, one module an application, and what they are drawn from."""

from __future__ import annotations

from metapp.registry import Registry, Synthetic

_HERE = "data_tools.synthetic"


def register(registry: Registry) -> None:
    """Add the embedded sets."""
    registry.synthetic["brdf"] = Synthetic(
        f"{_HERE}.brdf",
        "metals, plastics, paints, fabrics; 1.6 MB, as MERL 35 MB (80 + 20)",
        options=("anisotropic",),
        files=(("merl", f"{_HERE}.brdf:write_merl_files", 34_992_012),),
    )
    registry.synthetic["texture"] = Synthetic(
        f"{_HERE}.texture",
        "photos of 20 kinds of flat materials; 0.2 MB (240 + 20)",
        options=("size",),
    )
    registry.synthetic["svbrdf_stationary"] = Synthetic(
        f"{_HERE}.svbrdf_stationary",
        "flash photos of 16 of these kinds; 0.2 MB (120 + 16)",
        options=("size",),
    )
    registry.synthetic["svbrdf_nonstationary"] = Synthetic(
        f"{_HERE}.svbrdf_nonstationary",
        "maps and flash photos of 19 kinds; 0.4 MB (1,200 + 16)",
        options=("size", "photos"),
    )
    registry.synthetic["illumination"] = Synthetic(
        f"{_HERE}.illumination",
        "HDR maps of 16 kinds, photos of spheres; 0.15 MB (900 + 16)",
        options=("rows",),
    )
    registry.synthetic["transport"] = Synthetic(
        f"{_HERE}.transport",
        "light paths of Cornell boxes; 0.7 MB and 2 s each (40 + 8)",
    )
