"""The second scene, in which inferred illumination is judged: pictures of a known scene under inferred and true maps.

Read `geometry`, the scene; `paths`, how light reaches its pixels from each texel of a map; and `relighting`, the matrix
of these paths and pictures by it.
"""
