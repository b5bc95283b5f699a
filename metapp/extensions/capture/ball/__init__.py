"""Light around a mirror ball, from photographs of several exposures."""
