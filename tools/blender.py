"""Render a .glb file of docs/formats-assets.md by Blender's Cycles: blender.py FILE.glb PICTURE.png; it needs bpy."""

from __future__ import annotations

import math
import sys

import bpy

glb, picture = sys.argv[1:]
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.import_scene.gltf(filepath=glb)  # a square of side 1 that faces -y
scene = bpy.context.scene
camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
camera.location, camera.rotation_euler = (0, -1.1, -0.9), (math.radians(129), 0, 0)
lamp = bpy.data.objects.new("lamp", bpy.data.lights.new("lamp", "AREA"))
lamp.location, lamp.rotation_euler = (0.2, -0.5, 0.9), (math.radians(30), 0, math.radians(10))
lamp.data.energy, lamp.data.size = 12, 0.1
for scene_object in (camera, lamp):
    scene.collection.objects.link(scene_object)
scene.camera, scene.render.engine, scene.cycles.samples = camera, "CYCLES", 128
scene.render.resolution_x, scene.render.resolution_y = 512, 512
scene.render.filepath = picture
bpy.ops.render.render(write_still=True)
