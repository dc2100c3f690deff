"""Fit of a beam, its brightness and its pose to all pixels of a withdrawal, whatever the wall."""

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Literal

import numpy as np
from jaxtyping import Float

from eyespot.calibration.pixels.beam_fit import EVEN, BeamFit, Point
from eyespot.calibration.pixels.data import DEFAULTS, FREE, NUISANCES, Footage, check_names
from eyespot.calibration.pixels.fit_result import Failure, ImageFit, result_of
from eyespot.calibration.pixels.lens_light import ENCLOSED, NEAREST_MM, LinearLensLight
from eyespot.calibration.pixels.light import STATES, VIEW, Cells, Light
from eyespot.calibration.recorded_trial import touch_of
from eyespot.calibration.spots.cone_trials import LEAN_SIGMA, JointPrior, Prior
from eyespot.estimator.distance.withdrawal import BORESIGHT_SIGMA
from eyespot.formats.inputs import InputError

_CELL, _SPREAD_CELL, _COARSE_CELL = 1 / 8, 1 / 16, 1 / 2.2
"""Sides of cells over the spot's radius: of a fit, of one whose light spreads from cell to cell,
and of a first fit. Means over wide cells change smoothly even where a sharp edge moves, so a start
that is far off still leads to the minimum."""
_MAX_CELL_PX = {False: 8, True: 24}  # cells of a fit and of a first fit
_SOME = {False: 24, True: 16}
"""Frames of the first rounds, evenly over the withdrawal: in small and in large cells."""
_TOLERANCE = {True: 0.5, False: 0.04}
"""A fit ends if a step would lower chi squared by less, in the first rounds and in the last. The
root is the step in standard errors."""
_OTHER_SAGS = (0.3, 3.0)
"""Factors of the sag for further starts. Two drops can have nearly the same light, and a drop that
focuses it near the tip is found from flatter ones only (numbers 42 and 41 of
`photon_fits coverage` in v0.2.1)."""
_POOR, _MISSED = 1.0, 0.25
"""Chi squared per cell above which a fit in wide cells, and then one in small cells, is not that of
the right beam. Its unit is an error of 1 % of a frame's peak, so the latter is one of 0.5 %. Of
right fits it was at most 0.13 (0.36 %), of a core that is 20 % too wide 0.9."""
_ALIKE = 3.0
"""Standard errors between the results of two starts that are one beam: it is the best there is,
though it misses light. Misfits as large as each other do not show it (number 73)."""
_HOPELESS = 0.04
"""Part of the light, RMS, that a beam may miss after the first rounds: no later step mends that."""
_GUESS_STEPS = 15
"""Most steps of a first fit. From a start within 30 % it takes 3 to 10; more have no end where the
light is not the model's."""
_FINAL_ROUNDS = 2  # each with weights and variances learnt from the one before
_NEAR = 1.0
"""Step, in standard errors, after which a lens's table is as good as one computed at its end: what
the table leaves out is of second order in a step far smaller than the lens."""
_MOST_OF_TABLE = 10.0
"""Largest difference of two tables' results, in standard errors. The covariance contains it, but a
larger one is not only noise."""
_MOST_TABLES = 6
_KNOWN_CORE = 0.005
"""Relative standard error of a core up to which one fit is enough."""
_SAME_COST = 4.0
"""Difference of two fits' chi squared that says nothing: two standard errors of one parameter."""
_CONSIDERED = (*VIEW, "robot_scale")
"""What a fit of a lens takes as it is stated, while the covariance contains the errors of it.

All lengths can grow alike without a change of the light, and nearly so those along and across the
beam. That a table's derivatives, known to some thousandths, do not show this exactly, looks like
knowledge: errors of numerical aperture and scale were stated at half to two thirds of what they
are. How parameters follow what was stated does not suffer from it."""
_VALLEY = 0.01
"""Information along a direction, over that of its parameters one by one, below which errors of the
light's derivatives, some hundredths at sharp edges, would pass for knowledge."""
_FINE_NODES = 12
"""On each side of a cell, at the end of a fit along a valley. By four, derivatives of a light with
sharp edges are 2 % off, by these 0.3 %."""
_HOLD_SIGMAS = 1e-3  # stated standard deviations to which a considered parameter is held
_MAX_FRAMES_IN_MESSAGE = 10  # frames that an error message names


