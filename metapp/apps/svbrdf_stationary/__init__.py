"""Stationary svBRDFs: a network from noise to maps that look as a flash photo under its light (paper section 4.1.3)."""
