"""The command `eyespot fit`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from estimator.run import Exposure, Rerun

_PLACE = Parameter(group="Sources other than stacks")


def fit(
    *sources: Annotated[Path, Parameter(required=True)],
    out: Path,
    model: Literal["auto", "cone", "eye", "plane", "sphere", "image", "lens"] = "auto",
    exposure: Exposure = None,
    free: Annotated[str | None, Parameter(metavar="NAME,…")] = None,
    priors: Annotated[
        tuple[str, ...], Parameter("--prior", metavar="NAME=MEAN,SIGMA", show_default=False)
    ] = (),
    robust: bool = False,
    lens: str | None = None,
    cone: Path | None = None,
    microscope: Annotated[Path | None, _PLACE] = None,
    poses: Annotated[tuple[Path, ...], _PLACE] = (),
    phantoms: Annotated[
        tuple[str, ...], Parameter("--phantom", metavar="plane|eyeball"), _PLACE
    ] = (),
    medium: Annotated[str | None, _PLACE] = None,
    fibre_diameter_mm: Annotated[float, _PLACE] = 0.5,
    eye_from_robot: Annotated[
        str | None, Parameter(metavar="QX,QY,QZ,QW", allow_leading_hyphen=True), _PLACE
    ] = None,
    rerun: Rerun = None,
) -> None:
    """Fit a model of the light beam to recordings and write a calibration file.

    The file serves `eyespot track --calibration`. A fit that fails its checks writes its report
    only, says why, and ends with exit code 2. If the model misses a small part of the light, the
    file is written with standard deviations that contain this misfit, and the misfit is described.

    Args:
        sources: Recordings of withdrawals from contact, all with one microscope: stacks, spots
            files or ROS bags.
        out: Calibration file (JSON) to write. The report is written beside it, as .html. Neither
            may exist.
        model: Model to fit; auto chooses cone or lens by how sharp the spots' edges are. Fitted to
            spots: cone, the exact geometry; eye, how an unknown eye and its viewing lens show a
            cone that is known (--cone); plane, the paper's line through planes; sphere, the
            paper's eccentricity of one eyeball, beside planes. Fitted to all pixels of one stack:
            image, a cone; lens, a glue lens.
        free: Parameters to fit (default: half_angle,b; of a lens sag,numerical_aperture). A cone
            has half_angle, b, scale, eye_radius, inverse_working_distance, tilt_x, tilt_y; a lens
            has sag, numerical_aperture, glue_index and others. In the fits to pixels, spread is
            the length over which the wall spreads light.
        priors: Prior knowledge of a fitted parameter (mm, rad), or of touch, the distance in the
            first frame. Repeatable.
        robust: Find outliers and fit without them (plane, sphere).
        lens: Preset or lens file to start the model lens from, within 30 % (default: guessed from
            the spots).
        cone: Calibration of the same fibre in the same medium, made on a phantom, for the model
            eye.
        microscope: Microscope file of the sources; a stack contains its own.
        poses: Robot poses (CSV or ROS bag), one file per source in the same order; a stack contains
            its own, and a ROS bag may.
        phantoms: Shape of the wall, given once or once per source; a stack contains it.
        medium: Medium between tip and wall: air, water, …; a stack contains it.
        fibre_diameter_mm: Diameter of the tip's face, whose rim touches the wall first; a stack
            contains it.
        eye_from_robot: Rotation (unit quaternion) from the poses' frame to the eye's.
        rerun: Record frames, spots, distances and residuals of a good fit for the viewer rerun
            (.rrd), or show them in it at once.
    """
    from calibration.command.fitting import run

    run(
        sources,
        model=model,
        out=out,
        exposure=exposure,
        free=None if free is None else free.split(","),
        priors=priors,
        robust=robust,
        lens=lens,
        cone=cone,
        microscope=microscope,
        poses=poses,
        phantoms=phantoms,
        medium=medium,
        fibre_diameter_mm=fibre_diameter_mm,
        eye_from_robot=eye_from_robot,
        rerun=rerun,
    )
