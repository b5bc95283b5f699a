"""Measures of the field, of pictures of fits beside the references: LPIPS, DISTS, PSNR and more."""
