"""The command `eyespot`: reads arguments, calls the packages, turns errors into exit codes.

JAX and Mitsuba take seconds to load, so every command imports what it needs when it runs.

Exit codes:
    0    done
    1    `eyespot doctor` found something missing; any other command: a bug, with its traceback
    2    bad input, or a part of this machine that is missing; one message on stderr says which
    130  stopped with Ctrl-C
"""

from __future__ import annotations

import errno
import importlib
import importlib.metadata
import importlib.util
import os
import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

PACKAGES = ("optics", "scenes", "estimator", "calibration", "benchmarks")

SCENE_SCHEMA = "scene.schema.json"
"""Name under which `eyespot scene init` looks for what `eyespot scene schema` prints."""

REMEDIES = {
    errno.EACCES: "Choose a place that you may write to.",
    errno.EEXIST: "Name another one; nothing is written over.",
    errno.ENOENT: "Check the path.",
    errno.ENOSPC: "Free some space, or choose another disk.",
    errno.ENOTDIR: "A part of this path is a file; choose a folder.",
    errno.EROFS: "Choose a place that can be written to.",
}
"""What to do about an error of the operating system."""

app = typer.Typer(
    help="How far can a distance be trusted that was read off a spot of light in a microscope "
    "image?",
    epilog="EYESPOT_TRACEBACK=1 in the environment shows where an error message came from.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
scene_commands = typer.Typer(help="Write and check scene files.", no_args_is_help=True)
app.add_typer(scene_commands, name="scene")


class SpecFirst(typer.core.TyperGroup):
    """`eyespot dataset SPEC` means `eyespot dataset make SPEC`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """What is no command of the group belongs to `make`."""
        known = (*self.commands, *ctx.help_option_names)
        return super().parse_args(ctx, args if not args or args[0] in known else ["make", *args])


dataset_commands = typer.Typer(
    cls=SpecFirst,
    help="Make labelled sets, and prove that one is whole. `eyespot dataset SPEC` is `make SPEC`.",
    no_args_is_help=True,
)
app.add_typer(dataset_commands, name="dataset")
study_commands = typer.Typer(
    help="Studies, each with a report, CSV files and figures.", no_args_is_help=True
)
app.add_typer(study_commands, name="study")

OutputFolder = Annotated[
    Path, typer.Option("--out", metavar="DIR", help="Folder for the results; made if missing.")
]
SceneFile = Annotated[Path, typer.Argument(metavar="SCENE", help="Scene file (TOML).")]
StartingScene = Annotated[
    Path | None,
    typer.Argument(metavar="SCENE", help="Scene file (TOML) to start from; or the study's own."),
]
Quick = Annotated[bool, typer.Option("--quick", help="A smaller study, for a first look.")]
Seed = Annotated[
    int | None, typer.Option(help="Of whatever is drawn at random; the scene's own.", min=0)
]
Changes = Annotated[
    list[str],
    typer.Option(
        "--set", metavar="KEY=VALUE", help="Another value for a scene's key, camera.bit_depth=12."
    ),
]


@app.command()
def validate(
    out: OutputFolder,
    quick: Annotated[bool, typer.Option("--quick", help="Fewer frames, for a first look.")] = False,
    seed: Annotated[int, typer.Option(help="Seed of camera noise and wall texture.", min=0)] = 0,
    source: Annotated[
        Literal["both", "lens", "cone"],
        typer.Option(help="The fibre with its glue lens, the ideal sharp cone, or both."),
    ] = "both",
) -> None:
    """Repeat the paper's static experiment on rendered images and write a report.

    A run that was stopped goes on where it was when it is given the same folder.
    """
    from benchmarks.studies.validate import run as experiment

    experiment.run(out=out, quick=quick, seed=seed, source=source)


@app.command()
def render(
    scene: SceneFile,
    out: OutputFolder,
    preview: Annotated[
        bool, typer.Option("--preview", help="One small frame only: the image DIR.png.")
    ] = False,
    changes: Changes = [],  # noqa: B006 - typer reads it, nobody writes
    variant: Annotated[
        Literal["llvm_ad_rgb", "cuda_ad_rgb", "scalar_rgb"],
        typer.Option(
            help="Mitsuba's: for the processor, for an NVIDIA GPU, or without LLVM, for a cone and "
            "a minute a frame."
        ),
    ] = "llvm_ad_rgb",
) -> None:
    """Render a scene file to an image stack with labels.

    A run that was stopped goes on where it was when it is given the same folder.
    """
    from rich.progress import Progress

    import scenes

    settings = scenes.load_scene(scene, changes)
    if preview:
        # Beside the stack's folder, which does not exist before the stack is whole.
        image = out.with_name(f"{out.name}.png")
        scenes.write_preview(settings, image, variant=variant)
        typer.echo(f"Wrote {image}.")
        return
    with Progress(transient=True) as progress:
        task = progress.add_task("Rendering", total=scenes.frame_count(settings))
        scenes.render_stack(settings, out, variant=variant, progress=lambda: progress.advance(task))
    typer.echo(f"Wrote the stack {out}.")


@app.command()
def track(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="Stack, folder of images, TIFF, video, ROS bag, or number of a camera.",
        ),
    ],
    out: Annotated[
        Path, typer.Option("--out", metavar="FILE", help="Spots file, .csv or .parquet; new.")
    ],
    mode: Annotated[
        Literal["subpixel", "literal"],
        typer.Option(help="The half-maximum contour, or the paper's algorithm step by step."),
    ] = "subpixel",
    start: Annotated[
        str, typer.Option(metavar="X,Y|auto", help="Spot in the first frame, px, or find it.")
    ] = "auto",
    exposure: Annotated[
        Literal["paper", "metered"] | None, typer.Option(help="Of a stack that holds both.")
    ] = None,
    microscope: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="microscope.json or a calibration of OpenCV's; a stack has its own.",
        ),
    ] = None,
    pinhole_height_mm: Annotated[
        float | None,
        typer.Option(help="Above the eyeball's centre, for a microscope file of OpenCV's."),
    ] = None,
    eye_radius_mm: Annotated[
        float | None, typer.Option(help="For a microscope file of OpenCV's.")
    ] = None,
    calibration: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Turns spots into distances.")
    ] = None,
    model: Annotated[
        str | None, typer.Option(help="Of the distance; the calibration's own by default.")
    ] = None,
    eccentricity_mm: Annotated[
        float | None, typer.Option(help="Of the spots; read off their positions by default.")
    ] = None,
    exposure_s: Annotated[
        float | None, typer.Option(help="Exposure time, for the model lens; a stack has its own.")
    ] = None,
    poses: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The robot's poses, CSV or ROS bag, on SOURCE's clock."),
    ] = None,
    eye_from_robot: Annotated[
        str | None,
        typer.Option(
            metavar="QX,QY,QZ,QW",
            help="Turns the poses' frame into the eye's, for the model exact.",
        ),
    ] = None,
    image_topic: Annotated[
        str | None, typer.Option(help="Of a bag, if not the rig's and not the only one.")
    ] = None,
    pose_topic: Annotated[
        str | None, typer.Option(help="Of a bag, if not the rig's and not the only one.")
    ] = None,
    overlay: Annotated[
        Path | None,
        typer.Option(metavar="VIDEO|DIR", help="Draw the spots: .mp4, .avi, or a folder; new."),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object, and nothing else.")
    ] = False,
) -> None:
    """Measure the spot in every frame and write a spots file.

    Ctrl-C ends it and keeps the frames measured so far; that is how a camera is stopped.
    """
    # OpenCV and FFmpeg tell in their own words what comes back as one error.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    from estimator.run import command as track_command

    track_command.run(
        source,
        out=out,
        mode=mode,
        start=start,
        exposure=exposure,
        image_topic=image_topic,
        microscope_file=microscope,
        pinhole_height_mm=pinhole_height_mm,
        eye_radius_mm=eye_radius_mm,
        calibration_file=calibration,
        model=model,
        eccentricity_mm=eccentricity_mm,
        exposure_s=exposure_s,
        poses_file=poses,
        pose_topic=pose_topic,
        eye_from_robot=eye_from_robot,
        overlay_path=overlay,
        as_json=as_json,
    )


@app.command()
def fit(
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="SOURCE…",
            help="Withdrawals from contact, seen by one microscope: stacks, spots files, bags.",
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="FILE", help="Calibration (JSON); new. A report stands beside it."
        ),
    ],
    model: Annotated[
        Literal["cone", "plane", "sphere", "image", "lens"],
        typer.Option(
            help="To spots: the exact geometry; the paper's line through the planes; or its "
            "eccentricity of one eyeball beside them. To all pixels of one stack: a cone (image) "
            "or a glue lens."
        ),
    ] = "cone",
    exposure: Annotated[
        Literal["paper", "metered"] | None, typer.Option(help="Of stacks that hold both.")
    ] = None,
    free: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,…",
            help="What the fit finds. cone: half_angle, b, scale, eye_radius, "
            "inverse_working_distance, tilt_x, tilt_y; lens: sag, numerical_aperture, glue_index, "
            "…  [default: half_angle,b; of a lens sag,numerical_aperture]",
        ),
    ] = None,
    prior: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=MEAN,SIGMA",
            help="Known beforehand of a free parameter (mm, rad), or of touch, the distance at "
            "the first frame. Repeatable.",
        ),
    ] = None,
    robust: Annotated[
        bool,
        typer.Option("--robust", help="Name outliers and leave them out; models plane, sphere."),
    ] = False,
    lens: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="Preset or lens file that the model lens starts from, 30 % off."
        ),
    ] = None,
    microscope: Annotated[
        Path | None, typer.Option(metavar="FILE", help="microscope.json; a stack has its own.")
    ] = None,
    poses: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help="The robot's poses, CSV or bag, of each source in turn; a stack has its own, and "
            "a bag may.",
        ),
    ] = None,
    phantom: Annotated[
        list[str] | None,
        typer.Option(
            metavar="plane|eyeball", help="Of each source in turn, or of all; a stack tells."
        ),
    ] = None,
    medium: Annotated[
        str | None, typer.Option(help="Between tip and wall: air, water, …; a stack tells.")
    ] = None,
    fibre_diameter_mm: Annotated[
        float, typer.Option(help="Of the tip's face, whose rim touches first; a stack tells.")
    ] = 0.5,
    eye_from_robot: Annotated[
        str | None,
        typer.Option(metavar="QX,QY,QZ,QW", help="Turns the poses' frame into the eye's."),
    ] = None,
) -> None:
    """Fit the beam to withdrawals and write a calibration for `eyespot track`.

    A fit that is not good writes its report alone, says why, and ends with exit code 2; one whose
    only fault is that its errors are too large is written and not called good.
    """
    from calibration.command import command as fit_command

    fit_command.run(
        sources,
        model=model,
        out=out,
        exposure=exposure,
        free=None if free is None else free.split(","),
        priors=prior or (),
        robust=robust,
        lens=lens,
        microscope=microscope,
        poses=poses or (),
        phantoms=phantom or (),
        medium=medium,
        fibre_diameter_mm=fibre_diameter_mm,
        eye_from_robot=eye_from_robot,
    )


@app.command()
def export(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Labelled set or stack.")],
    to: Annotated[
        Literal["hdf5", "ome-tiff", "coco", "webdataset", "rosbag1", "rosbag2"],
        typer.Option(help="Format; benchmarks/sets/formats says what each holds."),
    ],
    out: Annotated[
        Path, typer.Option("--out", metavar="PATH", help="File (hdf5) or folder to write; new.")
    ],
) -> None:
    """Write a labelled set, or one stack, in another format."""
    from benchmarks.sets.formats import export as exporting

    exporting.run(folder, to=to, out=out)


@app.command()
def score(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Labelled set or stack.")],
    spots: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="SPOTS…",
            help="Spots files with names as seen from DIR, or folders of SPLIT/STACK.csv.",
        ),
    ] = None,
    mode: Annotated[
        Literal["literal", "subpixel", "both"] | None,
        typer.Option(help="Measure with our estimator, too, and score that."),
    ] = None,
    against: Annotated[
        Literal["half_max", "cone"], typer.Option(help="The ellipse that is the truth.")
    ] = "half_max",
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for tables and figure; new."),
    ] = None,
) -> None:
    """Say how good an estimator's spots of a labelled set are."""
    from benchmarks.sets.score import command as score_command

    score_command.run(folder, spots or [], mode=mode, against=against, out=out)


PLAIN_STUDIES = {
    "static": "The paper's Tables I and II over many runs, and what adds to their error.",
    "table-one": "Which lenses give the paper's Table I, and what sets its trials apart.",
    "medium": "What a calibration in air is worth in vitreous, and what the lens model makes of "
    "it.",
    "pose": "Tip and axis from one spot and from three, beside their bounds and the mirror "
    "solution.",
}
"""Studies without options of their own."""


def add_study(name: str, question: str) -> None:
    """Make `eyespot study NAME` of the module of that name."""
    goes_on = "A run that was stopped goes on where it was when it is given the same folder."

    @study_commands.command(name, help=f"{question}\n\n{goes_on}")
    def study(
        out: OutputFolder,
        scene: StartingScene = None,
        changes: Changes = [],  # noqa: B006 - typer reads it, nobody writes
        quick: Quick = False,
        seed: Seed = None,
    ) -> None:
        from benchmarks.reporting import Request

        module = importlib.import_module(f"benchmarks.studies.{name.replace('-', '_')}.run")
        module.run(Request(out=out, scene=scene, changes=tuple(changes), quick=quick, seed=seed))


for study_name, study_question in PLAIN_STUDIES.items():
    add_study(study_name, study_question)


@study_commands.command("eccentricity")
def study_eccentricity(
    out: OutputFolder,
    scene: StartingScene = None,
    changes: Changes = [],  # noqa: B006 - typer reads it, nobody writes
    quick: Quick = False,
    seed: Seed = None,
    geometries: Annotated[
        int | None,
        typer.Option(help="To fill the space with; 131072, or 16384 if quick.", min=1),
    ] = None,
) -> None:
    """How wrong each model is, at which eccentricity, and by which cause.

    A run that was stopped goes on where it was when it is given the same folder.
    """
    from benchmarks.reporting import Request
    from benchmarks.studies.eccentricity import run as eccentricity

    eccentricity.run(
        Request(
            out=out,
            scene=scene,
            changes=tuple(changes),
            quick=quick,
            seed=seed,
            options={"geometries": geometries or (1 << 14 if quick else 1 << 17)},
        )
    )


@study_commands.command("dynamic")
def study_dynamic(
    out: OutputFolder,
    scene: StartingScene = None,
    changes: Changes = [],  # noqa: B006 - typer reads it, nobody writes
    quick: Quick = False,
    seed: Seed = None,
    source: Annotated[
        Literal["both", "lens", "cone"],
        typer.Option(help="The fibre with its glue lens, the ideal sharp cone, or both."),
    ] = "both",
    exposure_ms: Annotated[
        float, typer.Option(help="Of a frame at the mean distance.", min=0.1, max=100.0)
    ] = 20.0,
) -> None:
    """How wrong a distance is while the tip moves: by speed, blur and a late pose.

    A run that was stopped goes on where it was when it is given the same folder.
    """
    from benchmarks.reporting import Request
    from benchmarks.studies.dynamic import run as dynamic

    dynamic.run(
        Request(
            out=out,
            scene=scene,
            changes=tuple(changes),
            quick=quick,
            seed=seed,
            options={"source": source, "exposure-ms": exposure_ms},
        )
    )


@dataset_commands.command("make")
def dataset_make(
    spec: Annotated[
        str,
        typer.Argument(
            metavar="SPEC",
            help="Spec (TOML), or static-v1, eccentricity-v1, dynamic-v1, adverse-v1.",
        ),
    ],
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="The set's folder.")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(help="Processes on this machine; one a core by default.", min=1)
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS", help="Dask scheduler whose workers do it: docs/datasets.md."
        ),
    ] = None,
    shard: Annotated[
        str | None, typer.Option(metavar="I/N", help="The I-th of N parts, for job arrays.")
    ] = None,
    changes: Changes = [],  # noqa: B006
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Only say how many frames, how large, how long.")
    ] = False,
) -> None:
    """Render a labelled set: splits of stacks, a data card and a manifest.

    A run that was stopped goes on where it was when it is given the same folder.
    """
    from benchmarks.sets.make import command

    command.make(
        spec,
        out=out,
        workers=workers,
        scheduler=scheduler,
        shard=shard,
        changes=changes,
        dry_run=dry_run,
    )


