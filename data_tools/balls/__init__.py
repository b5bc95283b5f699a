"""Photographs of a mirror ball: the ball found, exposures merged, and the light around it as a lat-long map."""
