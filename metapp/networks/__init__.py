"""Networks that several applications share, and what goes with them.

Read `layers` first; then `generators`, networks from noise or quilts to pictures, and `quilted`, how quilts are fetched
and corrected; `field`, a network that is evaluated at each texel, and `coded`, applications of such fields; at last
`picture_options` and `photo_recipes`, options and recipes that these applications have in common.
"""
