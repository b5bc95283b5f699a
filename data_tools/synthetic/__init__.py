"""The embedded data sets, one module an application, and what they are drawn from."""

from __future__ import annotations

from metapp.door import Option, Synthetic

_HERE = "data_tools.synthetic"
_SIZES = "Of texture, svbrdf_stationary (256) and svbrdf_nonstationary (128): pictures of so many px a side; of "
_SIZE = Option("size", 256, f"{_SIZES}illumination (64): maps of so many rows.", "PX", low=32, high=4096)
_PHOTOS = Option(
    "photos",
    1,
    "Of svbrdf_nonstationary: flash photos of each material, all but the first from places of their own.",
    "N",
    low=1,
    high=9,
)
_ANISOTROPIC = Option("anisotropic", False, "Of brdf: brushed metals, cloths and others that depend on phi_h.")

OFFERS = (
    Synthetic(
        "brdf",
        f"{_HERE}.brdf",
        "isotropic metals, plastics, paints, fabrics and mixtures of them, from physically based reflection models; "
        "about 1.6 MB and 0.1 s each, or 35 MB as a MERL file; 80 + 20. With --anisotropic: brushed metals, plastics, "
        "cloths, at random azimuths; two families of the tests are not in the training set.",
        (_ANISOTROPIC,),
        files=(("merl", f"{_HERE}.brdf:write_merl_files", 34_992_012),),
    ),
    Synthetic(
        "texture",
        f"{_HERE}.texture",
        "photographs of 20 families of flat materials such as bricks, weaves, wood; 0.2 MB each; 240 + 20.",
        (_SIZE,),
    ),
    Synthetic(
        "svbrdf_stationary",
        f"{_HERE}.svbrdf_stationary",
        "flash photographs of 16 of these families, with relightings for the tests; 0.2 MB; 120 + 16.",
        (_SIZE,),
    ),
    Synthetic(
        "svbrdf_nonstationary",
        f"{_HERE}.svbrdf_nonstationary",
        "maps of patches of several materials, of 19 families such as inlays, rust, puddles, and their flash "
        "photographs; 0.4 MB and 0.03 s each; 1,200 + 16.",
        (_SIZE._replace(default=128), _PHOTOS),
    ),
    Synthetic(
        "illumination",
        f"{_HERE}.illumination",
        "HDR environment maps of 16 families, outdoors and in, with photographs of spheres under them; 0.15 MB each; "
        "900 + 16.",
        (_SIZE._replace(default=64),),
    ),
    Synthetic(
        "transport",
        f"{_HERE}.transport",
        "samples of the light paths of Cornell boxes with one to five spheres and a mirror; 0.7 MB and 2 s each; "
        "40 + 8.",
    ),
)
