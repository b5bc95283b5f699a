"""Scenes by others, which are data that must be checked before Mitsuba loads them.

Read `rules`, checks of a scene's dictionary, with `expansion` and `spectra`, then `loading`, scenes in Mitsuba
whose paths can be traced, and `stored_text`, scenes in the tensors of tasks.
"""
