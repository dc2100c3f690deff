"""The functions of `import eyespot`; a command prints what its function returns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from eyespot.estimator.run.progress_bar import quiet
from eyespot.formats.stack import Stack as Stack
from eyespot.scenes import Scene as Scene
from eyespot.scenes import load_scene as load_scene

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd

    from eyespot.benchmarks.sets.read import LabelledSet
    from eyespot.estimator.recording import Recording
    from eyespot.formats.calibration import Calibration
    from eyespot.formats.rig import Rig
    from eyespot.formats.spot import NoSpot, Spot
    from eyespot.results import Fit, Score

File = str | Path


def render(
    scene: Scene | File,
    out: File,
    changes: Mapping[str, Any] | None = None,
    *,
    variant: Literal["llvm_ad_rgb", "cuda_ad_rgb", "scalar_rgb"] = "llvm_ad_rgb",
    progress: bool = False,
) -> Stack:
    """Render a scene to an image stack with labels, as `eyespot render`.

    Args:
        scene: a scene, or a scene file (TOML).
        out: the stack's folder; it must not exist.
        changes: values of the scene to change, such as {"source.kind": "cone"}.
        variant: of Mitsuba; cuda_ad_rgb renders on an NVIDIA GPU.
        progress: show a bar.

    Raises:
        InputError: the scene is impossible, or `out` exists.
    """
    from eyespot.estimator.run.progress_bar import progress as bar
    from eyespot.scenes import changed, render_stack
    from eyespot.scenes.world.motion import frame_count

    scene = scene if isinstance(scene, Scene) else load_scene(Path(scene))
    scene = changed(scene, changes) if changes else scene
    with quiet(bars=progress), bar("Rendering", total=frame_count(scene)) as advance:
        return render_stack(scene, Path(out), variant=variant, progress=advance)


def track(
    source: Recording | Stack | File | int | np.ndarray | Sequence[Any],
    *,
    calibration: File | Calibration | Fit | None = None,
    rig: Rig | File | None = None,
    changes: Mapping[str, Any] | None = None,
    poses: pd.DataFrame | File | None = None,
    mode: Literal["auto", "subpixel", "literal", "pixels"] = "auto",
    exposure: Literal["metered", "paper"] | None = None,
    unrelated: bool | None = None,
    progress: bool = False,
    **options: Any,
) -> pd.DataFrame:
    """Measure the spot in every frame, as `eyespot track`.

    Args:
        source: a recording, a stack, a folder of images, TIFF, video, ROS bag, an array, a list of
            images or of their files; or the number of a camera, which Ctrl-C stops.
        calibration: of the beam, or its file; None: that of the rig; without one there are no
            distances.
        rig: the rig or its file; None: the recording's own.
        changes: values of the rig to change, such as {"wall.medium": "air"}.
        poses: the robot's poses: a table or a file.
        mode: measure the half-maximum contour, repeat the paper's algorithm, or find the beam's
            pose from all pixels; auto takes the pixels for a lens if the camera's rate permits.
        exposure: of a stack that has two; None: metered.
        unrelated: measure every image by itself; None if the images are not numbered one by one.
        progress: show a bar.
        options: the other options of `eyespot track`, such as `fps=10` or `start=(320, 240)`.

    Returns:
        A row a frame, units in the columns' names; the first twelve are what one looks at. `reason`
        says why there is no spot. `attrs` has microscope, calibration, how the run ended, and what
        two sources state differently, such as the robot's travel and the distances.

    Raises:
        InputError: wrong options or files.
    """
    from eyespot.estimator.recording import Recording
    from eyespot.estimator.run.options import Options, prepared
    from eyespot.estimator.run.track_command import tracked
    from eyespot.formats.spots import spots_table

    fps = options.pop("fps", None)
    file = Path(calibration) if isinstance(calibration, str | Path) else None
    asked = Options.of({"mode": mode, "calibration": file, **options})
    with quiet(bars=progress):
        recording = Recording.open(
            source, rig=rig, changes=changes or {}, poses=poses, exposure=exposure, fps=fps
        )
        given: Any = None if file else getattr(calibration, "calibration", calibration)
        opened = prepared(recording.unrelated(unrelated), asked, given)
        tracking, _ = tracked(opened.recording, opened.reader())
    table = spots_table(tracking.records)
    table.attrs = {"source": f"{source}", "ended": tracking.ended.value, "fault": tracking.fault}
    table.attrs["disagreements"] = tracking.disagreements
    if (view := opened.recording.view) is not None:
        names = ("width_px", "height_px", "scale_mm_px", "pinhole_height_mm", "eye_radius_mm")
        table.attrs["microscope"] = {name: getattr(view, name) for name in names}
    if (beam := opened.beam) is not None:
        table.attrs["calibration"] = {
            "model": beam.model,
            "medium": beam.medium.name,
            **beam.values,
        }
    return table


def measure(image: np.ndarray, *, rig: Rig | File | None = None) -> Spot | NoSpot:
    """Measure the spot in one image.

    Args:
        image: h x w, or h x w x 3 (RGB); uint8, uint16 or float.
        rig: whose lens's distortion and response are taken out; None: neither.

    Returns:
        The spot's ellipse with its covariance, px; or why there is none, which is false.

    Raises:
        InputError: no image, or a wrong rig.
    """
    from eyespot.estimator.recording import Recording
    from eyespot.estimator.run.options import Options

    recording = Recording(image[None], rig=rig)
    frame = next(iter(recording.source))
    return Options(mode="subpixel").reader(recording.rig).read(frame).result


def fit(
    sources: Recording | Stack | File | np.ndarray | Sequence[Any],
    *,
    rig: Rig | File | Sequence[Rig | File] | None = None,
    changes: Mapping[str, Any] | None = None,
    poses: pd.DataFrame | File | Sequence[pd.DataFrame | File] | None = None,
    progress: bool = False,
    **choices: Any,
) -> Fit:
    """Fit the beam to recordings of withdrawals, as `eyespot fit`.

    A fit that is not good is returned, too: `good` is then false, and `verdict` says why.

    Args:
        sources: a recording, a stack, a spots file, a folder of images, a video, a ROS bag, or a
            list of these, all with one microscope; or an array of frames.
        rig: the rig or its file, one for all sources or one each; None: the recordings' own.
        changes: values of the rig to change, such as {"robot.touch": "free"}.
        poses: the robot's poses: a table or a file, for each source; None: the recordings' own.
        progress: show a bar.
        choices: options of `eyespot fit`, such as `model="cone"`, `free="half_angle,b,scale"`, or
            `prior=["touch=0,0.02"]`.

    Raises:
        InputError: wrong options or files.
    """
    from eyespot.calibration.command.choices import Choices
    from eyespot.calibration.command.fitting import fit_recordings, opened_recordings

    asked = Choices.of(choices | {"changes": changes or {}})
    several = sources if isinstance(sources, list | tuple) else [sources]
    with quiet(bars=progress):
        recordings = opened_recordings(several, asked, rig=rig, poses=poses)
        return fit_recordings(recordings, asked)


def score(
    folder: File | None = None,
    spots: Sequence[File] = (),
    *,
    mode: Literal["auto", "literal", "subpixel", "pixels", "both"] | None = None,
    unrelated: bool | None = None,
    against: Literal["half_max", "cone"] = "half_max",
    split: str | None = None,
    out: File | None = None,
    progress: bool = False,
) -> Score:
    """Compare spots with the labels of a set, as `eyespot score`; tables with one row a group.

    Args:
        folder: a labelled set or a stack; None for the sample set that comes with eyespot.
        spots: spots files with image names relative to the set.
        mode: also measure the images with our estimator; None: auto if there are no spots.
        unrelated: let `mode` measure every image by itself; None: if most true spots of a stack lie
            too far from the one before to be followed.
        against: true ellipse to compare with.
        split: the only split to score.
        out: new folder for the page, its tables and figures.
        progress: show a bar.

    Raises:
        InputError: wrong files, or nothing to score.
    """
    from eyespot.benchmarks.sets.score.score_command import score as command

    with quiet(bars=progress):
        return command(
            None if folder is None else Path(folder),
            tuple(Path(file) for file in spots),
            sample=folder is None,
            mode=mode,
            unrelated=unrelated,
            against=against,
            split=split,
            out=None if out is None else Path(out),
        )


def dataset(
    spec: File, out: File, changes: Sequence[str] = (), *, progress: bool = False
) -> LabelledSet:
    """Render a labelled set with one worker a core, as `eyespot dataset make`.

    Args:
        spec: spec file (TOML), or the name of a set, such as "static-v2".
        out: the set's folder; a run that was stopped is continued.
        changes: "key=value" of the spec.
        progress: show a bar.

    Raises:
        InputError: the spec is wrong.
    """
    from dask.system import cpu_count

    from eyespot.benchmarks.sets.make import make_set
    from eyespot.benchmarks.sets.spec import load_spec
    from eyespot.benchmarks.sets.workers import local_workers

    settings = load_spec(str(spec), tuple(changes))
    with quiet(bars=progress):
        return make_set(settings, Path(out), workers=local_workers(cpu_count()))
