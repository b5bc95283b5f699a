"""Fits as BSDFs of Mitsuba 3."""