def fit_image(
    footage: Footage,
    *,
    source: Literal["cone", "lens"],
    start: Mapping[str, float],
    free: Sequence[str] | None = None,
    priors: Mapping[str, Prior] | None = None,
    others: Iterable[Mapping[str, float]] | None = None,
    joint_prior: JointPrior | None = None,
    progress: Callable[[float], None] = lambda chi_squared: None,
) -> ImageFit:
    """Fit the light of a cone or of a glue lens to all pixels that the beam reaches.

    The wall may have any texture, which is learnt cell by cell from all frames. Of an even wall it
    is learnt that it has none.

    Args:
        footage: a withdrawal, see `footage_of`.
        source: kind of the light source.
        start: start values of free parameters, within 30 %, and values of the others: `half_angle`
            and `b` for a cone, `lens_parameters` for a lens. `reflectance` and `power` (default 0.5
            and 1 mW) affect the light that the eye scatters back.
        free: names from `UNITS`; by default the cone's half_angle and b, or the lens's sag and
            numerical_aperture. The pose, sensitivity and illumination are always free, and each
            frame's power, exposure, place and shake, whose sizes are learnt.
        priors: priors of free parameters.
        others: further start values, taken in order while a fit misses light; None: other sags.
        joint_prior: of free parameters that have none in `priors`, such as a lens that was
            calibrated before.
        progress: called with chi squared at every step.

    Raises:
        InputError: an unknown name, a missing start value, or frames that cannot be fitted.
    """
    free = FREE[source] if free is None else tuple(free)
    check_names(source, start, free, priors or {})

    # 1. What is known in advance, and where the fits start.
    place, radius = bright_spot(footage)
    file, rim = footage.microscope, footage.instrument.fibre_radius
    camera = file.camera()
    undistorted = place if camera is None else camera.undistorted(place)[0]
    sigma = footage.touch_sigma
    touch = touch_of(footage.kind, file, undistorted, footage.axis, rim_radius=rim, sigma=sigma)
    lean, boresight = Prior(0.0, LEAN_SIGMA), Prior(0.0, BORESIGHT_SIGMA)
    known = {
        "touch": touch,
        "lean": lean,
        "lean_sideways": lean,
        "boresight": boresight,
        "boresight_sideways": boresight,
        **(priors or {}),
    }
    at_start = {
        **dict.fromkeys(NUISANCES, 0.0),
        **DEFAULTS,
        "scale": file.scale_mm_px,
        "eye_radius": file.eye_radius_mm,
        "inverse_working_distance": file.inverse_working_distance,
        "u": float(place[0]),
        "v": float(place[1]),
        **{name: prior.mean for name, prior in known.items()},
        **start,
    }
    if others is None and "sag" in free:
        # A half ball is the highest drop; a fit that starts there cannot move.
        highest = 0.5 * (start["sag"] + start["aperture_radius"])
        sags = [min(factor * max(start["sag"], 0.01), highest) for factor in _OTHER_SAGS]
        others = [{"sag": sag} for sag in sags]
    still = np.zeros((len(footage.readings), len(STATES)))
    every = itertools.chain(({},), others or ())
    starts = (Point({**at_start, **other}, still) for other in every)
    names = (*free, *(name for name in NUISANCES if name not in free))
    lens = LinearLensLight(footage, names) if source == "lens" else None
    considered = {n: known[n] for n in _CONSIDERED if lens and n in known and n in names}
    known |= {n: Prior(prior.mean, _HOLD_SIGMAS * prior.sigma) for n, prior in considered.items()}

    def begun(point: Point, *, first: bool, every: bool = False) -> BeamFit:
        """The fit of some or all frames from a point, in cells of a first fit or small ones."""
        spreads = "blur" in point.values or "spread" in point.values
        share = _COARSE_CELL if first else _SPREAD_CELL if spreads else _CELL
        side = int(np.clip(round(share * radius), 1, _MAX_CELL_PX[first]))
        # A table is not valid near the tip, and a beam whose tip is behind the wall lights nothing.
        nearest = 0.5 * NEAREST_MM if lens else 0.0
        usable = np.flatnonzero(footage.readings + point.values["touch"] > nearest)
        count = len(usable) if every else min(len(usable), _SOME[first])
        return BeamFit.begun(
            footage,
            Cells.over(footage.light.shape[1:], side, beyond=spreads),
            usable[np.linspace(0, len(usable) - 1, count).round().astype(int)].tolist(),
            point,
            names=names,
            priors=known,
            joint_prior=joint_prior,
            lens=lens,
            progress=progress,
        )

    # 2. Some frames: the best of the fits from all starts, then one with learnt weights.
    some = _best_of(starts, begun, is_cone=lens is None)
    some, _ = some.chosen(guess=False).minimised(_TOLERANCE[True], follow=True)
    some = some.learnt()
    if some.error > _HOPELESS:
        why = (
            f"after the first rounds the model misses {100 * some.error:.2g} % of the light; "
            f"{100 * _HOPELESS:g} % are allowed"
        )
        return result_of(some, considered, ("FIRST_ROUND", why))

    # 3. All frames in small cells.
    fit = replace(begun(some.point, first=False, every=True), spread=some.spread, error=some.error)
    if lens is not None:
        lens.follow(fit.point.values, learning=True)
    for number in range(_FINAL_ROUNDS):
        fit, _ = fit.chosen(guess=number == 0).minimised(_TOLERANCE[False], follow=False)
        fit = fit.learnt()
    if fit.textured and not fit.surely_textured:
        fit = fit.flattened()

    # 4. What is linear in lens and view is made exact, and other minima are tried.
    fit, failed, of_table = _settled(fit)
    if failed is None and "core_radius" in names:
        fit, of_table = _from_wider_core(fit, of_table)
    if failed is None:
        fit, of_table = _with_cut_light(fit, of_table)
    if fit.of.lens is not None and _has_valley(fit):
        fit = _in_finer_light(fit)
    if fit.of.is_linear:  # its derivatives are to be those of the end
        fit.look()
        fit = fit.evaluated()

    # 5. Covariance, misfit and ghost.
    return result_of(fit, considered, failed, of_table)


