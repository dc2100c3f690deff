"""The report: the errors of the models first, then the paper's tables."""

from __future__ import annotations

from collections import Counter

from benchmarks.evaluation import (
    ACCEPTABLE_ERROR_MM,
    COMPARED,
    USED,
    WAYS,
    Accuracy,
    ModelError,
    accuracy,
    model_error_figure,
)
from benchmarks.reporting import Column, Picture, Report, Section, Table, frame_of
from benchmarks.studies.validate import figures
from benchmarks.studies.validate.analysis import ambiguous_range, half_maximum_curve
from benchmarks.studies.validate.claims import claims
from benchmarks.studies.validate.findings import (
    CHOSEN_ECCENTRICITIES_MM,
    FrameRow,
    PlaneFitRow,
    SphereFitRow,
    SpotRow,
    ValidateFindings,
)
from benchmarks.studies.validate.strip import StripRow, shown_frames, strip_figure, strip_row
from benchmarks.studies.validate.tables import (
    frame_rows,
    plane_rows,
    sphere_rows,
    spot_rows,
    square_rows,
)

_STRIPS = {"plane 1": "printed plane", "sphere 1": "eyeball phantom"}


def report(findings: ValidateFindings) -> Report:
    """The report of a run.

    Raises:
        StackError: a stack that the strips of frames need is missing or broken.
    """
    planes, spheres = plane_rows(findings), sphere_rows(findings)
    spots, frames = spot_rows(findings), frame_rows(findings)
    strips = {group: shown_frames(findings, group) for group in _STRIPS}
    left_out = [row for row in frames if row.outcome != USED]
    by_reason: Counter[str] = Counter()
    for row in left_out:
        by_reason[row.outcome] += row.frames
    chosen = [e for c in CHOSEN_ECCENTRICITIES_MM for e in square_rows(findings.analytic, c=c)]
    rendered_accuracy = accuracy(findings.rendered)
    drawn = figures.SpotFigures(findings, spots)
    return Report(
        title="How accurate is a distance measured from a spot of light?",
        lead="The static experiment of Zhou et al. 2020 (“Spotlight-based 3D Instrument Guidance "
        "for Retinal Surgery”) on rendered images whose truth is known, and its small-plane model "
        "against the exact geometry.",
        claims=list(claims(findings)),
        sections=[
            _models(findings),
            Section(
                "Frames",
                *(
                    Picture(
                        f"strip_{group.replace(' ', '_')}",
                        strip_figure(lines, stacks=findings.stacks),
                        f"The tip withdraws from the {_STRIPS[group]}; d is the distance from tip "
                        "to wall along the beam. Blue: the measured ellipse (literal mode in paper "
                        "frames, sub-pixel mode in metered ones). Orange, dashed: the true contour "
                        "at half of the noise-free, unoccluded peak. Paper frames share one "
                        "exposure; metered frames put the spot's peak at "
                        f"{findings.trials[0].scene.exposures.metered_peak:.0%} of full scale.",
                        data="strip.csv",
                        inline="jpeg",
                    )
                    for group, lines in strips.items()
                ),
            ),
            _measured(findings, drawn),
            _fits(findings, planes, spheres, drawn),
            _frames_used(findings),
            _trials(findings),
        ],
        data={
            "model_error.csv": frame_of(ModelError, findings.analytic + findings.rendered),
            "rendered_accuracy.csv": frame_of(Accuracy, rendered_accuracy),
            "table_1.csv": frame_of(PlaneFitRow, planes),
            "table_2.csv": frame_of(SphereFitRow, spheres),
            "spots.csv": frame_of(SpotRow, spots),
            "frames.csv": frame_of(FrameRow, frames),
            "strip.csv": frame_of(
                StripRow,
                [strip_row(shown) for lines in strips.values() for line in lines for shown in line],
            ),
        },
        summary={
            "plane_fits": [row._asdict() for row in planes],
            "sphere_fits": [row._asdict() for row in spheres],
            "model_errors": [row._asdict() for row in chosen],
            "rendered_accuracy": [row._asdict() for row in rendered_accuracy],
            "left_out": dict(by_reason),
            "left_out_by_trial": [row._asdict() for row in left_out],
        },
    )


def _models(findings: ValidateFindings) -> Section:
    square = [e for c in CHOSEN_ECCENTRICITIES_MM for e in square_rows(findings.analytic, c=c)]
    places = list(dict.fromkeys((e.c_mm, e.d_mm) for e in square))
    by_place = {(e.z_f_mm, e.model, e.c_mm, e.d_mm): e.error_mm for e in square}
    rows = [
        (model, height, *(by_place[height, model, *place] for place in places))
        for height in dict.fromkeys(e.z_f_mm for e in square)
        for model in COMPARED
    ]
    columns = [Column(f"c {c:g}, d {d:.2g} mm", sign=True) for c, d in places]
    return Section(
        "The models against the exact geometry",
        Picture(
            "model_error",
            model_error_figure(findings.analytic, findings.rendered),
            "Error of the distance against eccentricity c, on exact contours (lines; dotted: square"
            " beam) and on spots measured in rendered frames of the ideal cone (dots, at the "
            "rendered distances). Every model is given the true k, b, c and r. The paper puts the "
            "pinhole F on the eyeball's sphere in its equation for FP, and at the eyeball's centre "
            "in the caption of the figure that goes with it; a real microscope has z_F near 200 "
            f"mm. Dashed: the {ACCEPTABLE_ERROR_MM} mm that the paper calls acceptable.",
            data="model_error.csv",
        ),
        Picture(
            "model_error_size",
            figures.model_error_size(findings),
            "The largest absolute error over all distances, on exact contours (lines) and rendered "
            "spots (marks), at the incidence of the frames. On exact contours the model exact has "
            "no error by construction and is not drawn. Dashed: the acceptable error.",
            data="rendered_accuracy.csv",
        ),
        Table(
            [Column("model"), Column("z_F, mm", 1), *columns],
            rows,
            "Errors in mm on exact contours, the beam square to the wall.",
            data="model_error.csv",
        ),
        Table.of_rows(
            Accuracy,
            accuracy(findings.rendered),
            "Errors on rendered spots of the ideal cone at all c and d of the grid, sub-pixel "
            "mode. Azimuth: direction of the beam's tilt, 0° towards growing c.",
            data="rendered_accuracy.csv",
        ),
    )


