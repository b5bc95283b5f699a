"""The embedded data sets, one module an application, and what they are drawn from."""

from __future__ import annotations

from metapp.door import Option, Synthetic

_HERE = "data_tools.synthetic"
_SIZES = "Side of pictures; texture, svbrdf_stationary: 256, svbrdf_nonstationary: 128; rows of illumination: 64."
_SIZE = Option("size", 256, _SIZES, "PX", low=32, high=4096)
_PHOTOS = Option(
    "photos",
    1,
    "Of svbrdf_nonstationary: flash photos of each material.",
    "N",
    low=1,
    high=9,
)
_ANISOTROPIC = Option("anisotropic", False, "Of brdf: brushed metals, plastics, cloths.")

OFFERS = (
    Synthetic(
        "brdf",
        f"{_HERE}.brdf",
        "metals, plastics, paints, fabrics; 1.6 MB, as MERL 35 MB (80 + 20)",
        (_ANISOTROPIC,),
        files=(("merl", f"{_HERE}.brdf:write_merl_files", 34_992_012),),
    ),
    Synthetic(
        "texture",
        f"{_HERE}.texture",
        "photos of 20 kinds of flat materials; 0.2 MB (240 + 20)",
        (_SIZE,),
    ),
    Synthetic(
        "svbrdf_stationary",
        f"{_HERE}.svbrdf_stationary",
        "flash photos of 16 of these kinds; 0.2 MB (120 + 16)",
        (_SIZE,),
    ),
    Synthetic(
        "svbrdf_nonstationary",
        f"{_HERE}.svbrdf_nonstationary",
        "maps and flash photos of 19 kinds; 0.4 MB (1,200 + 16)",
        (_SIZE._replace(default=128), _PHOTOS),
    ),
    Synthetic(
        "illumination",
        f"{_HERE}.illumination",
        "HDR maps of 16 kinds, photos of spheres; 0.15 MB (900 + 16)",
        (_SIZE._replace(default=64),),
    ),
    Synthetic(
        "transport",
        f"{_HERE}.transport",
        "light paths of Cornell boxes; 0.7 MB and 2 s each (40 + 8)",
    ),
)
