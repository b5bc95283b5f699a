"""Geometry, reflection, photographs, colour, error measures and image features: the physics and the looks of fits.

Read `geometry` and `reflection`, how surfaces reflect; `flash`, `highlight` and `surface`, flat materials under a
flash; `latlong`, `sphere` and `photograph`, environment maps and spheres; `colour` and `colorimetry`, colours; and
`metrics`, `features`, `lattice` and `lines`, what pictures are compared by. Then read `pictures`, `presenter`,
`picture_measures` and `uniform`, what applications show and warn of. `lobes`, `quilting` and `stretch` are methods of
their own.
"""
