"""Stationary svBRDFs: a network from noise to maps that look like a flash photo under its light (paper section 4.1.3).

Read `windows`, statistics in parts of a picture, and `flash_statistics`, what describes a flash photo; then `app`, maps
and losses, `quilted`, maps of pieces of the photo, and `presenter`, pictures. `options` and `recipes` are as in every
application. The base of all is in `metapp.apps.exemplar`.
"""
