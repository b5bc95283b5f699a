"""Periodic patterns that materials are made of."""
