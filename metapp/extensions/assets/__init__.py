"""Fitted materials and textures as other programs take them: glTF, USD, MaterialX, Mitsuba, Blender, pictures."""
