"""The mathematics of peers: closed forms, transforms, codecs, densities; none knows an application."""
