"""Tip and axis of the beam, frame by frame, from all pixels of the spot.

The wall is learnt while it is looked at: a few earlier frames are kept, and the newest one is
fitted together with them (`solver`). The first is among them as long as its spot is not small
beside the newest, because a chain of frames that forgets its beginning drifts.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from threadpoolctl import ThreadpoolController

from eyespot import optics
from eyespot.estimator.camera_noise import camera_noise
from eyespot.estimator.distance.cone_range import calibrated_view
from eyespot.estimator.distance.range import Range, WallMemory
from eyespot.estimator.ghost import FRAMES_TO_DENY
from eyespot.estimator.pixels.acceptance import flag_of, ghost_pull, range_of, shake_covariance
from eyespot.estimator.pixels.beam_on_cells import BeamLight, Sweep
from eyespot.estimator.pixels.first_frame import (
    Hypothesis,
    Observation,
    distinct,
    explained_alone,
)
from eyespot.estimator.pixels.frame_fit import FARTHEST
from eyespot.estimator.pixels.frame_model import Direction, RobotPose
from eyespot.estimator.pixels.frame_pixels import FramePixels, Mix, Reference
from eyespot.estimator.pixels.later_frame import explained_with
from eyespot.estimator.pixels.pose_solver import PoseSolution
from eyespot.formats.calibration import LENS_PARAMETERS, Calibration
from eyespot.formats.inputs import InputError
from eyespot.formats.kept_arrays import kept_arrays
from eyespot.formats.microscope import MicroscopeFile
from eyespot.formats.spot import Outline, Reason
from eyespot.formats.stated import USUAL_SHAKE_PX
from eyespot.optics.wall_light.cone import UniformCone
from eyespot.optics.wall_light.lens_flux import (
    FLATTEST,
    PARAMETERS,
    TABLE_CODE,
    LensTable,
    halvings_for,
    lens_parameters,
    lens_samples,
)
from eyespot.optics.wall_light.pose_light import POSE

_SAME_SPOT_AREA_RATIO = 1.5  # ratio of areas within which an outline may be that of the last frame


_NEAREST_MM, _FARTHEST_MM = 0.25, 9.0
"""Distances of the table of a lens's light."""
_TABLE_REACH = 1.05  # radii of the light's envelope that a lens's table covers
_MAX_TABLE_CELL_PX = 1.0  # widest cell of a table; the mean light within a radius has no steps
_KNOWN = 1e-4
"""Relative error of a lens's parameter that does not matter: it is a third of a micrometre in the
distance. Each other parameter costs time in each frame."""
_LINEAR = 0.2
"""Relative change up to which the light counts as linear in a lens's parameters. What a fit knows
less well hardly changes the light, such as the rim of a cap that is lit within it, with the sag
that keeps its curvature; a frame that could change it farther would leave the table."""


