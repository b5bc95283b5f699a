"""Scenes of others: checked, and loaded by Mitsuba."""
