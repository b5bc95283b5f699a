"""The checkpoints that ship, and their card."""
