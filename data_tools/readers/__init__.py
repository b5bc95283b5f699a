"""Readers and writers of files, one module a format.

To read in this order: `listing` finds files in folders and `input_source` says what a reader finds; `image_files`,
`colours`, `lenses`, `camera_raws` and `numbers`, `arrays` read pictures from files and from memory; all other modules
make the tasks of a format of them.
"""
