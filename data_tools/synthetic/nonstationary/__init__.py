"""Patches of several materials, drawn by families.

In order of reading: `patch_surface` holds a patch and lays one surface on another, `shapes` gives outlines, `materials`
the layers' materials, and `weathering` dirt, rust and wear. The families are in `assemblies` (pieces put together),
`decorations` (designs) and `wear` (what time has changed).
"""
