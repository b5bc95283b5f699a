"""Render a Mitsuba 3 scene with guided paths: guided_render.py SCENE.xml PICTURE.png"""

import sys

import metapp.mitsuba  # noqa: F401  (registers metapp_guided_path; first, as it chooses mitsuba's libLLVM)

# isort: split
import mitsuba as mi

mi.set_variant("llvm_ad_rgb")
scene = mi.load_file(sys.argv[1])
picture = mi.render(scene, integrator=mi.load_dict({"type": "metapp_guided_path", "max_depth": 8}), spp=64)
mi.util.write_bitmap(sys.argv[2], picture, write_async=False)
print(f"saved {sys.argv[2]}")
