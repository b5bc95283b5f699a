"""Non-stationary svBRDFs from several flash photographs with the places of camera and flash: the recipe `several`.

`parallax` finds heights, and moves photographs such that all show each point at one texel; `stereo` has photometric
stereo in closed form, and `stereo_encoder` General, a network that corrects it, for photographs in any order;
`flash_gains` finds how bright each flash is; `texel_maps` has the decoder, maps of each texel and the flash of each
photograph; `photo_set_sight` what fits see, and the loss, with General's maps as a prior; `texel_judge` the outer loss
that trains General; `newton` the rule `gauss-newton`, `integrability` how its steps keep the slopes of neighbouring
texels those of one surface; `obstructions` removes what hides the material; `photo_sets` and `handling` draw the
photographs that training sees; `recipe` has the recipe.
"""
