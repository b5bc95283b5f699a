"""Periodic patterns on the unit tile, from which materials are made.

In order of reading: `fields` holds noise, blurs and colour ramps, `cells` lattices and Worley noise, `strokes`
scattered fibres and blades. None of them knows a material.
"""
