"""`eyespot study rivals`: one distance by the spot, by the instrument's shadow, and by stereo.

DIR/expected.csv     standard deviations of the three by stated noise of their marks
    wrong.csv        errors if one of the things that they take as known is wrong
    readings.csv     distances read from rendered pictures
    stacks/, spots/  rendered spots, and what the estimator measured of them
"""

from __future__ import annotations

import numpy as np

from benchmarks.reporting import Request, Study
from benchmarks.studies.rivals import rendered
from benchmarks.studies.rivals.expected import expected
from benchmarks.studies.rivals.findings import RivalFindings
from benchmarks.studies.rivals.report import report
from benchmarks.studies.rivals.setup import PATHS, views

_ECCENTRICITIES_MM = np.array([0.0, 1.5, 3.0])
_DISTANCES_MM = np.array([0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0])
_DRAWS, _QUICK_DRAWS = 200, 50
_WALLS = ("printed paper", "retina", "uniform")
_RENDERED_C_MM, _QUICK_C_MM = (0.0, 3.0), (0.0,)
_RENDERED_D_MM, _QUICK_D_MM = [1.0, 3.0, 5.0], [1.0, 4.0]


def run(request: Request) -> RivalFindings:
    """Compute, render, measure and report.

    Args:
        request: the arguments; of the scene the seed and the camera are used.

    Raises:
        InputError: the folder has other files.
        RendererUnavailable: Mitsuba cannot run here.
    """
    study = Study("rivals", request)
    quick = request.quick
    paths = [*PATHS][:2] if quick else [*PATHS]
    noise, wrong = [], []
    with study.timed("expected"):
        pinholes = views("pinhole")
        for path in paths:
            some, biases = expected(
                path,
                views(path),
                pinholes,
                eccentricities=_ECCENTRICITIES_MM,
                distances=_DISTANCES_MM,
                draws=_QUICK_DRAWS if quick else _DRAWS,
                seed=study.seed,
            )
            noise += some
            wrong += biases
    every = rendered.trials(
        study.scene,
        paths=paths,
        walls=(_WALLS[0], _WALLS[-1]) if quick else _WALLS,
        eccentricities=_QUICK_C_MM if quick else _RENDERED_C_MM,
        distances=_QUICK_D_MM if quick else _RENDERED_D_MM,
    )
    with study.timed("render and measure spots"):
        readings = rendered.by_spots(study, every)
    with study.timed("render and measure shadows and stereo pairs"):
        others, kept = rendered.by_pictures(every)
    findings = RivalFindings(
        scene=study.scene,
        expected=noise,
        wrong=wrong,
        readings=readings + others,
        photographs=kept,
    )
    study.publish(report, findings)
    return findings
