"""Two spheres on a floor, before a camera: the second scene without its light.

The numbers are the scene's definition; matrices in the cache depend on them, see `relighting.MATRIX_VERSION`.
"""

from __future__ import annotations

from metapp.rendering.scenes.rules import box_film
from metapp.rendering.types import Mitsuba

PICTURE_HEIGHT_PX, PICTURE_WIDTH_PX = 64, 96  # height and width of the picture, px
FLOOR_ALBEDO, MATTE_ALBEDO, GLOSSY_REFLECTANCE = 0.5, 0.7, 0.9  # the same for each colour channel
GLOSSY_ALPHA = 0.12  # GGX roughness of the glossy sphere
MATTE_CENTRE, GLOSSY_CENTRE = (-1.15, 1.0, 0.0), (1.15, 1.0, 0.0)  # both spheres have radius 1; y = 0 is the floor
CAMERA_POSITION, CAMERA_TARGET = (0.0, 4.6, 9.0), (0.0, 0.75, 0.1)
CAMERA_FOV_DEGREES = 32.0  # field of view across the picture's width


def second_scene_dict(mi: Mitsuba) -> dict[str, object]:
    """Return the scene without a light, as an argument of Mitsuba's `load_dict`, with Mitsuba's matrices."""
    frame = mi.ScalarTransform4f()
    pose = frame.look_at(origin=CAMERA_POSITION, target=CAMERA_TARGET, up=[0, 1, 0])
    glossy = {"type": "roughconductor", "material": "none", "distribution": "ggx", "alpha": GLOSSY_ALPHA,
              "specular_reflectance": GLOSSY_REFLECTANCE}  # fmt: skip
    diffuse = {"type": "diffuse", "reflectance": FLOOR_ALBEDO}
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 16},
        "sensor": {
            "type": "perspective",
            "fov": CAMERA_FOV_DEGREES,
            "to_world": pose,
            "film": box_film(PICTURE_WIDTH_PX, PICTURE_HEIGHT_PX),
        },
        "floor": {"type": "rectangle", "to_world": frame.rotate([1, 0, 0], -90).scale(1000), "bsdf": diffuse},
        "matte": {"type": "sphere", "center": MATTE_CENTRE, "bsdf": diffuse | {"reflectance": MATTE_ALBEDO}},
        "glossy": {"type": "sphere", "center": GLOSSY_CENTRE, "bsdf": glossy},
    }
