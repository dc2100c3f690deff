"""Studies: each one command, `eyespot study NAME [SCENE] --out DIR`, each with a report.

study         the frame that all share: folder, scene, stacks, CSV, figures, page
calibrations  what a scene truly is, or a study found, for `estimator.Ranger`
eccentricity  model error against where the spot is; its parts:
    geometries  the points of its space, and the errors of all models there
    thresholds  at which c a model leaves a limit, with and without c fitted
    rendered    frames -> spots -> errors
    causes      the error split by cause: the measurement chain, link by link
    shapley     what each player adds to a whole
    eccentricity_figures, eccentricity_conclusions, eccentricity_report  pictures, words, tables
static        Tables I and II over many runs, and what adds to their error; its parts:
    static_bench, static_photographs  many photographs of few rendered frames
    static_causes, static_lines, static_tables  draws, parts, lines, tables
    static_figures, static_report     pictures and words
pose          tip and axis from one spot and from three; its parts:
    pose_tool       a tool with one cone or three: spots, bounds, the fit of all at once
    pose_analytic   exact contours with noise, over the working volume
    pose_rendered   frames -> spots -> poses
    pose_errors     rows, drawn priors, root mean squares
    pose_figures, pose_report  pictures and words
medium        calibrated in air, used in vitreous; its parts:
    medium_light    what a medium makes of a lens's radii, from its light
    medium_rendered  frames -> spots -> distances
    medium_report   pictures and words
table_one     which lenses give Table I, and what sets its trials apart; its parts:
    table_one_scan      lenses and thresholds in closed form
    table_one_rendered  some of them on rendered stacks
    table_one_causes    what touch, light, tilt and range do to a line
    table_one_moments   what the printed figures imply
    table_one_figure, table_one_conclusions, table_one_report  picture, words, tables
dynamic       the error while the tip moves: blur, the age of poses, latency; its parts:
    dynamic_trials   motions, and their twins without blur
    dynamic_measure  stacks -> readings -> rows; calibration at rest
    dynamic_parts    the split, sizes by speed, the speed at which a limit is reached
    dynamic_figures, dynamic_report   pictures and words

A study is one module with `run(request)`, thin on what it shares with others::

    def run(request: Request) -> None:
        study = Study("pose", request, defaults=("source.kind=cone",))
        stack = study.stack("tilt-10", scenes.changed(study.scene, {"spot.incidence_deg": 10.0}))
        rows: list[PoseError] = ...              # a NamedTuple a CSV file, units in the names
        study.publish(
            Report(
                title="How well one spot tells the tip's pose",
                lead="One sentence on what was done.",
                found=[Conclusion("bounds", "The bound is 5 µm.", "The numbers behind it.")],
                sections=[
                    Section(
                        "Errors against tilt",
                        Picture("tilt", figure, "What is drawn.", data="pose_error.csv"),
                        Table(("tilt, °", "error, mm"), cells, "What is listed."),
                        "A paragraph of text.",
                    )
                ],
                data=[Data("pose_error.csv", PoseError, rows)],
            )
        )

and one command in `eyespot.py` with the options that all studies take. A stopped run goes on where
it was: stacks that are whole are not rendered again. What takes long beside them belongs into files
of its own under `study.folder`. The command, versions, scene and times in a report are the frame's.
"""

from benchmarks.studies.study import Data as Data
from benchmarks.studies.study import Picture as Picture
from benchmarks.studies.study import Report as Report
from benchmarks.studies.study import Request as Request
from benchmarks.studies.study import Row as Row
from benchmarks.studies.study import Section as Section
from benchmarks.studies.study import Study as Study
from benchmarks.studies.study import Table as Table
