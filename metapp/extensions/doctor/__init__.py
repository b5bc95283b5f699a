"""What this installation has and lacks."""

from metapp.door import Command

OFFERS = (Command("doctor", "metapp.extensions.doctor.commands:command"),)
