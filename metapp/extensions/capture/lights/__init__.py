"""Directions of the light, read from photographs of a glossy ball by a camera that stands still.

`ball_search` finds balls by all photographs, and `rim` their contours to a fraction of a pixel. `highlights` reads the
direction to the lamp off a ball. `lamps` brings two balls together and tells how far the lamp is. `shading` tells
directions that the shading of the scene contradicts. `lit_photos` reads photographs and calls these in order,
`light_text` writes what was found, `found_lights` says what was left out for `lights_command`, whose options are in
`lights_options`.
"""
