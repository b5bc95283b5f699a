"""Exports of fitted materials and textures as files that other programs read.

`planes` collects the maps of a surface, with `occlusion` for ambient occlusion; `surface_pictures` writes them as image
files; `gltf`, `usd`, `materialx` and `mitsuba_surfaces` write one file format each.
"""
