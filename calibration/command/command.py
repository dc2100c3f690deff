"""The command `eyespot fit`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from estimator.run import Exposure


def fit(
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="SOURCE…",
            help="Recordings of withdrawals from contact, all with one microscope: stacks, spots "
            "files or ROS bags.",
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            metavar="FILE",
            help="Calibration file (JSON) to write. The report is written beside it, as .html. "
            "Neither may exist.",
        ),
    ],
    model: Annotated[
        Literal["auto", "cone", "eye", "plane", "sphere", "image", "lens"],
        typer.Option(
            help="Model to fit; auto chooses cone or lens by how sharp the spots' edges are. "
            "Fitted to spots: cone, the exact geometry; eye, how an unknown eye and its viewing "
            "lens show a cone that is known (--cone); plane, the paper's line through planes; "
            "sphere, the paper's eccentricity of one eyeball, beside planes. Fitted to all pixels "
            "of one stack: image, a cone; lens, a glue lens."
        ),
    ] = "auto",
    exposure: Exposure = None,
    free: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,…",
            help="Parameters to fit (default: half_angle,b; of a lens sag,numerical_aperture). A "
            "cone has half_angle, b, scale, eye_radius, inverse_working_distance, tilt_x, tilt_y; "
            "a lens has sag, numerical_aperture, glue_index and others. In the fits to pixels, "
            "spread is the length over which the wall spreads light.",
        ),
    ] = None,
    prior: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=MEAN,SIGMA",
            help="Prior knowledge of a fitted parameter (mm, rad), or of touch, the distance in "
            "the first frame. Repeatable.",
        ),
    ] = None,
    robust: Annotated[
        bool,
        typer.Option("--robust", help="Find outliers and fit without them (plane, sphere)."),
    ] = False,
    lens: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Preset or lens file to start the model lens from, within 30 % (default: guessed "
            "from the spots).",
        ),
    ] = None,
    cone: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Calibration of the same fibre in the same medium, made on a phantom, for the "
            "model eye.",
        ),
    ] = None,
    microscope: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Microscope file of the sources; a stack contains its own."
        ),
    ] = None,
    poses: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help="Robot poses (CSV or ROS bag), one file per source in the same order; a stack "
            "contains its own, and a ROS bag may.",
        ),
    ] = None,
    phantom: Annotated[
        list[str] | None,
        typer.Option(
            metavar="plane|eyeball",
            help="Shape of the wall, given once or once per source; a stack contains it.",
        ),
    ] = None,
    medium: Annotated[
        str | None,
        typer.Option(help="Medium between tip and wall: air, water, …; a stack contains it."),
    ] = None,
    fibre_diameter_mm: Annotated[
        float,
        typer.Option(
            help="Diameter of the tip's face, whose rim touches the wall first; a stack contains "
            "it."
        ),
    ] = 0.5,
    eye_from_robot: Annotated[
        str | None,
        typer.Option(
            metavar="QX,QY,QZ,QW",
            help="Rotation (unit quaternion) from the poses' frame to the eye's.",
        ),
    ] = None,
    rerun: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|live",
            help="Record frames, spots, distances and residuals of a good fit for the viewer rerun "
            "(.rrd), or show them in it at once.",
        ),
    ] = None,
) -> None:
    """Fit a model of the light beam to recordings and write a calibration file.

    The file serves `eyespot track --calibration`. A fit that fails its checks writes its report
    only, says why, and ends with exit code 2. If the model misses a small part of the light, the
    file is written with standard deviations that contain this misfit, and the misfit is described.
    """
    from calibration.command.fitting import run

    run(
        sources,
        model=model,
        out=out,
        exposure=exposure,
        free=None if free is None else free.split(","),
        priors=prior or (),
        robust=robust,
        lens=lens,
        cone=cone,
        microscope=microscope,
        poses=poses or (),
        phantoms=phantom or (),
        medium=medium,
        fibre_diameter_mm=fibre_diameter_mm,
        eye_from_robot=eye_from_robot,
        rerun=rerun,
    )