def bright_spot(footage: Footage) -> tuple[Float[np.ndarray, "2"], float]:
    """Centre (px) and typical radius (px) of the pixels much brighter than the frame's median.

    Raises:
        InputError: most frames have no such pixels.
    """
    dark = np.median(footage.light, axis=(1, 2), keepdims=True)
    excess = np.maximum(footage.light - dark, 0)
    peak = np.quantile(excess, 0.999, axis=(1, 2), keepdims=True)
    # A frame that the instrument hides may show none.
    shown = peak.ravel() > 4 * np.sqrt(footage.noise.variance(dark.min()))
    if np.mean(shown) < 0.5:
        frames = ", ".join(map(str, np.flatnonzero(~shown)[:_MAX_FRAMES_IN_MESSAGE]))
        raise InputError(
            f"{np.count_nonzero(~shown)} of {shown.size} frames show no spot, such as {frames}. "
            "Leave them out of the image fit."
        )
    excess = np.where(excess > peak / 2, excess, 0)[shown]
    # The median, because a frame whose spot is hidden shows what else is bright, over a wide area.
    v, u = np.mgrid[: excess.shape[1], : excess.shape[2]]
    light = excess.sum(axis=(1, 2))
    centres = [np.sum(excess * along, axis=(1, 2)) / light for along in (u, v)]
    centre = np.median(centres, axis=1)
    areas = np.count_nonzero(excess, axis=(1, 2))
    return centre, float(np.sqrt(np.median(areas) / np.pi))


