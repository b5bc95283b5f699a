"""The base of two applications, texture and svbrdf_stationary: pictures from noise with the statistics of an exemplar.

Read `octaves`, the sizes at which pictures are compared with an exemplar, and `exemplar_statistics`, what is compared;
then `app`, what all fits share, `quilts`, pictures of pieces of the exemplar, `quilted_app`, fits whose networks change
quilts, and `presenter`, pictures and warnings.
`options` and `recipes` serve both applications.
"""
