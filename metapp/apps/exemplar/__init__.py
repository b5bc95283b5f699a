"""The base of two applications, texture and svbrdf_stationary: pictures from noise with the statistics of an exemplar.

Read `octaves`, the sizes at which pictures are compared with an exemplar, and `exemplar_statistics`, what is compared;
then `quilts`, pictures of pieces of the exemplar, `app`, all that fits share, and `presenter`, pictures and warnings.
`options` and `recipes` serve both applications.
"""