def _best_of(starts: Iterable[Point], begun: Callable[..., BeamFit], *, is_cone: bool) -> BeamFit:
    """The best of the fits of some frames from the starts, of which the first may do."""
    tried: list[BeamFit] = []
    found: list[BeamFit] = []
    attempts: Iterable[tuple[Point, bool]] = ((start, False) for start in starts)
    if is_cone:  # a free wall can take the shape of the light of a cone far off
        each = list(attempts)
        attempts = [*each, (each[0][0], True)]
    for start, even in attempts:
        tried.append(_guessed(begun(start, first=True), coarse=True, even=even))
        best = min(tried, key=attrgetter("misfit"))
        if best.misfit > _POOR:
            continue
        tried.remove(best)
        found.append(_guessed(begun(best.point, first=False)))
        *before, last = found
        if last.misfit < _MISSED or any(last.distance(one.point) < _ALIKE for one in before):
            break
    if not found:
        nearest = min(tried, key=attrgetter("misfit"))
        found.append(_guessed(begun(nearest.point, first=False)))
    best = min(found, key=attrgetter("misfit"))
    if tried or best is not found[-1]:  # the last table is that of another start
        _tabulate(best, coarse=False)
    return best


def _guessed(fit: BeamFit, *, coarse: bool = False, even: bool = False) -> BeamFit:
    """A fit of some frames from a point that may be far off.

    Args:
        coarse: whether it is in wide cells.
        even: whether the wall counts as even until the beam is found.
    """
    _tabulate(fit, coarse=coarse)
    fit = fit.chosen(guess=True)
    if coarse:
        fit = fit.brightened()
    for tau in (EVEN, fit.tau) if even else (fit.tau,):
        fit, _ = replace(fit, tau=tau).minimised(
            _TOLERANCE[True], follow=True, keep_chord=True, most_steps=_GUESS_STEPS
        )
    return fit


def _tabulate(fit: BeamFit, *, coarse: bool) -> None:
    if fit.of.lens is not None:
        fit.of.lens.tabulate(fit.point.values, coarse=coarse)


def _linearise(fit: BeamFit) -> None:
    """Make the light linear in lens and view around those of the fit's point."""
    _tabulate(fit, coarse=False)
    fit.look()


def _settled(fit: BeamFit) -> tuple[BeamFit, Failure | None, np.ndarray | None]:
    """Iterate until a lens's table and the view are exact at the minimum; say why if never.

    Within a minimisation the light is linear in the parameters of lens and view. Each new table
    corrects the terms of second order, and brings new errors of its quadrature, which finds or
    misses arcs. A step to a table with a larger cost went too far, and is halved. If that ends
    where the step began, or steps do not become short, the last whole step shows these errors'
    effect on the parameters, which becomes part of the covariance.
    """
    best, least, asked = fit.point, math.inf, np.zeros(len(fit.of.names))
    left = whole = 0.0
    for _ in range(_MOST_TABLES):
        _linearise(fit)
        point = fit.point
        fit, found = fit.minimised(_TOLERANCE[False], follow=False)
        if not found.converged:
            why = (
                f"after {found.steps} steps another one would lower chi squared by "
                f"{found.gain:.2g}; {_TOLERANCE[False]:g} is allowed"
            )
            return fit, ("STEPS", why), None
        too_far = found.first > least
        if too_far:
            fit = replace(fit, point=point.halfway(best))
            left *= 0.5
        else:
            best, least, asked = point, found.first, fit.difference(point, fit.point)
            # In standard errors. By the information, a step along a valley of equal light that
            # is long and bent would count as a hundred of them.
            left = whole = math.sqrt(max(found.first - found.at.cost, 0.0))
        if not fit.of.is_linear or left < _NEAR:
            break
    if too_far:
        fit = _evaluated_at(best, fit)
        left = whole
    elif not fit.of.is_linear or left < _NEAR:
        return fit, None, None
    if left > _MOST_OF_TABLE:
        why = (
            f"the last two tables of the lens's light differ by {left:.1f} standard errors of "
            f"the result; {_MOST_OF_TABLE:g} are allowed"
        )
        return fit, ("TABLES", why), np.outer(asked, asked)
    return fit, None, np.outer(asked, asked)


