"""Geometry, reflection, photographs, colour, error measures and image features: the physics and the looks of fits.

Read `geometry` and `reflection`, how surfaces reflect; `svbrdf_maps` and `height_fields`, flat materials;
`flash`, `flash_search`, `highlight` and `surface`, how these look under a flash; `latlong`, `sphere` and
`photograph`, environment maps and spheres; `colour` and `colorimetry`, colours; and `metrics`, `features`, `lattice`
and `lines`, what pictures are compared by. Then read `pictures`, `presenter`, `picture_measures` and `uniform`, what
applications show and warn of. `lobes`, `quilting` and `stretch` are methods of their own.
"""
