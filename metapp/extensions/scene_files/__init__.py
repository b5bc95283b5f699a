"""Scene files of Mitsuba as inputs of light transport, read without trusting them.

Read `scene_reader`, scenes as tasks; `xml`, documents as dictionaries; `scene_places` with `data_files`, the
files that a scene may name; then `trial_loading`, which loads a scene in a process of its own first.
"""
