"""Environment maps: skies, rooms, scenery and lamps."""
