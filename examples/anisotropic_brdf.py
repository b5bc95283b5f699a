"""Fit brushed metals of Mitsuba 3 and render them beside their fits: anisotropic_brdf.py PICTURE.png

The picture has a row for each metal: the metal itself, its fit, and its fit by recipe full, whose network does not know
the azimuth of the half vector, and so makes every material isotropic.
"""

import sys
import tempfile
from pathlib import Path

import metapp
import metapp.mitsuba  # registers neural_brdf; imported first, as it chooses mitsuba's libLLVM

# isort: split
import mitsuba as mi
import numpy as np

METALS = {"Cu": (0.45, 0.08), "Al": (0.06, 0.35)}  # GGX roughness along and across the tangent
SIZE, SAMPLES = 192, 256  # px along a side; samples a pixel
RECIPES = ("anisotropic", "full")
mi.set_variant("llvm_ad_rgb")


def render(bsdf: object) -> np.ndarray:
    """Render a sphere of a material under a lamp and a dim sky; its tangent follows the circles of latitude."""
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path"},
            "sensor": {
                "type": "perspective",
                "fov": 26,
                "to_world": mi.ScalarTransform4f().look_at(origin=[0, -5, 1.5], target=[0, 0, 0], up=[0, 0, 1]),
                "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE},
            },
            "sky": {"type": "constant", "radiance": 0.15},
            "lamp": {
                "type": "sphere",
                "center": [-4, -5, 5],
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [45, 43, 40]}},
            },
            "ball": {"type": "sphere", "bsdf": bsdf},
        }
    )
    return np.array(mi.render(scene, spp=SAMPLES))


rows = []
with tempfile.TemporaryDirectory() as folder:
    for metal, (along, across) in METALS.items():
        conductor = {"type": "roughconductor", "material": metal, "distribution": "ggx"}
        bsdf = mi.load_dict(conductor | {"alpha_u": along, "alpha_v": across})
        pictures = [render(bsdf)]
        for recipe in RECIPES:
            fit = metapp.fit("brdf", bsdf, recipe=recipe)
            file = fit.save(Path(folder) / f"{metal}-{recipe}.safetensors")
            pictures.append(render(mi.load_dict({"type": "neural_brdf", "filename": str(file)})))
            difference = np.abs(pictures[-1] - pictures[0]).mean() / pictures[0].mean()
            words = f"picture differs by {100 * difference:.1f} % of its mean"
            print(f"{metal}, recipe {recipe}: error x100 {fit.error:.3f}, {words}")
        rows.append(np.concatenate(pictures, 1))
mi.util.write_bitmap(sys.argv[1], mi.Bitmap(np.concatenate(rows)), write_async=False)
print(f"saved {sys.argv[1]}")
