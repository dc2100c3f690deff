"""The command `eyespot study eccentricity`."""

from __future__ import annotations

from cyclopts.types import PositiveInt

from benchmarks.reporting import Changes, OutputFolder, Quick, Seed, StartingScene

_GEOMETRIES, _GEOMETRIES_IF_QUICK = 1 << 17, 1 << 14
_FEWEST = 512


def eccentricity(
    scene: StartingScene = None,
    /,
    *,
    out: OutputFolder,
    changes: Changes = (),
    quick: Quick = False,
    seed: Seed = None,
    geometries: PositiveInt | None = None,
) -> None:
    """Measure how wrong each model is, at which eccentricity, and by which cause.

    To continue a run that was stopped, start it again with the same folder.

    Args:
        geometries: Number of random geometries (default: 131072; 16384 if quick).
    """
    from benchmarks.reporting import Request
    from benchmarks.studies.eccentricity.run import run
    from optics import InputError

    if geometries is not None and geometries < _FEWEST:
        raise InputError(
            f"--geometries must be at least {_FEWEST}, to fill each range of c; got {geometries}."
        )
    if any(change.partition("=")[0].strip() == "spot.eccentricity_mm" for change in changes):
        raise InputError(
            "spot.eccentricity_mm has no effect in this study, which varies c. Leave it out."
        )
    count = geometries or (_GEOMETRIES_IF_QUICK if quick else _GEOMETRIES)
    run(
        Request(
            out=out,
            scene=scene,
            changes=changes,
            quick=quick,
            seed=seed,
            options={"geometries": count},
        )
    )
