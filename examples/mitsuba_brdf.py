"""Fit a BRDF and render it with Mitsuba 3: mitsuba_brdf.py MATERIAL.binary PICTURE.png

To make a MERL file to try it on: metapp data synth brdf --count 1 --as merl --out materials
"""

import sys
import tempfile
from pathlib import Path

import metapp
import metapp.mitsuba  # registers neural_brdf; imported first, as it chooses mitsuba's libLLVM

# isort: split
import mitsuba as mi

material, picture = sys.argv[1:]
fit = metapp.fit("brdf", material)
print(f"{fit.name}: error x100 {fit.error:.3f} after {fit.seconds:.3f} s")

mi.set_variant("llvm_ad_rgb")
with tempfile.TemporaryDirectory() as folder:
    file = fit.save(Path(folder) / "fit.safetensors")
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path"},
            "sensor": {
                "type": "perspective",
                "fov": 30,
                "to_world": mi.ScalarTransform4f().look_at(origin=[0, 0, 5], target=[0, 0, 0], up=[0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 512, "height": 512},
            },
            "sky": {"type": "constant", "radiance": 0.3},
            "lamp": {
                "type": "sphere",
                "center": [-4, 5, 5],
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [40, 38, 35]}},
            },
            "ball": {"type": "sphere", "bsdf": {"type": "neural_brdf", "filename": str(file)}},
        }
    )
    mi.util.write_bitmap(picture, mi.render(scene, spp=64), write_async=False)
print(f"saved {picture}")