def _measured(findings: ValidateFindings, drawn: figures.SpotFigures) -> Section:
    pictures = [
        Picture(
            "bias",
            drawn.bias(),
            "Bias of each way of measuring: measured minus true e₁′. The truth is the half-maximum "
            "contour (for the ideal cone, its edge). The literal mode cuts at grey level 200, "
            "wherever that lies on the spot's profile.",
            data="spots.csv",
        )
    ]
    curve = half_maximum_curve(findings)
    if curve is not None:
        pictures.append(
            Picture(
                "half_maximum",
                drawn.half_maximum(ambiguous_range(*curve)),
                "Semi-minor axis of the lens's spot on the first plane. Where the black curve "
                "falls or has the height of another of its points (shaded), a half-maximum radius "
                "alone does not determine the distance. Dashed: the straight cone fitted to the "
                "black curve (label “cone”).",
                data="spots.csv",
            )
        )
    return Section("Measured and true spots", *pictures)


def _fits(
    findings: ValidateFindings,
    planes: list[PlaneFitRow],
    spheres: list[SphereFitRow],
    drawn: figures.SpotFigures,
) -> Section:
    if not planes:
        return Section("The paper's Tables I and II", "Too few spots for any fit.")
    return Section(
        "The paper's Tables I and II",
        Table.of_rows(
            PlaneFitRow,
            planes,
            "Table I: fits of d_r = δk e₁′ + b on the plane, with standard errors, and the paper's "
            "values for its own trials. −b/δk is the radius at contact in px. The paper calls b a "
            "diameter, but its value is minus the distance from the virtual apex to the tip.",
            data="table_1.csv",
        ),
        Picture(
            "plane_fit",
            drawn.plane_fit(),
            "Reading d_r against the measured semi-minor axis e₁′ on the plane, with each trial's "
            "line, the line of all trials and, dotted, the paper's. d_r is 0 at contact, where the "
            "tip's rim touches.",
            data="spots.csv",
        ),
        Picture(
            "plane_residuals",
            drawn.residuals(findings.plane_fits),
            "Residuals of each trial's line; rms over all trials.",
            data="spots.csv",
        ),
        Table.of_rows(
            SphereFitRow,
            spheres,
            "Table II: fits of the small-plane model in the eyeball. δk and b come from all "
            "planes, and c is the only free parameter. The scenes have the c that the paper "
            "prints. “Expected” is the c whose cos φ is the correct first-order factor of the true "
            "c. The largest error is 0.372 mm in the paper's text and 0.396 mm in its table.",
            data="table_2.csv",
        ),
        Picture(
            "sphere_fit",
            drawn.sphere_fit(),
            "Reading d_r against e₁′ in the eyeball, with the small-plane model at the fitted c.",
            data="spots.csv",
        ),
        Picture(
            "sphere_residuals",
            drawn.residuals(findings.sphere_fits),
            "Residuals of the fits of c, rms over all trials (the paper's error figure, over "
            "distance instead of index). A small residual does not show that the model is right, "
            "because c compensates for the model's error.",
            data="spots.csv",
        ),
    )


def _frames_used(findings: ValidateFindings) -> Section:
    outcomes: dict[str, dict[str, Counter[str]]] = {}
    for trial in findings.trials:
        line = f"grid, {trial.group}" if trial.kind == "grid" else f"{trial.source}, {trial.group}"
        for way in WAYS:
            if (trial.name, way.name) in findings.tracked:
                counts = outcomes.setdefault(line, {}).setdefault(way.name, Counter())
                counts.update(findings.tracked[trial.name, way.name].outcomes)
    rows = [
        (line, way, ", ".join(f"{count} {outcome}" for outcome, count in counts.most_common()))
        for line, by_way in outcomes.items()
        for way, counts in by_way.items()
    ]
    return Section(
        "Frames used and left out",
        Table(
            [Column("trial"), Column("way"), Column("frames")],
            rows,
            "Frames that the fits use, and the reasons why others are left out. A frame is used if "
            "a spot was found and the instrument hides less than half of the true contour.",
            data="frames.csv",
        ),
    )


def _trials(findings: ValidateFindings) -> Section:
    headings = ("stack", "source", "wall", "c, mm", "azimuth, °", "incidence, °", "z_F, mm", "seed")
    rows = [
        (
            *(trial.name, trial.source, trial.scene.phantom.kind),
            *(trial.scene.spot.eccentricity_mm, trial.scene.spot.azimuth_deg),
            *(trial.scene.spot.incidence_deg, trial.scene.microscope.pinhole_height_mm),
            trial.scene.seed,
        )
        for trial in findings.trials
    ]
    return Section(
        "The trials",
        Table(
            [Column(heading, 1) for heading in headings],
            rows,
            "In each trial the tip withdraws at 0.1 mm/s, without motion blur. (The paper states "
            "0.1 mm/s in one place and 0.01 mm/s in another.)",
        ),
    )
