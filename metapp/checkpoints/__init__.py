"""The checkpoints that ship, in a folder with a card for each application.

This package has no code; `metapp.storage.shipped_checkpoints` finds its files.
"""
