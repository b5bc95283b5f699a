"""BSDFs of Mitsuba 3 that are written in Python."""
