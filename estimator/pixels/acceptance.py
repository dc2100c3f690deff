"""Whether a pose explains its frame, and what its stated error contains.

Five covariances are added to the fit's own:

- Ambient light. Its logarithm is a polynomial of the second degree over the window, and its texture
  is that of the wall. The reflection of a lamp by a wet wall has a shape of its own and no texture.
  What the polynomial lacks passes for the wall's texture, as long as the spot is as bright as in
  the first frame; then it pulls the pose, in each frame alike.
- Bend. Where only a part of the spot is seen, distant poses put its edge in the same place: as the
  distance grows, the spot moves away from its visible side. To the second order they also turn.
  Along a line of such poses, s standard deviations from the fit, the best one is off the line by
  s^2 times a bend, and what the line states as well known is not.
- Drift. The wall moves in the image when the eye turns or when the microscope drifts, and one spot
  cannot show which. If it is the eye, the microscope file still says where the wall is. If it is
  the microscope, each pixel sees another part of the wall than the file says, with another slope.
  The pose is right in the first case and pulled in the second, so the pull belongs to its errors.
- Shift of the edge. A blur moves the half maximum of a spot of radius R inwards by its variance
  over 2 R. The blur that is fitted has a shape between a few usual ones and is the same all over
  the window, and what is known of the wall is blurred as well. So this shift is known only about as
  well as it is large, and its error is alike in all frames: it does not average out. Where the
  wall's reflectance grows to one side, its blur brings light from there, and the edge moves that
  way by the variance times the growth of the logarithm.
- Ghost. A second image of the spot that several frames show (`estimator.ghost`) pulls the pose.
  Where that is less than the fit's own error it counts as an error, else there is no distance.
"""

import math
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from eyespot.estimator.distance.range import Range, TipPose, WallMemory
from eyespot.estimator.ghost import GHOST_SIGMAS, strongest_ghost
from eyespot.estimator.pixels.first_frame import Hypothesis
from eyespot.estimator.pixels.frame_cells import COUNT, SIDES, WallMotion
from eyespot.estimator.pixels.frame_model import (
    BLOOM_SIGMA_PX,
    BLUR,
    contrast,
    halo,
    lit,
)
from eyespot.estimator.pixels.pose_solver import PoseSolution
from eyespot.estimator.pixels.texture import TextureVariances
from eyespot.formats.spot import Outline, Reason
from eyespot.optics.wall_light.pose_light import POSE, BeamFrame, beam_at_wall

_X, _Y = SIDES
_CUBIC = np.stack([_X**3, _X**2 * _Y, _X * _Y**2, _Y**3]) - 0.6 * np.stack(
    [_X, _Y / 1.8, _X / 1.8, _Y]
)
"""Terms of the third degree, without what terms of the first would explain."""
_CUBIC_SHARE = 1.5  # terms of the third degree over those of the first and second
_EVEN_SHADING = 0.02  # terms of the shading below which the ambient light counts as even


def ambient_covariance(solution: PoseSolution) -> Float[np.ndarray, "5 5"]:
    """What errors of the ambient light may have done to the newest pose, in the terms of `POSE`."""
    size = float(np.linalg.norm(solution.newest.shade))
    if size < _EVEN_SHADING:
        return np.zeros((POSE, POSE))
    ambient = np.exp([[frame.log_ambient] for frame in solution.frames])
    shares = ambient / (np.maximum(solution.lights, 0.0) + ambient)  # of each cell's light
    pulls = solution.answers(_CUBIC_SHARE * size * shares * _CUBIC[:, None])
    return pulls.T @ pulls


_NEGLIGIBLE_SHARE = 0.01
"""Standard deviation of the distance over it, or of a turn, below which nothing bends: a spot's
edge moves by 1e-4 of its radius then."""
_FOURTH_MOMENT = 3.0  # mean of the fourth power of a normal number


