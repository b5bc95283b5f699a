"""Networks that several applications share.

Read `layers` first; then `generators`, networks from noise or quilts to pictures, and `quilted`, how quilts are fetched
and corrected; `field`, a network that is evaluated at each texel, and `coded`, applications of such fields.
"""
