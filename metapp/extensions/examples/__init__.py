"""Commands that work as they are, and the input files that they name."""

from metapp.door import Command

OFFERS = (Command("examples", "metapp.extensions.examples.commands:command"),)
