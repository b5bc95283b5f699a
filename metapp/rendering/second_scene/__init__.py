"""The second scene, in which inferred illumination is judged."""
