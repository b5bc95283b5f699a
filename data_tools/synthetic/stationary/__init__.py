"""Families of stationary, periodic materials.

In order of reading: `periodic_maps` holds a material and the draws of its colours, `stone`, `nature`, `textile` and
`building_materials` the families, and `families` the table of all and the draws of a set's splits.
"""
