"""The checkpoints that ship, a folder and a card for each application."""
