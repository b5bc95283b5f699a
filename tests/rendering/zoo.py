"""A scene of many materials and all kinds of lights, small."""

from __future__ import annotations

from typing import Any

from data_tools.synthetic.cornell import random_scene

LAMPS = ("light", "sky", "bulb")


def zoo(size: int = 16) -> dict[str, Any]:
    """A Cornell box with textured, coated, rough, see-through and masked spheres, a point light and a sky."""
    scene = {key: value for key, value in random_scene(3).items() if not key.startswith("sphere")}
    scene["sensor"]["film"] |= {"width": size, "height": size}
    checked = {"type": "checkerboard", "to_uv": [[8.0, 0, 0], [0, 8.0, 0], [0, 0, 1.0]]}
    bsdfs: list[dict[str, Any]] = [
        {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": checked}},
        {"type": "roughplastic", "alpha": 0.2},
        {"type": "plastic"},
        {"type": "principled", "roughness": 0.4, "metallic": 0.3},
        {"type": "mask", "opacity": 0.5, "bsdf": {"type": "diffuse"}},
        {"type": "roughconductor", "alpha": 0.3},
        {"type": "roughdielectric", "alpha": 0.2},
        {"type": "dielectric"},
        {"type": "neural_svbrdf", "roughness": 0.4},
    ]
    for i, bsdf in enumerate(bsdfs):
        centre = [0.6 * (i % 3) - 0.6, 0.6 * (i // 3) - 0.7, 0.3 * (i % 2) - 0.2]
        scene[f"ball{i}"] = {"type": "sphere", "center": centre, "radius": 0.26, "bsdf": bsdf}
    scene["sky"] = {"type": "constant", "radiance": {"type": "rgb", "value": [0.1, 0.2, 0.3]}}
    scene["bulb"] = {"type": "point", "position": [0.3, 0.3, 0.8], "intensity": {"type": "rgb", "value": [0.3] * 3}}
    return scene
