"""Trials of a cone: withdrawals with unknown touch, and priors.

A trial is a straight withdrawal. The robot reports the distance travelled and, to about a degree,
the direction of the motion and of the tool, but not the position of the wall. The fibre's beam is
not exactly parallel to the tool. So each trial has seven nuisances: the distance at reading 0
(`touch`; the rim meets the wall before the centre does), the spot's position in the image at
reading 0 (two), the rotation of the robot against the eye (`lean`, two), and the angle of the beam
from the tool's axis (`boresight`, two). An eighth is the part by which the camera's model misses
the spot's size at the trial's place (`size`).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, ScalarLike

from eyespot import optics
from eyespot.calibration.least_squares import padded
from eyespot.estimator.distance.withdrawal import BORESIGHT_SIGMA, DELAYS
from eyespot.formats.inputs import InputError

NUISANCES = (
    "touch",
    "u",
    "v",
    "lean",
    "lean_sideways",
    "boresight",
    "boresight_sideways",
    "size",
)
"""Nuisances of each trial: the position in px, the others in units of their priors' sigma."""
HELD = 6
"""Number of nuisances that have a prior; the position has none."""
LEAN_SIGMA = math.radians(1.0)
"""Standard deviation of the robot's directions, rad."""
_POINTS = 32
_LEAST_PRIOR = 1e-6
"""Least standard deviation of a joint prior, relative: 1e-5 mm of a distance of 10 mm."""
_PADDED_FRAMES = 16  # frames: trials of nearly equal length share one compilation, which takes 15 s


class Prior(NamedTuple):
    """Prior knowledge of a parameter, in the parameter's unit."""

    mean: float
    sigma: float


class JointPrior(NamedTuple):
    """Prior knowledge of several parameters whose errors are correlated.

    Attributes:
        mean: by name, in the parameters' units.
        covariance: in the same order.
    """

    mean: Mapping[str, float]
    covariance: Float[np.ndarray, "n n"]


def prior_terms(
    names: Sequence[str], priors: Mapping[str, Prior], joint: JointPrior | None
) -> tuple[Float[np.ndarray, "p"], Float[np.ndarray, "p p"]]:
    """Means of the named parameters, and the matrix that makes their deviations independent.

    The deviations times the matrix have variance 1; they are 0 for parameters without a prior.

    Raises:
        InputError: a parameter has a prior of each kind.
    """
    for name in priors.keys() & (joint.mean.keys() if joint else ()):
        raise InputError(f"--prior {name} is given twice, as --calibration has it. Leave it out.")
    means, weights = np.zeros(len(names)), np.zeros((len(names),) * 2)
    for at, name in enumerate(names):
        if name in priors:
            means[at], weights[at, at] = priors[name].mean, 1.0 / priors[name].sigma
    if joint is not None:
        rows = [names.index(name) for name in joint.mean]
        means[rows] = list(joint.mean.values())
        # A calibration may state no error.
        least = np.diag(np.square(_LEAST_PRIOR * means[rows]))
        weights[np.ix_(rows, rows)] = np.linalg.inv(np.linalg.cholesky(joint.covariance + least))
    return means, weights


@dataclass(frozen=True, kw_only=True, eq=False)
class ConeTrial:
    """Spots along one beam, with the robot's readings and axis.

    Attributes:
        ellipses: measured ellipses, one per frame, px; leading axis n.
        covariances: covariance of each ellipse's (centre u, centre v, semi-major, semi-minor,
            angle), n x 5 x 5.
        readings: distance of the tip from its place at the touch, mm.
        axis: unit vector along the tool from the tip towards the wall, eye frame.
        principal_point: (u0, v0) of this trial's window, px.
        coverage: visible share of each ellipse; the tool is what hides the rest.
        touch: distance at reading 0, mm.
        kind: "eyeball", a sphere around the origin, or "plane", a plane through the sphere's pole
            that is perpendicular to z except for its tilt.
        motion: unit vector against the tip's motion, towards the wall; None: the axis.
        delayed: readings by clock offset, of `ReportedWithdrawal`; None: the clocks are one.
        delay_s: the step of its offsets.
    """

    ellipses: optics.Ellipse
    covariances: Float[np.ndarray, "n 5 5"]
    coverage: Float[np.ndarray, "n"]
    readings: Float[np.ndarray, "n"]
    axis: Float[np.ndarray, "3"]
    principal_point: Float[np.ndarray, "2"]
    touch: Prior
    kind: str
    motion: Float[np.ndarray, "3"] | None = None
    delayed: Float[np.ndarray, "n delays"] | None = None
    delay_s: float = 1.0

    def shaken(self, by_px: float) -> "ConeTrial":
        """The trial as a view shows it that shakes by so much along each side, px."""
        moved = np.diag([by_px**2, by_px**2, 0.0, 0.0, 0.0])
        return replace(self, covariances=self.covariances + moved)


