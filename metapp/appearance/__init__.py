"""Geometry, reflection, photographs, colour, metrics and image features."""
