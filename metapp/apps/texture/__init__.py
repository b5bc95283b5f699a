"""Textures: a network from noise to a texture with the visual statistics of an exemplar (paper section 4.1.1)."""
