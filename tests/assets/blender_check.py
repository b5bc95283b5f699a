"""What Blender makes of exports, in a Python with bpy: blender_check.py GLB FOLDER OUT.json PICTURE

It writes which files of the folder Node Wrangler wires to which socket, and pictures of the .glb as a mirror under a
white sky: PICTURE-0.exr from straight above, which is F0 texel by texel, and PICTURE-75.exr of its centre aslant.
"""

import json
import math
import sys
from pathlib import Path
from typing import NamedTuple

import bpy

SOCKETS = {  # of Node Wrangler's Principled setup, in its order, and the names of its tags
    "Displacement": ("displacement",),
    "Base Color": ("base_color",),
    "Metallic": ("metallic",),
    "Specular IOR Level": ("specular",),
    "Roughness": ("rough", "gloss"),
    "Bump": ("bump",),
    "Normal": ("normal",),
    "Transmission Weight": ("transmission",),
    "Emission Color": ("emission",),
    "Alpha": ("alpha",),
    "Ambient Occlusion": ("ambient_occlusion",),
}


class File(NamedTuple):
    """What the file dialog gives."""

    name: str


def wired(folder: Path) -> dict[str, str]:
    """The file that Node Wrangler takes for each socket."""
    import addon_utils  # bpy has put it into the path

    addon_utils.enable("node_wrangler", default_set=True)
    from node_wrangler.utils.paths import match_files_to_socket_names

    tags = bpy.context.preferences.addons["node_wrangler"].preferences.principled_tags
    rows = [[name, " ".join(getattr(tags, each) for each in of).split(" "), None] for name, of in SOCKETS.items()]
    match_files_to_socket_names([File(path.name) for path in sorted(folder.glob("*.png"))], rows)
    return {name: found for name, _, found in rows if found}


def mirror(material: bpy.types.Material) -> None:
    """Leave only F0: no body, no roughness, no relief."""
    (node,) = (each for each in material.node_tree.nodes if each.type == "BSDF_PRINCIPLED")
    for name, value in (("Base Color", (0, 0, 0, 1)), ("Roughness", 0.0), ("Normal", None)):
        for link in list(node.inputs[name].links):
            material.node_tree.links.remove(link)
        if value is not None:
            node.inputs[name].default_value = value
    for each in material.node_tree.nodes:
        if each.type == "TEX_IMAGE":
            each.interpolation = "Closest"


def render(glb: Path, picture: Path) -> dict[str, float]:
    """The picture; what stands in the Principled BSDF."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=str(glb))
    (material,) = bpy.data.materials
    mirror(material)
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("sky")
    scene.world.use_nodes = True
    background = next(each for each in scene.world.node_tree.nodes if each.type == "BACKGROUND")
    background.inputs["Color"].default_value = (1, 1, 1, 1)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.type = "ORTHO"
    scene.collection.objects.link(camera)
    scene.camera = camera
    side = next(image.size[0] for image in bpy.data.images if image.size[0])
    scene.render.engine, scene.cycles.samples, scene.cycles.filter_width = "CYCLES", 4, 0.01
    scene.cycles.use_denoising = False
    scene.render.resolution_x = scene.render.resolution_y = side
    scene.view_settings.view_transform = "Raw"
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
    for degrees in (0, 75):
        angle = math.radians(degrees)
        # the importer turns y up into z up
        camera.location = (0, -2 * math.cos(angle), 2 * math.sin(angle))
        camera.rotation_euler = (math.pi / 2 - angle, 0, 0)
        camera.data.ortho_scale = 1 if degrees == 0 else 0.1
        scene.render.filepath = f"{picture}-{degrees}.exr"
        bpy.ops.render.render(write_still=True)
    (node,) = (each for each in material.node_tree.nodes if each.type == "BSDF_PRINCIPLED")
    return {name: node.inputs[name].default_value for name in ("Metallic", "IOR", "Specular IOR Level")}


if __name__ == "__main__":
    glb, folder, told, picture = map(Path, sys.argv[1:])
    found = {"version": bpy.app.version_string, "node": render(glb, picture), "wired": wired(folder)}
    told.write_text(json.dumps(found))
