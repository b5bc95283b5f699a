"""Checkpoints: those that ship, those that were trained here, and training."""