@dataset_commands.command("verify")
def dataset_verify(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="The set's folder.")],
) -> None:
    """Prove by its manifest that a set is whole, or name what is missing or changed."""
    from benchmarks.sets.make import command

    command.verify(folder)


@scene_commands.command("init")
def scene_init(
    path: Annotated[Path, typer.Argument(help="File to write.")] = Path("scene.toml"),
) -> None:
    """Write a scene file with every key, its unit and its default."""
    import scenes

    schema = f"./{SCENE_SCHEMA}" if path.with_name(SCENE_SCHEMA).exists() else None
    with path.open("x", encoding="utf-8") as file:
        file.write(scenes.scene_template(schema_file=schema))
    typer.echo(f"Wrote {path}. Edit it, then: eyespot scene check {path}")


@scene_commands.command("schema")
def scene_schema() -> None:
    """Print the JSON schema of scene files, for editors.

    Saved as scene.schema.json, it is named in every scene file that `scene init` writes beside it.
    """
    import json

    import scenes

    typer.echo(json.dumps(scenes.scene_schema(), indent=2))


@scene_commands.command("check")
def scene_check(scene: SceneFile, changes: Changes = []) -> None:  # noqa: B006
    """Say whether a scene file can be rendered, and if not, why not."""
    import scenes

    settings = scenes.load_scene(scene, changes)
    # What the keys alone do not tell, such as a spot that leaves the window.
    scenes.check_scene(settings)
    typer.echo(f"{scene}: fine.")
    for approximation in settings.approximations:
        typer.echo(f"Approximate: {approximation}.")


