"""Procedural environment maps.

In order of reading: `patterns` has noises and colours of light, `scene_geometry` holds scenes and intersects them with
rays, `surfaces` and `emitters` say how surfaces look and what sends light, `light` renders a map; `sky` and `backdrop`
draw what is far away, `fittings` and `scenery` what is near, and `indoor` and `outdoor` whole scenes of a family.
"""
