"""Measures by which the field compares pictures of fits with references: LPIPS, DISTS, PSNR and more.

Read `pixels`, measures of each pixel by itself; `perceptual`, distances of features of VGG-16; then `textures`,
measures of textures whose pixels need not lie where the exemplar has them.
"""
