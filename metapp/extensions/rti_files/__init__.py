"""Exports of objects that were photographed under many lamps (RTI), as files that viewers of such objects relight.

`ptm_file` writes Polynomial Texture Maps, `relight_folder` folders of the program Relight.
"""
