"""BRDFs on half and difference vectors (paper section 4.1.2).

`app` has the application. Its networks share the base class in `brdf_network`: the paper's in `nbrdf_network`, and one
of learned features in `feature_network`, which reads anisotropic materials by `anisotropic`. `sample_augmentation`
varies training materials, and `energy` limits the light that fits reflect; `recipes`, `options` and `presenter` are as
in every application. `few` has fits of 4 to 200 samples.
"""
