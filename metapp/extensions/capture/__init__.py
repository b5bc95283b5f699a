"""Light and materials captured by hand: a mirror ball at several exposures, flat materials in a sheet of markers."""
