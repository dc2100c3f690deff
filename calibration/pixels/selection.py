"""Which pixels a fit uses: those the beam reaches and a ring around them, unless hidden."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Array, Bool, Float
from scipy import ndimage

from calibration.pixels.chunks import Chunk, Problem
from calibration.pixels.data import Footage
from calibration.pixels.squares import SquareChooser, chunked, seen
from optics import InputError
from optics.wall_light import LensTable

_GRID_PX = 4  # step of the search for pixels that the beam reaches
_RING_PX = 8
_NAMED = 10  # frames that an error message names
_RING_SIGMAS = 4
_LIT = 1e-3  # fraction of a frame's peak above which a pixel counts as lit by the beam
_MARGIN_PX = {True: 10.0, False: 3.0}  # around the instrument; larger while its pose is a guess


def bright_spot(footage: Footage) -> tuple[Float[np.ndarray, "2"], float]:
    """Centre (px) and typical radius (px) of the pixels much brighter than the frame's median.

    Raises:
        InputError: a frame has no such pixels.
    """
    dark = np.median(footage.light, axis=(1, 2), keepdims=True)
    excess = np.maximum(footage.light - dark, 0)
    peak = np.quantile(excess, 0.999, axis=(1, 2), keepdims=True)
    excess = np.where(excess > peak / 2, excess, 0)
    faint = peak.ravel() <= 4 * np.sqrt(footage.noise.variance(dark.min()))
    if faint.any():
        frames = ", ".join(map(str, np.flatnonzero(faint)[:_NAMED]))
        more = f" and {faint.sum() - _NAMED} more" if faint.sum() > _NAMED else ""
        raise InputError(
            f"the frames {frames}{more} show no spot. Leave them out of the image fit."
        )
    weight = excess.sum(axis=0)
    v, u = np.mgrid[: weight.shape[0], : weight.shape[1]]
    centre = np.array([np.sum(u * weight), np.sum(v * weight)]) / np.sum(weight)
    areas = np.count_nonzero(excess, axis=(1, 2))
    return centre, float(np.sqrt(np.median(areas) / np.pi))


def chosen_chunks(
    footage: Footage,
    problem: Problem,
    table: LensTable | None,
    x: Array,
    *,
    frames: Sequence[int],
    coarse: bool,
    stride: int,
    nearest: float,
) -> list[Chunk]:
    """Select pixels of frames, with their light and weight.

    Args:
        footage: the frames.
        problem: the fit; its blur is applied to the frames.
        table: light of the lens; None for a cone.
        x: current parameters.
        frames: numbers of the frames, in order.
        coarse: whether `x` is only a guess. If so, the noise follows from the measured light
            instead of the model.
        stride: step between selected pixels along u and v, px; for a lens, the side of the squares
            of a coarse fit.
        nearest: least distance from the tip's plane at which the model is valid, mm.
    """
    if table is not None:
        chooser = SquareChooser(
            footage,
            problem,
            table,
            x,
            nearest=nearest,
            lit=_LIT,
            margin_px=_MARGIN_PX[coarse],
            guess=coarse,
        )
        return chooser.equal_chunks(frames, stride) if coarse else chooser.chunks(frames)
    blur = 0.0 if problem.blur is None else float(problem.blur)
    chunks: list[Chunk] = []
    for frame in frames:
        v, u = np.nonzero(_reached(footage, problem, table, x, frame, blur))
        pixels = np.stack([u, v], axis=-1).astype(float)
        view = seen(footage, problem, table, x, frame, pixels)
        usable = np.asarray(view.along) > nearest
        if footage.in_view:
            usable &= ~footage.instrument.hides(
                np.asarray(view.point),
                np.asarray(view.sight),
                tip=np.asarray(view.tip),
                axis=np.asarray(view.axis),
                margin=_MARGIN_PX[coarse] * float(problem.microscope.scale),
            )
        model, light = np.asarray(view.light), footage.light[frame]
        if coarse:
            usable &= footage.clear[frame][v, u]
        else:
            usable &= footage.noise.is_clear(model)
        if blur:
            light, whole = _blurred(light, (v[usable], u[usable]), blur)
            usable &= whole[v, u]
        usable &= (u % stride == 0) & (v % stride == 0)
        level = light[v, u].astype(float)
        variance = footage.noise.variance(level if coarse else model)
        variance += footage.edge_variance * np.square(view.step)
        weight = 1.0 / np.sqrt(variance)
        sides = np.ones(np.count_nonzero(usable))
        chunks += chunked(footage, frame, pixels[usable], sides, level[usable], weight[usable])
    return chunks


def _reached(
    footage: Footage,
    problem: Problem,
    table: LensTable | None,
    x: Array,
    frame: int,
    blur: float,
) -> Bool[np.ndarray, "h w"]:
    """Pixels that the beam reaches, and a ring around them."""
    height, width = footage.light.shape[1:]
    v, u = np.mgrid[0:height:_GRID_PX, 0:width:_GRID_PX]
    pixels = np.stack([u.ravel(), v.ravel()], axis=-1).astype(float)
    direct = np.asarray(seen(footage, problem, table, x, frame, pixels).direct).reshape(u.shape)
    dark = ~(direct > _LIT * direct.max())
    ring = max(_RING_PX, _RING_SIGMAS * blur) + _GRID_PX
    near = ndimage.distance_transform_edt(dark) * _GRID_PX <= ring
    return np.kron(near, np.ones((_GRID_PX, _GRID_PX), bool))[:height, :width]


def _blurred(
    light: Float[np.ndarray, "h w"], usable: tuple[np.ndarray, np.ndarray], sigma: float
) -> tuple[Float[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """Light blurred over usable pixels, and where these have more than half of the weight."""
    part = np.zeros(light.shape)
    part[usable] = 1.0
    weight = ndimage.gaussian_filter(part, sigma)
    mean = ndimage.gaussian_filter(part * light, sigma) / np.maximum(weight, 1e-12)
    return mean, weight > 0.5
