"""Textures: a network from noise to a texture with the visual statistics of an exemplar (paper section 4.1.1).

`app` has the statistics and the loss, `presenter` pictures, `recipes` the sizes; the base of all is `apps.exemplar`.
"""
