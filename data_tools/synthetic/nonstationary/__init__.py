"""Patches of several materials."""
