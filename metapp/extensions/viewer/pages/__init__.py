"""Views of the applications that ship, each of which is the `page` of an application.

Read `brdf` with `anisotropic_residual`, networks and samples; `flat`, textures and maps of surfaces; `illumination`,
light maps; then `transport`, scenes.
"""
