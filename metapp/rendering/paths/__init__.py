"""Light paths by their random numbers."""
