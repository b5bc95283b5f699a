"""Non-stationary svBRDFs from several flash photographs with the places of camera and flash: the recipe `several`.

`encoder` has General, photometric stereo in closed form and a network that corrects it, for photographs in any order;
`alignment` moves photographs such that all show each point of the surface at one texel; `app` has fits, maps of each
texel and the flash of each photograph with General's maps as a prior; `newton` the rule `gauss-newton`, `integrability`
how its steps keep the slopes of neighbouring texels those of one surface; `recipe` the recipe.
"""
