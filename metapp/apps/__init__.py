"""The applications that ship, a package each, whose function `register` adds the application to the registry.

In each package `app` has the class of fits, `recipes` the recipes, `presenter` what people look at and `options`, if
there is one, its own options. Begin with `brdf`; `exemplar` is the base of `texture` and `svbrdf_stationary`;
`svbrdf_nonstationary`, `illumination` and `transport` stand alone. `picture_options` and `photo_recipes` have options
and recipes that several applications share.
"""
