"""Textures: a network from noise to a texture with the visual statistics of an exemplar (paper section 4.1.1).

`app` has the statistics and the loss, `quilted` textures of pieces of the photograph, `presenter` pictures, `recipes`
the sizes. The base of all is in `metapp.apps.exemplar`, and so are the options.
"""
