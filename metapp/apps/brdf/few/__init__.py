"""BRDFs from 4 to 200 measured pairs of directions: the recipe `few`, and which pairs to measure.

`gaussian_model` has the network, linear Gaussian models of log reflectance, one for each kind of materials; `design`
the error that samples leave, and the directions that lower it most; `app` the application and the recipe. The command
that plans measurements is in `metapp.extensions.plan`.
"""