def beam_directions(
    *,
    motion: Float[Array, "3"],
    axis: Float[Array, "3"],
    lean: Float[Array, "2"],
    boresight: Float[Array, "2"],
) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Unit vectors of the motion and of the beam in the eye.

    Args:
        motion: the robot's direction of motion, towards the wall.
        axis: the robot's direction of the tool, towards the wall.
        lean: rotation of motion and tool, along the two vectors of
            `optics.perpendicular_frame(axis)`, rad.
        boresight: deviation of the beam from the tool, along the same vectors, rad.
    """
    frame = jnp.stack(optics.perpendicular_frame(axis))
    directions = jnp.stack([motion + lean @ frame, axis + (lean + boresight) @ frame])
    motion, beam = directions / jnp.linalg.norm(directions, axis=-1, keepdims=True)
    return motion, beam


def reading_at(delayed: Float[Array, "delays"], steps: Float[Array, ""]) -> Float[Array, ""]:
    """The reading for a clock offset of so many steps, by a quadratic B-spline.

    It has a slope everywhere and no waves, also where a robot sets off; a parabola through a few
    offsets has a second minimum there. Without an offset it is the reading itself.
    """
    at = jnp.clip(jnp.round(steps), 1 - DELAYS // 2, DELAYS // 2 - 1)
    beside = steps - at
    weights = jnp.stack([(0.5 - beside) ** 2 / 2, 0.75 - beside**2, (0.5 + beside) ** 2 / 2])
    first = DELAYS // 2 - 1
    still = delayed[first : first + 3]
    smoothed = jnp.array([0.125, 0.75, 0.125]) @ still - still[1]
    return weights @ jax.lax.dynamic_slice(delayed, (at.astype(int) + first,), (3,)) - smoothed


def undelayed(readings: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n delays"]:
    """Readings by a clock whose offset changes nothing, as `reading_at` takes them."""
    return np.tile(readings[:, None], DELAYS)


def phantom_wall(
    kind: str, *, eye_radius: ScalarLike, tilt: tuple[ScalarLike, ScalarLike] = (0.0, 0.0)
) -> optics.Surface:
    """The wall of a `ConeTrial.kind`.

    Args:
        kind: "eyeball" or "plane".
        eye_radius: mm.
        tilt: tilt of the plane: tangents of its normal's angle from z, towards +X and +Y.
    """
    if kind == "eyeball":
        return optics.Sphere(eye_radius)
    pole = jnp.array([0.0, 0.0, -1.0]) * eye_radius
    inward = jnp.stack([*map(jnp.asarray, tilt), jnp.ones(())])
    return optics.Plane(point=pole, inward=inward / jnp.linalg.norm(inward))


class TrialGroup(eqx.Module):
    """Trials on walls of one kind, padded to the same number of frames; or one of them."""

    ellipses: optics.Ellipse
    whitening: Float[Array, "trials n 5 5"]
    readings: Float[Array, "trials n"]
    motions: Float[Array, "trials 3"]
    axes: Float[Array, "trials 3"]
    principal_points: Float[Array, "trials 2"]
    touch_means: Float[Array, "trials"]
    touch_sigmas: Float[Array, "trials"]
    lean_sigmas: Float[Array, "trials"]
    boresight_sigmas: Float[Array, "trials"]
    size_sigmas: Float[Array, "trials"]
    kind: str = eqx.field(static=True)
    coverage: Float[Array, "trials n"] | None = None
    """None: all ellipses are wholly visible."""
    delayed: Float[Array, "trials n delays"] | None = None
    """Of `ConeTrial`; None: the readings."""
    delays_s: Float[Array, "trials"] | None = None

    @property
    def size(self) -> int:
        """Number of trials."""
        return self.readings.shape[0]

    @classmethod
    def of(
        cls,
        trials: Sequence[ConeTrial],
        size_sigmas: Sequence[float],
        outline_sigmas: Sequence[float],
    ) -> "TrialGroup":
        """The trials, which are on one kind of wall."""
        longest = max(trial.readings.size for trial in trials)
        longest += -longest % _PADDED_FRAMES

        def stacked(arrays: Sequence[ArrayLike]) -> Array:
            # The padding has weight 0.
            return jnp.asarray(np.stack([padded(a, longest) for a in arrays]))

        ellipses = optics.Ellipse(
            *(stacked(leaves) for leaves in zip(*(t.ellipses for t in trials), strict=True))
        )
        covariances = stacked([t.covariances for t in trials])
        whitening = _whitening_of_each(ellipses, covariances, jnp.array(outline_sigmas))
        frames = np.array([t.readings.size for t in trials])
        real = np.arange(longest) < frames[:, None]
        return cls(
            ellipses=ellipses,
            whitening=whitening * real[..., None, None],
            coverage=stacked([t.coverage for t in trials]),
            readings=stacked([t.readings for t in trials]),
            delayed=stacked(
                [undelayed(t.readings) if t.delayed is None else t.delayed for t in trials]
            ),
            delays_s=jnp.array([t.delay_s for t in trials]),
            motions=jnp.asarray(
                np.stack([t.axis if t.motion is None else t.motion for t in trials])
            ),
            axes=jnp.asarray(np.stack([t.axis for t in trials])),
            principal_points=jnp.asarray(np.stack([t.principal_point for t in trials])),
            touch_means=jnp.array([t.touch.mean for t in trials]),
            touch_sigmas=jnp.array([t.touch.sigma for t in trials]),
            lean_sigmas=jnp.full(len(trials), LEAN_SIGMA),
            boresight_sigmas=jnp.full(len(trials), BORESIGHT_SIGMA),
            size_sigmas=jnp.array(size_sigmas),
            kind=trials[0].kind,
        )


def whitening_of(
    ellipses: optics.Ellipse, covariances: Float[Array, "n 5 5"], missed: ScalarLike
) -> Float[Array, "n 5 5"]:
    """Matrices that turn the mismatch of a trial's ellipses into independent terms of variance 1.

    Args:
        ellipses: one per frame, px.
        covariances: of (centre u, centre v, semi-major, semi-minor, angle).
        missed: standard deviation by which the camera's model misses their outline, relative.
    """
    shape = jax.vmap(optics.mismatch_covariance)(ellipses, covariances)
    return jnp.linalg.inv(jnp.linalg.cholesky(shape + jnp.square(missed) * jnp.eye(5)))


_whitening_of_each = jax.jit(jax.vmap(whitening_of))


def wandering_boresight(
    points: Float[Array, "n 3"],
    readings: Float[Array, "n"],
    weight: Float[Array, "n"],
    *,
    motion: Float[Array, "3"],
    axis: Float[Array, "3"],
) -> Float[Array, "2"]:
    """Angle of the beam from the tool's axis by which the spot wanders, rad, as in `ConeTrial`.

    The spot is at tip + s * beam and the tip moves by -motion, so beam ~ motion + wandering.

    Args:
        points: spots on the wall, mm.
        readings: mm.
        weight: 1, or 0 for padding.
    """
    gone = weight * (readings - weight @ readings / jnp.sum(weight))
    beam = motion + gone @ points / jnp.maximum(gone @ gone, 1e-12)
    frame = jnp.stack(optics.perpendicular_frame(axis))
    return frame @ (beam / jnp.linalg.norm(beam) - axis)


@eqx.filter_jit
def first_nuisances(
    group: TrialGroup, camera: optics.Microscope, values: Mapping[str, ScalarLike]
) -> Float[Array, "trials 8"]:
    """The expected nuisances, with the boresight that makes the spot wander as it does.

    From a beam that is 3 degrees askew a spot is half its size away, where the mismatch of two
    ellipses is no longer linear, and a solver goes astray.
    """
    wall = _wall(group, values)

    def of_trial(trial: TrialGroup) -> Array:
        points = wall.intersect(*_view(trial, camera).ray(trial.ellipses.centre)).point
        weight = jnp.any(trial.whitening, axis=(1, 2))
        aside = wandering_boresight(
            points, trial.readings, weight, motion=trial.motions, axis=trial.axes
        )
        askew = aside / trial.boresight_sigmas
        return jnp.zeros(len(NUISANCES)).at[5:7].set(askew)

    return jax.vmap(of_trial)(group)


def spots(
    group: TrialGroup,
    camera: optics.Microscope,
    values: Mapping[str, ScalarLike],
    nuisances: Float[Array, "trials 8"],
) -> Float[Array, "trials 3"]:
    """The point of the wall that the beam meets at reading 0 in each trial, mm."""
    wall = _wall(group, values)

    def of_trial(trial: TrialGroup, nuisance: Array) -> Array:
        # The spot's position is relative to the first frame's ellipse, px.
        at = trial.ellipses.centre[0] + nuisance[1:3]
        return wall.intersect(*_view(trial, camera).ray(at)).point

    return jax.vmap(of_trial)(group, nuisances)


def _view(trial: TrialGroup, camera: optics.Microscope) -> optics.Microscope:
    return eqx.tree_at(lambda m: m.principal_point, camera, trial.principal_points)


def _wall(group: TrialGroup, values: Mapping[str, ScalarLike]) -> optics.Surface:
    return phantom_wall(
        group.kind, eye_radius=values["eye_radius"], tilt=(values["tilt_x"], values["tilt_y"])
    )


def misfit(group: TrialGroup, camera: optics.Microscope, values, nuisances) -> Array:
    """Residuals over their sigma: the mismatch of every frame and the priors of the nuisances."""
    wall = _wall(group, values)

    def of_trial(trial: TrialGroup, spot: Array, nuisance: Array) -> Array:
        view = _view(trial, camera)
        away, aim = beam_directions(
            motion=trial.motions,
            axis=trial.axes,
            lean=trial.lean_sigmas * nuisance[3:5],
            boresight=trial.boresight_sigmas * nuisance[5:7],
        )
        larger = trial.size_sigmas * nuisance[7]
        touching = spot - (trial.touch_means + trial.touch_sigmas * nuisance[0]) * aim

        def of_frame(ellipse, whiten, coverage, reading, delayed):
            if delayed is not None:
                reading = reading_at(delayed, values["clock_offset"] / trial.delays_s)
            gone = values.get("robot_scale", 1.0) * reading
            beam = optics.Beam(
                tip=touching - gone * away,
                axis=aim,
                half_angle=values["half_angle"],
                apex_offset=values["b"],
            )
            return whiten @ _mismatch(wall, view, beam, spot, ellipse, coverage).at[2].add(larger)

        frames = jax.vmap(of_frame)(
            trial.ellipses, trial.whitening, trial.coverage, trial.readings, trial.delayed
        )
        # The spot's position in the image has no prior.
        return jnp.concatenate([jnp.ravel(frames), nuisance[:1], nuisance[3:]])

    places = spots(group, camera, values, nuisances)
    return jnp.ravel(jax.vmap(of_trial)(group, places, nuisances))


@eqx.filter_jit  # Traced once for trials and frames of any number.
def _mismatch(
    wall: optics.Surface,
    view: optics.Microscope,
    beam: optics.Beam,
    spot: Float[Array, "3"],
    ellipse: optics.Ellipse,
    coverage: Float[Array, ""] | None,
) -> Float[Array, "5"]:
    """Mismatch of one frame's ellipse; its third term is the relative difference in size."""
    contour = optics.spot_contour(beam, wall, view, points=_POINTS)
    tool = view.project(jnp.stack([spot, beam.tip]))
    seen = None if coverage is None else _seen_beside(tool, contour, ellipse, coverage)
    return optics.ellipse_mismatch(contour, ellipse, seen)


