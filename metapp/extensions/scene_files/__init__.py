"""Scene files of Mitsuba as inputs of light transport."""