def bend_covariance(
    solution: PoseSolution, covariance: Float[np.ndarray, "5 5"]
) -> Float[np.ndarray, "5 5"]:
    """What the bend may do to the newest pose, in the terms of `POSE`.

    Args:
        covariance: of the newest pose without the bend.
    """
    frame, fitted = solution.newest, solution.newest_covariance
    sigmas = np.sqrt(np.diag(covariance))
    sizes = np.array([0.0, 0.0, sigmas[2] / frame.pose.distance, *sigmas[3:]])
    changes, found = np.zeros((1, *solution.lights.shape)), np.zeros((POSE, POSE))
    for k in np.flatnonzero(sizes > _NEGLIGIBLE_SHARE):
        changes[0, -1] = _even_part(solution, covariance[:, k] / sigmas[k])
        bend = solution.answers(changes)[0]
        bend -= fitted[:, k] / fitted[k, k] * bend[k]  # the best pose at this distance or turn
        # Where the light says too little, the second order says nothing.
        bend = np.clip(bend, -sigmas, sigmas)
        found += _FOURTH_MOMENT * np.outer(bend, bend)
    return found


def _even_part(solution: PoseSolution, change: Float[np.ndarray, "5"]) -> Float[np.ndarray, "n"]:
    """How the newest frame's log light changes by a change of its pose and by its opposite."""
    model, frame = solution.solver.model, solution.newest
    poses = [frame.pose.moved_on(model.beam.wall, shift) for shift in (change, -change)]
    frames = [replace(frame, pose=pose) for pose in poses if pose is not None]
    if len(frames) < len(poses):
        return np.zeros(COUNT**2)
    ahead, back = model.log_lights(frames, model.lights(frames, solution.own))
    return 0.5 * (ahead + back) - solution.log_lights[-1]


def ghost_pull(solution: PoseSolution) -> Float[np.ndarray, "5"] | None:
    """What a ghost does to the newest pose, in the terms of `POSE`; None if frames show none."""
    lines = solution.linear
    found = strongest_ghost(
        np.stack([line.residual for line in lines]),
        np.stack([line.weight for line in lines]),
        np.maximum(solution.lights, 0.0).reshape(-1, COUNT, COUNT),
        np.exp(solution.log_lights).reshape(-1, COUNT, COUNT),
        [np.concatenate([line.slopes, line.shared]) for line in lines],
        side_px=solution.solver.window.side,
    )
    if found is None or found.sigmas < GHOST_SIGMAS:
        return None
    return solution.answers(found.share * found.added[None])[0]


_DIFFERENCE_STEP_PX = 0.5  # of the numerical derivative
_PULL_SHARE = 0.3
"""Error of the pull, over its size: it is a linear forecast. On rendered drifts of up to 1.3 mm
shifts and turns were within 10 to 30 % of it, mostly."""
_TURN_PER_MM = 0.3  # most turn by a drift, rad/mm; the wall's slope changes by 0.09
_PULL_ERROR_PER_DRIFT = 0.03  # error of the distance's pull, over the drift


def drift_covariance(
    solution: PoseSolution, drifts_px: Float[np.ndarray, "k 2"]
) -> Float[np.ndarray, "5 5"]:
    """What a drift of the view may have done to the newest pose, in the terms of `POSE`.

    Args:
        drifts_px: shift of the image in each frame since the microscope file was right.
    """
    # How far the newest pose would be off.
    model, own = solution.solver.model, solution.own
    beam, middles = model.beam, model.window.middle_px + solution.drifts_px
    lengths = np.maximum(np.linalg.norm(drifts_px, axis=1, keepdims=True), _DIFFERENCE_STEP_PX)
    parts = _DIFFERENCE_STEP_PX / lengths
    points, _ = beam.wall_points(np.concatenate([middles, middles - parts * drifts_px]))
    here, there = np.split(points, 2)
    seen: list[tuple[WallMotion, BeamFrame]] = []
    for frame, step, (right, down) in zip(
        solution.frames, there - here, (parts * drifts_px).tolist(), strict=True
    ):
        other = beam_at_wall(beam.wall, frame.pose.tip + step, frame.pose.axis)
        if other is None:
            return np.zeros((POSE, POSE))
        motion = frame.cells.motion
        drifted = motion._replace(right=motion.right - right, down=motion.down - down)
        seen.append((drifted, other))
    lights = model.log_lights(solution.frames, beam.lights(model.window, seen, own))
    changes = (lights - solution.log_lights) / parts
    pull, newest = solution.answers(changes[None])[0], solution.newest.pose
    aside = (there - here)[-1] / parts[-1]
    pull[:2] -= aside @ np.stack([newest.right, newest.down], axis=-1)
    shift = float(np.linalg.norm(pull[:2]))
    # Where the light hardly says anything, a linear forecast has no bound of its own.
    pull[2] = np.clip(pull[2], -shift, shift)
    pull[3:] *= min(1.0, _TURN_PER_MM * shift / max(float(np.linalg.norm(pull[3:])), 1e-12))
    turn = np.linalg.norm(pull[3:])
    distance = np.hypot(pull[2], _PULL_ERROR_PER_DRIFT / _PULL_SHARE * shift)
    return (
        np.outer(pull, pull) + np.diag([shift, shift, distance, turn, turn]) ** 2 * _PULL_SHARE**2
    )


