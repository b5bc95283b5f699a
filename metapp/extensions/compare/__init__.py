"""`metapp compare`: two runs side by side."""

from metapp.door import Command

OFFERS = (Command("compare", "metapp.extensions.compare.command:command"),)
