"""Light transport: a scene's light as a density over primary sample space, to guide paths by (paper section 4.1.6).

`app` has the application. Its network is the flow in `flow`, a chain of the splines in `spline`; `scene_encoder`
predicts it from a small picture of the scene. `guide` makes tables of it, from which paths take their first direction,
`guided_pictures` measures the pictures that such paths make, and `density_pictures` draws densities; `recipes`,
`options` and `presenter` are as in every application.
"""
