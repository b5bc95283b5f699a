"""Non-stationary svBRDFs from photographs by a camera that stands still under many lamps: the recipe `rti`.

Museums call it reflectance transformation imaging (Malzbender et al. 2001). `light_process` predicts photographs under
other lamps; `light_curves` has what a texel's values under all lamps tell, and `curve_network` the network that reads
maps of them, whose weights are the parameters of fits; `lit_sight` has what fits see and their loss, `lit_judge` the
outer loss, `mean_encoder` General, and `lit_augmentation` the photographs that training sees. `rti_app` is the
application, `recipe` the recipe.
"""