def shake_covariance(solution: PoseSolution) -> Float[np.ndarray, "5 5"]:
    """What a shake of the view by a pixel along each side does to all poses on a map, per px².

    Args:
        solution: of the map's first frame, whose shake is not known.
    """
    shaken = [drift_covariance(solution, shift[None]) for shift in np.eye(2)]
    return np.sum(shaken, axis=0)


_WIDE_BLUR_PX2 = 0.5  # variance of a blur, below which its errors do not matter
_SHIFT_SHARE = 2.0
"""Error of the shift, over the shift. On rendered cones out of focus by 2 and 3 mm at NA 0.04 the
distance was off by up to 0.5 of what the whole shift makes of it in first frames, by up to 1.1 on
printed paper and by 1.5 to 2.6 on a retina in the frames that follow."""
_ALONG_ONE, _MOST_PX2 = 0.7, 4.0
"""Largest anisotropy of the blur, over its variance, px². Up to 4 px² it may be the view's motion
along one direction, by seven pixels during the exposure; more is defocus, which is round."""


def edge_covariance(solution: PoseSolution) -> Float[np.ndarray, "5 5"]:
    """What such errors may have done to the newest pose, in the terms of `POSE`."""
    newest = solution.newest
    if newest.blur_px2 < _WIDE_BLUR_PX2 and not newest.cells.saturated:
        return np.zeros((POSE, POSE))
    shifts = np.array([_changes(solution, k) for k in range(len(solution.frames))])
    # The edge may be shifted all round, by an oval, or to a side, or wider along one direction.
    # Where the spot moves on, the wall grows otherwise.
    newest_alone = np.zeros((2, *shifts[:, 0].shape))
    newest_alone[:, -1] = shifts[-1, 3:5]
    pulls = solution.answers(np.concatenate([shifts.swapaxes(0, 1), newest_alone]))
    return pulls.T @ pulls


def _changes(solution: PoseSolution, k: int) -> Float[np.ndarray, "7 n"]:
    """How frame k's log light changes by each of these errors."""
    frame, by_blur = solution.frames[k], solution.linear[k].slopes[BLUR]
    light, solver = solution.lights[k], solution.solver
    side, spot = solver.window.side, lit(light)
    if not spot.any():  # an early, small spot, from which the window has moved on
        return np.zeros((7, light.size))
    radius = side * math.sqrt(np.count_nonzero(spot) / math.pi)
    light = np.exp(solution.log_lights[k])
    steep = np.hypot(*np.gradient(light.reshape(COUNT, COUNT), side)).ravel()
    shift = _SHIFT_SHARE * frame.blur_px2 / (2.0 * radius) + BLOOM_SIGMA_PX * frame.cells.saturated
    x, y = solver.window.centres().reshape(-1, 2).T
    angle = np.arctan2(y - y[spot].mean(), x - x[spot].mean())
    # How log reflectance grows across the spot, 1/px; a blurred wall looks more even than it is.
    across, textures = 2.0 * radius, (solver.texture, TextureVariances.usual())
    across_mm = across * solver.beam.scale_mm_px
    growth = math.sqrt(max(one.variogram(across_mm) for one in textures)) / across
    aside = frame.blur_px2 * growth
    outwards = steep / light
    oval = np.stack([np.cos(2 * angle), np.sin(2 * angle)])
    to_a_side = aside * np.stack([np.cos(angle), np.sin(angle)])
    shifts = np.concatenate([shift * np.ones((1, angle.size)), shift * oval, to_a_side])
    along_one = _ALONG_ONE * min(frame.blur_px2, _MOST_PX2)
    return np.concatenate([outwards * shifts, along_one * by_blur * oval])