@app.command()
def doctor() -> None:
    """Say what this machine can do, and what to do about each thing that is missing."""
    from scenes.machine import doctor as examination

    raise typer.Exit(examination.report())


@app.command()
def version() -> None:
    """Print the version of eyespot."""
    typer.echo(importlib.metadata.version("eyespot"))


def main() -> None:
    """Runs the command line; the one place that decides what an error looks like.

    Our functions raise ValueError for what a person can put right, and the operating system
    raises OSError; their messages are printed as they are. Whatever else arrives here is a bug
    and keeps its traceback.
    """
    # Half of a short run is compilation, which the next run need not repeat.
    caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(caches / "eyespot" / "jax"))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.1")
    try:
        _refuse_foreign_packages()
        app()
    except KeyboardInterrupt:
        sys.exit(130)
    except Exception as error:
        message = _message_for_a_person(error)
        if message is None or os.environ.get("EYESPOT_TRACEBACK"):
            raise
        print(f"eyespot: {message}", file=sys.stderr)
        sys.exit(2)


def _message_for_a_person(error: Exception) -> str | None:
    """What to tell about an expected error; None for a bug."""
    # Classes of modules that were never loaded cannot have been raised.
    pydantic, variant = sys.modules.get("pydantic"), sys.modules.get("scenes.machine.variant")
    if pydantic and isinstance(error, pydantic.ValidationError):
        return "\n".join(
            f"{'.'.join(map(str, problem['loc']))}: {problem['msg']}; got {problem['input']!r}"
            for problem in error.errors()
        )
    if variant and isinstance(error, variant.RendererUnavailable):
        return str(error)
    if isinstance(error, ModuleNotFoundError) and error.name not in PACKAGES:
        return f"the Python package {error.name} is not installed. Run `make setup` again."
    if isinstance(error, OSError) and error.filename:
        return f"{error.filename}: {error.strerror}. {REMEDIES.get(error.errno or 0, '')}".rstrip()
    if isinstance(error, ValueError | OSError):
        return str(error)
    return None


def _refuse_foreign_packages() -> None:
    """Our packages have common names; another distribution's `benchmarks` would be run for ours."""
    home = Path(__file__).resolve().parent
    for name in PACKAGES:
        spec = importlib.util.find_spec(name)
        if spec is None or spec.origin is None:
            raise ValueError(f"eyespot's package {name} is missing in {home}. Install it again.")
        found = Path(spec.origin).resolve().parent
        if found != home / name:
            owners = importlib.metadata.packages_distributions().get(name, [])
            owner = next((owner for owner in owners if owner != "eyespot"), "its distribution")
            raise ValueError(
                f"the package {name} that Python finds is {found}, not eyespot's. Uninstall "
                f"{owner}, or give eyespot an environment of its own (`make setup`)."
            )


if __name__ == "__main__":
    main()
