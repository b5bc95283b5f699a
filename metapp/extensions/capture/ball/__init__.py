"""The light around a mirror ball, read from photographs of several exposures.

`ball_geometry` says which direction each pixel of a ball mirrors; `circle` finds a ball; `ball_picture` cuts it out;
`bracket` aligns and merges exposures; `capture` goes from photographs to the light. `ball_reader` reads single
photographs as inputs of fits, `light_files` writes what `ball_command` captured by the options in `ball_options`.
"""
