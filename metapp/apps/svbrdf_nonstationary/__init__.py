"""Non-stationary svBRDFs: maps of a flat material from photographs under a flash (paper section 4.1.4: from one)."""
