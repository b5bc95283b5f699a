"""Transport: the light of a scene as a density over primary sample space, to guide paths by (paper section 4.1.6)."""
