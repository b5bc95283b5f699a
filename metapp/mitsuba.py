"""Plugins for Mitsuba 3: `import metapp.mitsuba`, before or after `mi.set_variant`, and scenes may name them.

    {"type": "neural_brdf", "filename": "gold.safetensors"}
    {"type": "neural_svbrdf", "diffuse": TEXTURE, "specular": TEXTURE, "roughness": TEXTURE}
    {"type": "metapp_guided_path", "max_depth": 8}

The plugins of all extensions are registered. The last one above is an integrator: Mitsuba's `path` with path guiding
that it learns while it renders; see `metapp.extensions.guided.integrator`.

In XML: `<bsdf type="neural_brdf"><string name="filename" value="gold.safetensors"/></bsdf>`. The file is a fit of the
BRDF application (`params.safetensors` in its folder, or `Fit.save`), of any of its networks, or a folder with an
NBRDF network of six .npy files. The variants are llvm_ad_rgb and cuda_ad_rgb.

Import this module before mitsuba if an old libLLVM is installed beside one that works: mitsuba keeps the one it finds
first.
"""

from __future__ import annotations

import metapp.rendering.jit  # noqa: F401  (chooses a libLLVM that works)
from metapp.registry import registry

for register in registry().load_all("plugins").values():
    register()
