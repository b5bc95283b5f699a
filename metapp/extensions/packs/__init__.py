"""The fits of a run as one small file, and back."""

from metapp.door import Command

_HERE = "metapp.extensions.packs.commands"
OFFERS = (Command("pack", f"{_HERE}:pack_command"), Command("unpack", f"{_HERE}:unpack_command"))