def _evaluated_at(point: Point, fit: BeamFit) -> BeamFit:
    """The fit at a point where it was before, around which the light becomes linear."""
    fit = replace(fit, point=point)
    _linearise(fit)
    return fit.evaluated()


def _from_wider_core(
    fit: BeamFit, of_table: np.ndarray | None
) -> tuple[BeamFit, np.ndarray | None]:
    """Fit again from a wider core if its error is large, and keep the result if it is alike.

    Behind a high drop the core's edge is imaged far out. Where it leaves the images, these tell
    how narrow the core may be, but not how wide. A fit from below ends there, with an error
    that is that of one side only.
    """
    values, at = fit.point.values, fit.of.names.index("core_radius")
    core = values["core_radius"]
    # As the images tell it: with the scale of robot or microscope it is all lengths that err.
    own = [k for k, name in enumerate(fit.of.names) if name not in _CONSIDERED]
    covariance = np.linalg.pinv(fit.effective()[0][np.ix_(own, own)])
    sigma = math.sqrt(covariance[own.index(at), own.index(at)]) * fit.sizes[at]
    if sigma < _KNOWN_CORE * core:
        return fit, of_table
    wider = core + 2.0 * sigma
    rim = max(values["aperture_radius"], wider)
    cap = {"core_radius": wider, "aperture_radius": rim}
    return _again(fit, cap, of_table, gain=-_SAME_COST)


def _with_cut_light(fit: BeamFit, of_table: np.ndarray | None) -> tuple[BeamFit, np.ndarray | None]:
    """Let a rim at its bound cut off light, and keep the result if the frames demand it.

    Beside the core's edge derivatives are those of the cut, so a rim that the frames do not
    show would seem known, and a fit can end there although wider rims explain them better.
    """
    if not fit.coordinates.is_at_bound(fit.point.values):
        return fit, of_table
    cut = replace(fit, coordinates=fit.coordinates._replace(least_rim=ENCLOSED))
    return _again(cut, {}, of_table, gain=_SAME_COST)


def _again(
    fit: BeamFit, changes: dict[str, float], of_table: np.ndarray | None, *, gain: float
) -> tuple[BeamFit, np.ndarray | None]:
    """Fit from a changed lens, and keep the result if chi squared falls by the gain."""
    changed = Point(fit.point.values | changes, fit.point.states)
    other, failed, of_last = _settled(replace(fit, point=changed))
    if failed is None and other.equations.cost < fit.equations.cost - gain:
        return other, of_last
    return _evaluated_at(fit.point, fit), of_table


def _has_valley(fit: BeamFit) -> bool:
    """Whether some combination of parameters hardly changes the light, though each alone does."""
    information, _ = fit.effective()
    alone = np.sqrt(np.diag(information))
    return bool(np.linalg.eigvalsh(information / np.outer(alone, alone))[0] < _VALLEY)


def _in_finer_light(fit: BeamFit) -> BeamFit:
    """The fit with a lens's light in finer cells, whose derivatives are nearer to the true ones."""
    of = fit.of
    assert of.lens is not None
    of.lens.tabulate(fit.point.values, finely=True)
    light = Light(of.footage, of.cells, of.names, of.lens, nodes=_FINE_NODES)
    return replace(fit, of=replace(of, light=light))
