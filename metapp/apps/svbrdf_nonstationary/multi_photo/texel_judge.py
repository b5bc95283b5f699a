"""The outer loss of maps of texels, by which General's encoder for several photographs is trained."""

from __future__ import annotations

from typing import Any

from torch import Tensor
from typing_extensions import override

from metapp.appearance.svbrdf_maps import unpack_maps
from metapp.apps.svbrdf_nonstationary.map_judge import LitMaps, MapJudge, log_radiance_difference
from metapp.apps.svbrdf_nonstationary.maps import encode_maps, find_slopes, map_differences
from metapp.apps.svbrdf_nonstationary.multi_photo.texel_maps import TexelFit

# Weights in the outer loss of mean |differences|: of roughness the weight is 1
RADIANCE_WEIGHT = 0.5  # of log radiance under random lights
NORMAL_WEIGHT = 2.0  # of normals
TILT_WEIGHT, LEVEL_TILT = 0.15, 0.03  # of normals over the tilt of true ones, so that low relief counts, too
SLOPE_WEIGHT = 0.5  # of slopes
DIFFUSE_WEIGHT, SPECULAR_WEIGHT = 0.7, 0.5  # of colours at gamma 2.2
LIKELIHOOD_WEIGHT = 0.05  # of the negative log likelihood of the errors of General's maps, given the predicted scales


class TexelJudge(MapJudge):
    """The judge of maps of several photographs."""

    @override
    def outer_loss(self, answer: TexelFit, seen: Any, truth: LitMaps) -> Tensor:
        """Return differences between fitted and true maps, weighted, and a term that trains General's prior: sums [T].

        The last term trains nothing but the scales that General predicts with its maps: it is the negative log
        likelihood of the errors of these maps, if each error has a Laplace distribution of the predicted scale.
        """
        maps, target, prior = answer.maps, unpack_maps(truth.maps), answer.prior
        differences = map_differences(maps, target)
        diffuse, specular, roughness, normal = (difference.abs().mean((1, 2, 3)) for difference in differences)
        slope_error = (find_slopes(maps.normal) - find_slopes(target.normal)).abs().mean((1, 2, 3))
        mean_tilt = target.normal[:, :2].abs().sum(1).mean((1, 2)) / 3
        loss = RADIANCE_WEIGHT * log_radiance_difference(maps, target, truth.pairs)
        loss = loss + NORMAL_WEIGHT * normal + TILT_WEIGHT * normal / (mean_tilt + LEVEL_TILT)
        loss = loss + SLOPE_WEIGHT * slope_error + DIFFUSE_WEIGHT * diffuse + SPECULAR_WEIGHT * specular + roughness
        assert prior is not None  # fits that are trained begin at General's maps
        mean, log_scale = prior.chunk(2, 1)
        negative_log_likelihood = (mean - encode_maps(target)).detach().abs() * (-log_scale).exp() + log_scale
        return loss + LIKELIHOOD_WEIGHT * negative_log_likelihood.mean((1, 2, 3))
