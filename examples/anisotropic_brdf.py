"""Fit brushed metals of Mitsuba 3 and render them beside their fits: anisotropic_brdf.py PICTURE.png

A row for each metal: the metal itself, its fit, and its fit by a network that knows no azimuth of the half vector.
"""

import sys
import tempfile
from pathlib import Path

import metapp
import metapp.mitsuba  # registers neural_brdf; before mitsuba, as it chooses a libLLVM that works

# isort: split
import mitsuba as mi
import numpy as np

METALS = {"Cu": (0.45, 0.08), "Al": (0.06, 0.35)}  # GGX roughness along and across the tangent
SIZE, SAMPLES = 192, 256
RECIPES = ("anisotropic", "full")
mi.set_variant("llvm_ad_rgb")


def render(bsdf: object) -> np.ndarray:
    """A sphere, whose tangent is along its circles of latitude, under a lamp and a dim sky."""
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
        of_mitsuba = {"type": "roughconductor", "material": metal, "distribution": "ggx"}
        bsdf = mi.load_dict(of_mitsuba | {"alpha_u": along, "alpha_v": across})
        pictures = [render(bsdf)]
        for recipe in RECIPES:
            fit = metapp.fit("brdf", bsdf, recipe=recipe)
            file = fit.save(Path(folder) / f"{metal}-{recipe}.safetensors")
            pictures.append(render(mi.load_dict({"type": "neural_brdf", "filename": str(file)})))
            off = np.abs(pictures[-1] - pictures[0]).mean() / pictures[0].mean()
            print(f"{metal}, recipe {recipe}: error x100 {fit.error:.3f}, picture off by {100 * off:.1f} % of its mean")
        rows.append(np.concatenate(pictures, 1))
mi.util.write_bitmap(sys.argv[1], mi.Bitmap(np.concatenate(rows)), write_async=False)
print(f"saved {sys.argv[1]}")
