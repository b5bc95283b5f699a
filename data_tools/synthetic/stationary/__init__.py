"""Families of stationary, periodic materials."""
