"""Writers of materials and textures for other programs, one module a kind of file.

Each has `write(surface, path, provenance)`: it writes a fitted surface as or below `path`, whose last part is the
asset's name.
"""