class PixelRanger:
    """Finds tip, axis and distance of the beam from all pixels of frames, in their order.

    Args:
        calibration: of a cone or a lens; its standard errors count.
        microscope: with the camera's noise.
        reference: image of the wall without the spot, H x W or H x W x 3; None if there is none.
        shake_px: least standard deviation of the image's shake along each side, px.

    Raises:
        InputError: the microscope file lacks the camera's noise or has what the mode does not
            support, or the lens is impossible.
    """

    def __init__(
        self,
        calibration: Calibration,
        microscope: MicroscopeFile,
        reference: np.ndarray | None = None,
        *,
        shake_px: float = USUAL_SHAKE_PX,
    ) -> None:
        noise = camera_noise(microscope)
        if noise is None:
            raise InputError(
                "the mode pixels needs the camera's noise, which the microscope file lacks. "
                "Measure it with `eyespot camera`, or render the stack again."
            )
        if microscope.camera() is not None:
            raise InputError(
                "the mode pixels takes images without distortion; the microscope file has "
                f"distortion {list(microscope.distortion)}. Undistort the images, or take the "
                "sub-pixel mode."
            )
        self.calibration = calibration
        self.microscope = view = calibrated_view(microscope, calibration.values)
        lens = calibration.model == "lens"
        if lens:
            source, spread = _lens(calibration, view)
        else:
            angle, b, covariance = calibration.cone
            source, spread = UniformCone.of(angle, b), _root(covariance)
        self._libraries = ThreadpoolController()
        self._beam = BeamLight(
            source,
            view,
            spread,
            sharp=not lens,
            apex_mm=0.0 if lens else -calibration.values["b"],
            within_mm=(_NEAREST_MM, _FARTHEST_MM) if lens else (0.0, math.inf),
        )
        self._noise, self._shake_px = noise, shake_px
        self._reference = None if reference is None else Reference(reference, self._noise)
        self._hypotheses: list[Hypothesis] = []
        self._haunted = False  # whether the last frames show a ghost that pulls the distance
        self._ghost_pull = np.zeros(POSE)  # of a ghost that hardly does
        self._last: Outline | None = None  # in the last frame with a pose
        self._mix: Mix | None = None
        self._shaken = np.zeros((POSE, POSE))  # what the first frame's shake does, per px²
        self._drift = np.zeros(2)  # of the view, px, by the maps that were forgotten
        self._unknown_px = 0.0  # what it may have drifted since, if no map was found again

    def compile(self) -> None:
        """Compile what frames may need, or load it, so that a camera waits for none of them."""
        self._beam.compile()

    def forget(self) -> None:
        """Fit the next frame by itself, on a wall that is not known."""
        self._haunted, self._ghost_pull = False, np.zeros(POSE)
        self._drop_wall()

    def _drop_wall(self) -> None:
        """Forget the wall, but not what is known of the light."""
        if self._hypotheses:
            first = self._hypotheses[0]
            self._drift = self._drift + first.solution.drifts_px[-1]
        self._hypotheses = []

    def distance(
        self,
        outlines: Sequence[Outline],
        *,
        frame: np.ndarray,
        direction: Direction | None = None,
        sweep: Sweep | None = None,
        robot: RobotPose | None = None,
    ) -> Range:
        """The pose in the next frame, or why there is none.

        Args:
            outlines: where the spot is, see `outlines_of`.
            frame: H x W or H x W x 3.
            direction: of the beam, from the robot, eye frame.
        """
        # Several threads would wait for each other longer than they work on matrices of this size.
        with self._libraries.limit(limits=1, user_api="blas"):
            observation = Observation(FramePixels.of(frame, self._noise), direction, sweep, robot)
            if any(outline.measured for outline in outlines):
                return self._read_spot(observation, outlines[0])
            return self._read_unmeasured(observation, outlines)

    def _read_spot(self, observation: Observation, outline: Outline) -> Range:
        """The pose of a measured spot."""
        observation = self._shown(observation, outline)
        flag: Reason | None = Reason.NOT_CONVERGED
        wall = WallMemory.NEW
        if self._hypotheses:
            flag, wall = self._followed(observation, outline)
        if flag is not None:
            # Where the past does not explain the frame, it may be wrong.
            wall = WallMemory.DROPPED if self._hypotheses else WallMemory.NEW
            if self._hypotheses:
                self._reference = None  # nor does it
            self._drop_wall()
            flag = self._begun(observation, outline)
            if self._reference is not None:
                wall = WallMemory.KNOWN
                if flag is not None or self._hypotheses[0].other_wall:
                    self._reference, wall = None, WallMemory.DROPPED
                    flag = self._begun(observation, outline)
        if flag is not None:
            self._drop_wall()
            return _missing(flag, wall)
        return self._range(wall, outline)

    def _read_unmeasured(self, observation: Observation, outlines: Sequence[Outline]) -> Range:
        """The pose of a spot that was not measured, if earlier frames explain the light."""
        before = self._hypotheses
        if not before or self._last is None:
            return _missing(Reason.NOT_CONVERGED, WallMemory.NEW)
        outline = _like(self._last, outlines)
        flag, wall = self._followed(self._shown(observation, outline), outline)
        if flag is None:
            return self._range(wall, outline)
        self._hypotheses = before
        return _missing(flag, wall)

    def _shown(self, observation: Observation, outline: Outline) -> Observation:
        """The frame without what hides the spot, where its edge is sharp."""
        if not self._beam.sharp:
            return observation
        return observation._replace(picture=observation.picture.with_sharp(outline))

    def _followed(
        self, observation: Observation, outline: Outline
    ) -> tuple[Reason | None, WallMemory]:
        """Fit a frame with the earlier ones: why that failed, or None, and the wall's state."""
        assert self._mix is not None and self._last is not None
        last_px = np.array([self._last.x_px, self._last.y_px])
        continued = [
            explained_with(
                hypothesis, observation, self._mix, outline, last_px, shake_px=self._shake_px
            )
            for hypothesis in self._hypotheses
        ]
        followed = distinct([hypothesis for hypothesis in continued if hypothesis is not None])
        if not followed:
            return Reason.NOT_CONVERGED, WallMemory.DROPPED
        self._hypotheses = followed
        best = followed[0]
        self._look_for_ghost(best.solution)
        wall = WallMemory.MOVED if best.drifted(self._shake_px) else WallMemory.KNOWN
        flag = flag_of(best, outline)
        if flag is None and best.other_wall:
            flag = Reason.MISFIT  # of the wall that was learnt
        return flag, wall

    def _look_for_ghost(self, solution: PoseSolution) -> None:
        """Note what a ghost does in these frames; what earlier ones showed, a few do not deny."""
        pull = ghost_pull(solution)
        if pull is None and len(solution.frames) < FRAMES_TO_DENY:
            return
        self._ghost_pull = np.zeros(POSE) if pull is None else pull
        sigma = math.sqrt(solution.newest_covariance[2, 2])
        self._haunted = abs(self._ghost_pull[2]) > sigma

    def _begun(self, observation: Observation, outline: Outline) -> Reason | None:
        """Fit a frame by itself: why that failed; None if it did not."""
        self._hypotheses, self._mix = explained_alone(
            self._beam, self._noise, self._reference, observation, outline
        )
        flag = flag_of(self._hypotheses[0] if self._hypotheses else None, outline)
        if flag is None:
            self._shaken = shake_covariance(self._hypotheses[0].solution)
        return flag

    def _range(self, wall: WallMemory, outline: Outline) -> Range:
        best, *others = self._hypotheses
        if self._haunted:
            return _missing(Reason.GHOST, wall)
        self._last = outline if outline.measured else best.outline
        if wall is WallMemory.DROPPED:
            farthest_px = float(FARTHEST * best.solution.solver.window.side)
            self._unknown_px = max(self._unknown_px, farthest_px)
        return range_of(
            best,
            tuple(float(one.solution.newest.pose.distance) for one in others),
            wall,
            shake_px=self._shake_px,
            shaken=self._shaken,
            drift_px=self._drift,
            unknown_px=self._unknown_px,
            ghost_pull=self._ghost_pull,
        )


