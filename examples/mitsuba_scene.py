"""Render fits of three applications in one scene: mitsuba_scene.py MAPS LIGHT.exr PICTURE BRDF.safetensors...

MAPS is a folder that `--export mitsuba` wrote for an svBRDF. LIGHT.exr is map.exr in the folder of a fit of
illumination. Each BRDF.safetensors is params.safetensors in the folder of a fit of brdf, for one to three balls. These
commands make such fits of the embedded data sets:

    metapp meta svbrdf_nonstationary --recipe quick --export mitsuba
    metapp meta illumination --recipe quick
    metapp meta brdf
"""

import sys
from pathlib import Path

import metapp.mitsuba  # noqa: F401  (registers the plugins; first, as it chooses mitsuba's libLLVM)

# isort: split
import drjit as dr
import mitsuba as mi

SIZE, SAMPLES, EXPOSURE = 512, 256, 0.33  # px along a side; samples a pixel; mean of the picture
# Paths from a mirror to the sun would leave bright dots. So samples are taken in passes, and in each pass radiance is
# clamped at a multiple of white. A pixel that is brighter than this in all passes is white in the picture anyway.
PASS_SAMPLES, MAX_RADIANCE = 4, 3.0  # samples a pixel; in multiples of white
BALLS = ((0.0, -0.3, 1.0), (1.2, 0.8, 0.45), (-1.2, 0.75, 0.35))  # x, z and radius of each ball
maps, light, picture, *brdfs = map(Path, sys.argv[1:])
mi.set_variant("llvm_ad_rgb")
T = mi.ScalarTransform4f


def texture(name: str, *, raw: bool) -> dict[str, object]:
    """Return the texture of one of the material's maps, repeated side by side on the floor."""
    file = maps / f"{maps.name}_{name}.png"
    return {
        "type": "bitmap",
        "filename": str(file),
        "raw": raw,
        "wrap_mode": "mirror",
        "to_uv": T().scale([8, 8, 1]),
    }


def ball(place: tuple[float, float, float], file: Path) -> dict[str, object]:
    """Return a sphere on the floor with a fitted BRDF."""
    x, z, radius = place
    paint = {"type": "neural_brdf", "filename": str(file)}
    return {"type": "sphere", "center": [x, radius, z], "radius": radius, "bsdf": paint}


material = {
    "type": "neural_svbrdf",
    "diffuse": texture("diffuse", raw=False),
    "specular": texture("specular", raw=False),
    "roughness": texture("roughness", raw=True),
}
floor = {
    "type": "rectangle",
    "to_world": T().rotate([1, 0, 0], -90).scale(12),
    "bsdf": {"type": "normalmap", "normalmap": texture("normal_gl", raw=True), "bsdf": material},
}
camera = {
    "type": "perspective",
    "fov": 32,
    "to_world": T().look_at(origin=[0.4, 3.0, 5.4], target=[0.05, 0.72, 0], up=[0, 1, 0]),
    "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "gaussian"}},
}
scene = mi.load_dict(
    {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 3},
        "camera": camera,
        "light": {"type": "envmap", "filename": str(light), "to_world": T().rotate([0, 1, 0], 60)},
        "floor": floor,
        **{f"ball{i}": ball(place, file) for i, (place, file) in enumerate(zip(BALLS, brdfs, strict=False))},
    }
)
passes = [mi.render(scene, spp=PASS_SAMPLES, seed=i) for i in range(SAMPLES // PASS_SAMPLES)]
white = dr.mean(passes[0], axis=None) / EXPOSURE
image = sum(dr.minimum(radiance, MAX_RADIANCE * white) for radiance in passes)
image *= EXPOSURE / dr.mean(image, axis=None)
mi.util.write_bitmap(str(picture), image, write_async=False)
print(f"saved {picture}: {SIZE} x {SIZE} px, {SAMPLES} samples a pixel")
