"""Scenes of Mitsuba 0.6, and of other people's integrators, repaired for Mitsuba 3."""

from metapp.door import Command

OFFERS = (Command("upgrade", "metapp.extensions.scene_upgrade.command:upgrade", under="data", bare_is_help=True),)