def _missing(flag: Reason, wall: WallMemory) -> Range:
    return Range(distance_mm=math.nan, sigma_mm=math.nan, missing=flag, wall=wall)


def _like(last: Outline, outlines: Sequence[Outline]) -> Outline:
    """The outline that may be the last one's, or the only one, or else the last one itself."""

    def apart(outline: Outline) -> float:
        return math.hypot(outline.x_px - last.x_px, outline.y_px - last.y_px)

    def alike(outline: Outline) -> bool:
        size = outline.semi_major_px * outline.semi_minor_px
        ratio = size / (last.semi_major_px * last.semi_minor_px)
        return (
            1.0 / _SAME_SPOT_AREA_RATIO < ratio < _SAME_SPOT_AREA_RATIO
            and apart(outline) < last.semi_major_px
        )

    # Behind a lens a spot may grow threefold from frame to frame; the fitted light must fill it.
    otherwise = outlines[0] if len(outlines) == 1 else last._replace(measured=False)
    return min(filter(alike, outlines), key=apart, default=otherwise)


def _lens(calibration: Calibration, view: MicroscopeFile) -> tuple[Any, np.ndarray]:
    """The table of a lens's light, and how its own parameters scatter."""
    values, names = calibration.values, list(calibration.values)
    lens = optics.glue_lens(**{name: values[name] for name in LENS_PARAMETERS if name in values})
    parameters = lens_parameters(lens)
    free = tuple(
        n for n in PARAMETERS if n in names and calibration.sigma(n) > _KNOWN * abs(values[n])
    )
    at = [names.index(name) for name in free]
    light: dict[str, Any] = {
        "medium_index": calibration.medium.index,
        "farthest": _FARTHEST_MM,
        "finest": _MAX_TABLE_CELL_PX * view.scale_mm_px,
    }
    light |= {
        "halvings": halvings_for(parameters, **light),
        "nearest": _NEAREST_MM,
        "reach": _TABLE_REACH,
    }

    def compute() -> dict[str, Any]:
        return lens_samples(parameters, free, **light).table().arrays()

    kept = kept_arrays(
        "lens_table",
        LensTable.array_names(),
        compute,
        inputs=(sorted(parameters.items()), free, sorted(light.items())),
        code=TABLE_CODE,
    )
    spread = _root(calibration.covariance[np.ix_(at, at)])
    least = {"sag": FLATTEST * parameters["aperture_radius"]}  # of a flat end
    sizes = np.array([[max(abs(values[name]), least.get(name, 0.0))] for name in free])
    change = np.max(np.abs(spread) / sizes, axis=0, initial=0.0)
    return LensTable.of_arrays(kept), spread * np.minimum(1.0, _LINEAR / np.maximum(change, 1e-300))


def _root(covariance: np.ndarray) -> np.ndarray:
    """A matrix that turns independent numbers of variance 1 into ones with this covariance."""
    if not covariance.size:
        return np.zeros((0, 0))
    values, vectors = np.linalg.eigh(covariance)
    kept = values > 1e-12 * max(values.max(), 1e-300)
    return vectors[:, kept] * np.sqrt(values[kept])
