"""Fits of a plan: one loop over all inputs."""
