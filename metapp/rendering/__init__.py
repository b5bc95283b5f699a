"""All that drives Mitsuba."""
