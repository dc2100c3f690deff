"""Whether a pose explains its frame, and what is stated of it."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from estimator.distance import Range, RangeFlag, TipPose, WallMemory
from estimator.image import Outline
from estimator.pixels.ambient import ambient_covariance
from estimator.pixels.belief import Belief
from estimator.pixels.bend import bend_covariance
from estimator.pixels.drift import drift_covariance
from estimator.pixels.edge_shift import edge_covariance
from estimator.pixels.frame_model import contrast, lit
from estimator.pixels.saturation import halo

_MISFIT = 4.0  # chi squared per cell above which the light is not the beam's on this wall
_SIZE = (1.5, 1.1)
"""Ratio of the spot's area to that of the fitted light, above which the light is another one, for
light without and with a sharp edge. The contour of a bell on a textured wall leaves 10 to 20 %,
that of a blurred edge up to 8 %."""
_BRIGHT_SIZE = 1.25
"""The same for the outline of something bright, which is good to 3 px."""
_VISIBLE = 0.1
"""Least share of the lit cells that is seen in a first frame. A crescent of a tenth still has an
edge; whether it tells the distance, the stated error says (`_VAGUE`)."""
_HALO = 1.06
"""Light beside a saturated spot over that farther away, from which it is a lamp's reflection: that
of spots on drawn walls was 0.97 to 1.03, that of lamps 1.1 to 1.6."""
_FAINTEST = 0.03  # least light of the beam over the ambient one, where it is brightest
_VAGUE = (0.5, 0.02)
"""Standard deviation of a distance over that from where the light widens, above which a frame shows
too little of it, for light without and with a sharp edge; what is not known of the beam does not
count. The edge of a spot of which little is seen belongs to a bent line of poses; with 0.02 their
bend is a tenth of a pixel, with twice that poses were far beyond their errors."""
_PLACE_PX, _ALONG_MM, _SWEPT = 0.004, 0.0001, 0.003
"""Errors of the spot's place and of the distance by the image model, and of the place by the way of
the light during the exposure, over that way. Of rendered frames of known pose: on even walls the
place is right to 0.004 px, under the haze of a varnished one to 0.05 px."""


def flag_of(belief: Belief | None, outline: Outline) -> RangeFlag:
    """Why the newest frame is not explained, if so.

    Args:
        belief: the best explanation; None if there is none.
        outline: in the frame.
    """
    if belief is None or not belief.solution.converged:
        return RangeFlag.NOT_CONVERGED
    nearest, farthest = belief.solver.beam.within_mm
    if not nearest < belief.newest.pose.distance < farthest:
        return RangeFlag.OUT_OF_RANGE
    best, sharp = belief.solution, belief.solver.beam.sharp
    widened = belief.newest.pose.distance + belief.solver.beam.apex_mm
    if math.sqrt(best.shown_covariance[2, 2]) > _VAGUE[sharp] * widened:
        return RangeFlag.NOT_CONVERGED
    newest, window = belief.newest, belief.solver.window
    by_beam = belief.solver.model.light(newest, best.own)
    spot = lit(by_beam)
    size = float(np.count_nonzero(spot)) * window.side**2
    seen = math.pi * outline.semi_major_px * outline.semi_minor_px
    most = _SIZE[sharp] if outline.measured else _BRIGHT_SIZE
    explained = best.chi_squared < _MISFIT and 1.0 / most < size / seen < most
    # A wider blur, or light that hardly shows, makes a spot of anything: of a wet wall's haze.
    explained &= 4.0 * math.pi * newest.blur_px2 < size
    explained &= contrast(by_beam, newest) > _FAINTEST
    light, usable = (part.ravel() for part in newest.cells.means(window))
    if newest.saturated:
        explained &= halo(light, spot) < _HALO
    if len(best.frames) == 1:
        explained &= bool(np.mean(usable[spot]) > _VISIBLE)
    return RangeFlag.NONE if explained else RangeFlag.MISFIT


def range_of(
    belief: Belief,
    others_mm: tuple[float, ...],
    wall: WallMemory,
    *,
    shake_px: float,
    shaken: Float[np.ndarray, "5 5"],
    drift_px: Float[np.ndarray, "2"],
    unknown_px: float,
) -> Range:
    """What is stated of the newest frame's pose.

    Args:
        belief: the best explanation.
        others_mm: distances of other explanations.
        wall: what was known of the wall.
        shake_px: least standard deviation of the image's shake along each side.
        shaken: what a shake does to the pose, per px².
        drift_px: of the view before the wall's map was begun.
        unknown_px: what it may have drifted without anybody seeing it.
    """
    solver, solution = belief.solver, belief.solution
    # Where the view was in the first frame, if it shakes, nobody knows.
    shake = max(belief.shake_px, shake_px)
    newest = belief.newest
    swept = 0.0 if newest.sweep is None else solver.beam.swept_px(newest.pose, newest.sweep)
    place = solver.beam.scale_mm_px * math.hypot(_PLACE_PX, _SWEPT * swept)
    place_and_distance = np.diag([place**2, place**2, _ALONG_MM**2, 0.0, 0.0])
    covariance = solution.newest_covariance + place_and_distance
    covariance += edge_covariance(solver, solution) + ambient_covariance(solver, solution)
    covariance += bend_covariance(solver, solution, covariance)
    covariance += shake**2 * shaken
    drifts = [drift_px + belief.drift(frame) for frame in solution.frames]
    for way in unknown_px * np.eye(2) if unknown_px else ():
        covariance += drift_covariance(solver, solution, [way for _ in drifts])
    if np.any(drifts):
        covariance += drift_covariance(solver, solution, drifts)
    pose = solution.frames[-1].pose
    found = TipPose(
        tip_mm=np.asarray(pose.tip),
        axis=np.asarray(pose.axis),
        distance_mm=float(pose.distance),
        covariance=pose.slopes @ covariance @ pose.slopes.T,
        across=np.stack([pose.first, pose.second]),
    )
    return Range(
        distance_mm=found.distance_mm,
        sigma_mm=float(np.sqrt(covariance[2, 2])),
        others_mm=others_mm,
        poses=(found,),
        chi_squared=solution.chi_squared,
        wall=wall,
    )
