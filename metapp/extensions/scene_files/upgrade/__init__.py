"""Scenes of Mitsuba 0.6, and of other people's integrators, repaired for Mitsuba 3."""
