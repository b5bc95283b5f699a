"""BRDFs from 4 to 200 measured pairs of directions: the recipe `few`, and which pairs to measure.

`network` has linear Gaussian models of log reflectance, one for each kind of materials; `app` the application and the
recipe; `design` the error that samples leave, and the directions that lower it most. `metapp.cli.plan` is its command.
"""
