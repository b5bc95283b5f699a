"""Geometry, reflection, photographs, colour, metrics and image features; the presentation of applications."""
