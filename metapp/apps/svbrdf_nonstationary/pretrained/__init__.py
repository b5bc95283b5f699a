"""Non-stationary svBRDFs from one flash photograph by frozen features of VGG-16: the recipe `pretrained`.

`encoder` has General: a small reader of features of VGG-16. `patch` describes the whole patch: an overview, from which
gloss is read, and the maps of General by the recipe `full`, whose flash it takes over; train it anew where that one is.
`highlight_roughness` reads the roughness of polished surfaces off a sharp highlight. `ensemble_maps` has the decoder of
maps, the mean of the fields of both networks; steps change the code of `full` and the flash alone, so that normals stay
General's. `feature_sight` has the loss, in which texels beneath highlights count less, and removes `scars`;
`feature_judge` has the outer loss; `augmentation` draws photographs of patches to train by; `recipe` has the recipe.
"""
