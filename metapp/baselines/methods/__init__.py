"""The mathematics of baselines: closed forms, transforms, codecs, densities; none knows an application."""
