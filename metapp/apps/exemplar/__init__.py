"""The components of two applications, texture and svbrdf_stationary: pictures with the statistics of an exemplar.

Read `octaves`, the sizes at which pictures are compared with an exemplar, and `exemplar_statistics`, what is compared
and the judge; then `exemplar_codec`, the decoder of noise or of quilts and General's encoder, and `exemplar_sight`,
what fits see and training varies. `quilts` makes pictures of pieces of the exemplar; `presenter` has pictures and
warnings. `options` and `recipes` serve both applications.
"""
