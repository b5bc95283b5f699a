"""Textures: a network from noise to a texture with the visual statistics of an exemplar (paper section 4.1.1).

`app` has the statistics and the loss, `presenter` pictures, `recipes` the sizes. The base of all is in
`metapp.apps.exemplar`, and so are the options.
"""
