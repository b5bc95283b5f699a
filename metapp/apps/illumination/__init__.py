"""Illumination: HDR environment maps, from themselves or from an LDR photograph of a sphere (paper section 4.1.5)."""
