"""A photograph of a mirror ball: the ball found, and the light around it as a lat-long map."""
