"""Writers of materials and textures for other programs.

Each `write_<name>(surface, path, provenance)` writes a fitted surface as or below `path`, whose last part is its name.
"""