def _seen_beside(
    tool: Float[Array, "2 2"],
    contour: Float[Array, "n 2"],
    ellipse: optics.Ellipse,
    coverage: Float[Array, ""],
) -> Float[Array, "n"]:
    """Visible share of each point's piece of a contour, part of which the tool hides.

    Tool and beam are one line, so that in the image the hidden arc lies about the direction from
    the spot to the tip, whose images `tool` has. The `coverage` is that of the whole contour.
    """
    spot, tip = tool
    aside = (contour - ellipse.centre) @ jnp.array([1.0, 1.0j])
    beside = jnp.abs(jnp.angle(aside * jnp.conj((tip - spot) @ jnp.array([1.0, 1.0j]))))
    per_piece = len(contour) / (2.0 * jnp.pi)
    hidden = jnp.pi * (1.0 - coverage)
    # A piece that lies on the tool's line shows on both sides of it.
    nearer, farther = 0.5 + (beside - hidden) * per_piece, 0.5 - (beside + hidden) * per_piece
    return jax.lax.stop_gradient(jnp.clip(nearer, 0.0, 1.0) + jnp.clip(farther, 0.0, 1.0))


RETINA = Prior(13.0, 1.0)
"""Radius of curvature of the retina, mm: a horizontal semi-axis squared over the axial one, 13.4 ±
1.2 mm in a healthy population (Rozema et al. 2016), 12.9 mm in emmetropes (Atchison 2006)."""

SIZE_SIGMA = 0.0001
"""Part by which the sizes of a trial's spots are off alike, as the texture of its wall pulls their
edges: 0.007 of 75 px. More frames do not average it out. With it 88 random withdrawals over drawn
retinas, printed paper and a photograph (seeds 0 to 174 of `random_fits cones`
in v0.2.1) have the errors that they state; with half of it they are 1.3 times as large."""

SIZE_PER_MM = 0.00065
"""Part by which the best pinhole over a sphere misses the size of a spot, per mm of c.

Root mean square over random eyes behind a flat contact lens, c from 0.5 to 3.5 mm, tilts of 0 and
25 degrees. Most of it comes from the retina, which is no sphere."""

OUTLINE_PER_MM = 0.0001
"""Part of a spot's size by which that pinhole then misses its outline in each frame, per mm of c.

Root mean square over random eyes, perpendicular beams, withdrawals at c = 1, 3 and 5 mm. It is a
tenth of the noise of real frames, and all that is left in frames without noise."""
