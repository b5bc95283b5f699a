"""Illumination: HDR environment maps, from themselves or from the LDR photograph of a sphere (paper section 4.1.5).

`app` has the application, and `ball_encoder` the encoder that reads photographs. `mirror` is about the light that a
photographed mirror shows, `suns` about lights too small for the network, `spheres` about the surfaces that losses and
errors look at, and `map_augmentation` varies training maps; `recipes`, `options` and `presenter` are as in every
application.
"""