_MAX_CHI_SQUARED = 4.0  # chi squared per cell above which the light is not the beam's on this wall
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
_MIN_CONTRAST = 0.03  # least light of the beam over the ambient one, where it is brightest
_VAGUE = (0.5, 0.02)
"""Standard deviation of a distance over that from where the light widens, above which a frame shows
too little of it, for light without and with a sharp edge; what is not known of the beam does not
count. The edge of a spot of which little is seen belongs to a bent line of poses; with 0.02 their
bend is a tenth of a pixel, with twice that poses were far beyond their errors."""
_PLACE_PX, _ALONG_MM, _SWEPT = 0.004, 0.0001, 0.003
"""Errors of the spot's place and of the distance by the image model, and of the place by the way of
the light during the exposure, over that way. Of rendered frames of known pose: on even walls the
place is right to 0.004 px, under the haze of a varnished one to 0.05 px."""


def flag_of(hypothesis: Hypothesis | None, outline: Outline) -> Reason | None:
    """Why the newest frame is not explained; None if it is.

    Args:
        hypothesis: the best explanation; None if there is none.
    """
    if hypothesis is None or not hypothesis.solution.converged:
        return Reason.NOT_CONVERGED
    best, newest = hypothesis.solution, hypothesis.solution.newest
    beam, window = best.solver.beam, best.solver.window
    nearest, farthest = beam.within_mm
    if not nearest < newest.pose.distance < farthest:
        return Reason.OUT_OF_RANGE
    sharp, widened = beam.sharp, newest.pose.distance + beam.apex_mm
    if math.sqrt(best.shown_covariance[2, 2]) > _VAGUE[sharp] * widened:
        return Reason.NOT_CONVERGED
    by_beam = best.lights[-1]
    spot = lit(by_beam)
    size = float(np.count_nonzero(spot)) * window.side**2
    seen = math.pi * outline.semi_major_px * outline.semi_minor_px
    most = _SIZE[sharp] if outline.measured else _BRIGHT_SIZE
    explained = best.chi_squared < _MAX_CHI_SQUARED and 1.0 / most < size / seen < most
    # A wider blur, or light that hardly shows, makes a spot of anything: of a wet wall's haze.
    explained &= 4.0 * math.pi * newest.blur_px2 < size
    explained &= contrast(by_beam, newest) > _MIN_CONTRAST
    light, usable, _ = newest.cells.means(window)
    if newest.cells.saturated:
        explained &= halo(light, spot) < _HALO
    if len(best.frames) == 1:
        explained &= bool(np.mean(usable[spot]) > _VISIBLE)
    return None if explained else Reason.MISFIT


def range_of(
    hypothesis: Hypothesis,
    others_mm: tuple[float, ...],
    wall: WallMemory,
    *,
    shake_px: float,
    shaken: Float[np.ndarray, "5 5"],
    drift_px: Float[np.ndarray, "2"],
    unknown_px: float,
    ghost_pull: Float[np.ndarray, "5"],
) -> Range:
    """What is stated of the newest frame's pose.

    Args:
        shake_px: least standard deviation of the image's shake along each side.
        shaken: what a shake does to the pose, per px².
        drift_px: of the view before the wall's map was begun.
        unknown_px: what it may have drifted without anybody seeing it.
        ghost_pull: of a ghost, see `ghost_pull`.
    """
    solution, beam = hypothesis.solution, hypothesis.solution.solver.beam
    # If the view shakes, its place in the first frame is not known.
    shake = max(hypothesis.shake_px, shake_px)
    newest = solution.newest
    swept = 0.0 if newest.sweep is None else beam.swept_px(newest.pose, newest.sweep)
    place = beam.scale_mm_px * math.hypot(_PLACE_PX, _SWEPT * swept)
    place_and_distance = np.diag([place**2, place**2, _ALONG_MM**2, 0.0, 0.0])
    covariance = solution.newest_covariance + place_and_distance
    covariance += edge_covariance(solution) + ambient_covariance(solution)
    covariance += bend_covariance(solution, covariance)
    covariance += shake**2 * shaken + np.outer(ghost_pull, ghost_pull)
    drifts = drift_px + solution.drifts_px
    for shift in unknown_px * np.eye(2) if unknown_px else ():
        covariance += drift_covariance(solution, np.broadcast_to(shift, drifts.shape))
    if np.any(drifts):
        covariance += drift_covariance(solution, drifts)
    pose = newest.pose
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
        bound_mm=float(np.sqrt(solution.newest_covariance[2, 2])),
        wall=wall,
    )
