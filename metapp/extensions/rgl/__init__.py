"""BRDFs in the formats of Mitsuba 3: files of the RGL material database, and scenes that show fits.

Read `tensor_file`, the container of these files; `rgl`, files as tasks and fits as files, with `spectra`, colours of
spectra and spectra of colours; then `brdf_conversion`, conversion without a fit, `brdf_scene`, scenes, and
`bsdf_converter`, the command that converts files to a data set.
"""
