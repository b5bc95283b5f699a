"""Rendering by Mitsuba, which light transport, the errors of illumination and plugins of extensions need.

Read `variant`, which Mitsuba is loaded with; `jit` and `types`, its modules and the names of its types; `scenes`,
scenes by others; `paths`, light paths by their random numbers; `pictures`, pictures by any integrator; and
`second_scene`, the scene in which inferred illumination is judged.
"""
