"""The fit to all pixels: its image is the renderer's, its slopes are right, its sigmas hold."""

from __future__ import annotations

import dataclasses
import math
import shutil
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage, stats

from eyespot import calibration, optics
from eyespot.calibration.pixels.data import BareFibre, Footage, check_names, footage_of
from eyespot.calibration.pixels.fit import fit_image
from eyespot.calibration.pixels.lens_light import LinearLensLight
from eyespot.calibration.pixels.light import STATES, Cells, FrameLight, Light
from eyespot.calibration.spots.cone_trials import JointPrior
from eyespot.estimator.camera_noise import CameraNoise
from eyespot.estimator.distance.withdrawal import DELAYS, withdrawal_of
from eyespot.formats.camera_sheet import CameraSheet, Response
from eyespot.formats.inputs import InputError
from eyespot.formats.poses import RobotKeys, read_poses
from eyespot.formats.stack import Stack, read_stack
from eyespot.optics.wall_light.cells import CellBeam, lattice_irradiance, square_lattice
from eyespot.optics.wall_light.cone import UniformCone
from eyespot.optics.wall_light.lens_flux import lens_of, lens_parameters, lens_samples
from eyespot.scenes import Renderer, Scene, render_stack
from eyespot.scenes.description.scene_keys import CameraSettings
from eyespot.scenes.sensor import expose
from eyespot.scenes.world.world import World
from tests.support.drawn.drawn_sets import with_false_labels
from tests.support.drawn.made_up import a_footage, a_microscope
from tests.support.drawn.scene_tables import scene_of
from tests.support.files.fit_files import assert_within

HALF_ANGLE, B = math.atan(1 / 20), -5.117
START = {"half_angle": 1.3 * HALF_ANGLE, "b": 0.7 * B}
SIDE = 32  # samples of a pixel each way


def scene(**tables: Any) -> Scene:
    """A withdrawal over an even wall, in frames of 128 x 128."""
    settings = {
        "phantom": {"wall": "uniform"},
        "source": {"kind": "cone"},
        "spot": {"eccentricity_mm": 2.0},
        "motion": {"travel_mm": 5.0, "frames": 10},
        "microscope": {"width_px": 128, "height_px": 128, "scale_mm_px": 0.02, "samples": SIDE**2},
        "exposures": {"kinds": ["metered"], "keep_linear": True},
    }
    return scene_of(settings, tables)


REFLECTANCE, ILLUMINATION = 0.5, 0.05


class Seen:
    """The wall behind every pixel of a scene over an eyeball."""

    def __init__(self, settings: Scene) -> None:
        world = World(settings)
        eye, window = world.microscope, settings.microscope
        assert isinstance(eye, optics.Microscope)
        self.shape = window.height_px, window.width_px
        corner, right = np.array([-0.5, -0.5]), np.array([1.0, 0.0])
        self.lattice = square_lattice(
            eye, world.wall, corner=corner, right=right, count=max(self.shape)
        )
        v, u = np.mgrid[: self.shape[0], : self.shape[1]].astype(float)
        start, sight = eye.ray(jnp.stack([u, v], axis=-1))
        meeting = world.wall.intersect(start, sight)
        depth = eye.depth(meeting.point)
        across = eye.inverse_working_distance**2 * jnp.sum(meeting.point[..., :2] ** 2, axis=-1)
        self.coaxial = np.asarray(-optics.dot(meeting.normal, sight) / (across + depth**2))

    def light(
        self, beam: CellBeam, tip: jax.Array, axis: jax.Array, emitted: float = 1.0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Radiance of the wall, and the beam's part of its irradiance."""
        rows, columns = self.shape
        direct = np.asarray(compiled(self.lattice, beam, tip=tip, axis=axis))[:rows, :columns]
        closed = optics.indirect_irradiance(flux=emitted, reflectance=REFLECTANCE, eye_radius=11.5)
        steady = ILLUMINATION * self.coaxial + float(closed)
        return REFLECTANCE / np.pi * (direct + steady), direct


compiled = jax.jit(lattice_irradiance)


@pytest.mark.parametrize("pinhole", [11.5, 200.0])
def test_model_image_of_a_cone_is_the_renderers(pinhole):
    settings = scene(
        motion={"start_mm": 1.0, "frames": 2},
        instrument={"visible": False},
        microscope={"pinhole_height_mm": pinhole},
    )
    renderer = Renderer(settings)
    wall, cone = Seen(settings), UniformCone.of(HALF_ANGLE, B)
    for frame in range(2):
        beam = renderer.world.truth.beam
        rendered = renderer.render(frame).radiance[..., 0]
        image, irradiance = wall.light(cone, beam.tip[frame], beam.axis[frame])
        # What rounding leaves of no light is below 1e-9 of the spot's.
        off, lit = image - rendered, irradiance > 1e-9 * irradiance.max()
        inside = ndimage.binary_erosion(lit, iterations=2)
        outside = ~ndimage.binary_dilation(lit, iterations=2)
        # Single precision, summed over a pixel's samples; curvature within a pixel 1e-6.
        np.testing.assert_allclose(off[inside] / rendered[inside], 0.0, atol=1e-4)
        np.testing.assert_allclose(off[outside] / rendered[outside], 0.0, atol=1e-4)
        edge = off[~inside & ~outside] / (rendered.max() - rendered.min())
        # Samples on a grid of n x n are off by up to 1/(2n) where the edge runs along it.
        assert np.abs(edge).max() < 0.6 / SIDE
        assert np.sqrt(np.mean(edge**2)) < 0.1 / SIDE


@pytest.mark.slow
@pytest.mark.parametrize(("medium", "scale"), [("air", 0.03), ("vitreous", 0.02)])
def test_model_image_of_a_lens_is_the_renderers(medium, scale):
    settings = scene(
        source={"kind": "lens", "lens": "dome", "medium": medium},
        motion={"start_mm": 2.0, "travel_mm": 3.0, "frames": 2},
        instrument={"visible": False},
        microscope={"width_px": 160, "scale_mm_px": scale, "samples": 16},
    )
    renderer = Renderer(settings)
    wall = Seen(settings)
    values = lens_parameters(optics.load_lens("dome"))
    index = optics.MEDIA[medium]
    grid: dict[str, Any] = {"nearest": 1.0, "farthest": 6.0, "reach": 1.05, "halvings": 5}
    tabulated = lens_samples(values, ("sag",), medium_index=index, finest=0.0, **grid).table()
    for frame in range(2):
        beam = renderer.world.truth.beam
        sent = float(tabulated.transmitted())
        image, _ = wall.light(tabulated, beam.tip[frame], beam.axis[frame], sent)
        rendered = renderer.render(frame).radiance[..., 0]
        off = (image - rendered) / rendered.max()
        # The renderer's own table is good to 3e-4 of the peak; where an edge runs through a pixel,
        # its 4 x 4 samples and our four nodes differ by more.
        assert np.sqrt(np.mean(off**2)) < 3e-4
        assert np.abs(off).max() < 7e-3


SEEN = {"scale": 0.02, "eye_radius": 11.5, "inverse_working_distance": 1 / 23}
SEEN |= {"reflectance": 0.5, "power": 1.0, "robot_scale": 1.0, "clock_offset": 0.0}
SEEN |= {"sensitivity": 200.0, "illumination": 0.05, "touch": 0.15, "u": 64.0, "v": 63.0}


def changed_light(light: Light, *ends: tuple[dict[str, float], np.ndarray]) -> np.ndarray:
    """What the one frame's light gains between two ends, each of values and states."""
    found: list[FrameLight] = []
    for values, states in ends:
        light.look(values, states, [0])
        found += light.frames(values, states, [0], slopes=False) or ()
    low, high = found
    return np.asarray(high.light - low.light)


def test_slopes_are_those_of_central_differences():
    pose = {"lean": 0.01, "lean_sideways": -0.02, "boresight": 0.03, "boresight_sideways": 0.005}
    values = {"half_angle": HALF_ANGLE, "b": B, "blur": 2.0, "spread": 0.03}
    values |= SEEN | pose
    light = Light(one_frame(), Cells.over((128, 128), 4), tuple(values), None)
    states = 0.1 * np.eye(1, len(STATES))
    light.look(values, states, [0])
    found = light.frames(values, states, [0])
    assert found is not None
    differences = {}
    for name, value in values.items():
        step = 1e-5 * max(abs(value), 0.01)
        ends = ((values | {name: value + by}, states) for by in (-step, step))
        differences[name] = changed_light(light, *ends) / (2 * step)
    count = len(found[0].by_state)
    for name, moved in zip(STATES[:count], 1e-6 * np.eye(count, len(STATES)), strict=True):
        ends = ((values, states + by) for by in (-moved, moved))
        differences[f"state {name}"] = changed_light(light, *ends) / 2e-6
    slopes = [*found[0].slopes, *found[0].by_state]
    for (name, difference), slope in zip(differences.items(), slopes, strict=True):
        # Of second order in the step: cells of 4 px that the step moves an edge by 1e-3 px in.
        off = np.abs(slope - difference).max() / np.abs(difference).max()
        assert off < 2e-3, f"{name}: {off}"


LENS_BESIDE_ITS_TABLE = {"core_radius": 0.2, "aperture_radius": 0.27, "rim_height": 0.0}
LENS_BESIDE_ITS_TABLE |= {"sag": 0.05, "glue_index": 1.49, "numerical_aperture": 0.12}
LENS_BESIDE_ITS_TABLE |= {"touch": 0.15}


@pytest.mark.slow  # a minute to compile
def test_slopes_of_a_lens_beside_its_table_are_those_of_central_differences():
    names = ("core_radius", "aperture_radius", "sag", "numerical_aperture")
    lens = LinearLensLight(one_frame(), names)
    lens.tabulate(LENS_BESIDE_ITS_TABLE, coarse=True)
    pose = dict.fromkeys(("lean", "lean_sideways", "boresight", "boresight_sideways"), 0.0)
    values = LENS_BESIDE_ITS_TABLE | SEEN | pose
    values |= {"aperture_radius": 0.276, "sag": 0.0515}
    light, still = Light(one_frame(), Cells.over((128, 128), 4), names, lens), np.zeros((1, 7))
    found = light.frames(values, still, [0])
    assert found is not None
    for name, slope in zip(names, found[0].slopes, strict=True):
        step = 1e-4 * values[name]
        ends = ((values | {name: values[name] + by}, still) for by in (-step, step))
        difference = changed_light(light, *ends) / (2.0 * step)
        # The table is linear, so only the curvature's second order is left: 1e-8 of the change.
        assert np.abs(slope - difference).max() < 1e-6 * np.abs(difference).max(), name


@pytest.mark.slow
def test_a_rim_that_no_light_reaches_changes_nothing_at_equal_curvature():
    lens = LinearLensLight(one_frame(), ("aperture_radius", "sag"))
    lens.tabulate(LENS_BESIDE_ITS_TABLE, coarse=False)
    sphere = (0.27**2 + 0.05**2) / (2 * 0.05)  # radius of the cap
    wider = {"aperture_radius": 0.284, "sag": sphere - math.sqrt(sphere**2 - 0.284**2)}
    radius, distance = jnp.linspace(0.01, 0.5, 50), jnp.full(50, 3.0)
    # The cap's top is 5 um farther from the core, which the table knows to first order: at a cap
    # that moves by 1e-3 of the distance the light changes by 3e-3, and what is left is its square.
    light, changed = (
        np.asarray(lens.at({**LENS_BESIDE_ITS_TABLE, **by})(radius=radius, distance=distance))
        for by in ({}, wider)
    )
    exact = optics.LensField(lens_of({**LENS_BESIDE_ITS_TABLE, **wider}), 1.0)
    rings = np.linspace(0.0, 0.5, 2001)
    axial = np.asarray(exact(radius=rings, distance=np.full(rings.size, 3.0))[1])
    within = np.concatenate([[0.0], np.cumsum(np.diff(rings**2) * (axial[1:] + axial[:-1]) / 2)])
    true = np.interp(radius, rings, within) / radius**2
    assert np.abs(changed - light).max() > 1e-3 * light.max()
    assert np.abs(changed - true).max() < 3e-4 * light.max()


def test_a_robot_that_stops_within_an_exposure_is_behind_its_place_in_the_middle(tmp_path):
    # It withdraws at 0.1 mm/s, stops at 60 s, and stays: as the last pose of a recording.
    rows = [f"{t},0,0,{0.1 * min(t, 60.0)},0,0,-1" for t in np.arange(0.0, 62.0, 0.005)]
    poses = tmp_path / "kinematics.csv"
    poses.write_text("\n".join(["time_s,x_mm,y_mm,z_mm,axis_x,axis_y,axis_z", *rows]))
    exposures = np.array([0.1, 0.1])
    readings, *_ = withdrawal_of(
        read_poses(poses), np.array([30.0, 60.0]), robot=RobotKeys(), exposure_s=exposures
    )
    # In half of the exposure it is up to 5 um behind, on average over all of it 1.25 um. The means
    # over 32 parts of a broken line are exact, because a part ends where it breaks.
    assert readings[1] - readings[0] == pytest.approx(3.0 - 0.1 * 0.1 / 8, abs=1e-9)


def test_frames_without_usable_pixels_are_refused_with_their_number():
    told = r"0 cells .* are usable; .* parameters .* needs more(.|\n)*Change the exposure"
    with pytest.raises(InputError, match=told):
        fit_image(a_footage(), source="cone", start={"half_angle": 0.05, "b": -5.0})


def one_frame() -> Footage:
    """Conditions of a frame of 128 x 128 pixels over an eyeball, and no light."""
    motion, axis = np.array([0.16, 0.49, -0.857]), np.array([0.1506, 0.5, -0.8528])
    size = {"width_px": 128, "height_px": 128, "scale_mm_px": 0.02}
    return a_footage(
        light=np.zeros((1, 128, 128), np.float32),
        clear=np.ones((1, 128, 128), bool),
        exposure_s=np.array([0.05]),
        readings=np.array([3.0]),
        delayed=3.0 + np.linspace(-0.08, 0.08, DELAYS)[None],  # at 0.4 mm/s
        delay_s=0.005,
        motion=motion / np.linalg.norm(motion),
        axis=axis / np.linalg.norm(axis),
        microscope=a_microscope(**size, principal_point_px=(-37.0, 63.0)),
        kind="eyeball",
    )


@pytest.mark.parametrize("response", ["linear", "srgb", 2.2])
@pytest.mark.parametrize("level", [0.05, 0.3, 0.8])
def test_noise_is_that_of_the_camera(response, level):
    camera = CameraSettings(response=response)
    curves = {"linear": Response(), "srgb": Response(curve="srgb")}
    sheet = CameraSheet(**camera.model_dump(include={*CameraSheet.model_fields} - {"bayer"}))
    noise = CameraNoise(sheet, curves.get(response, Response(curve="gamma", gamma=2.2)))
    image = expose(
        np.full((300, 300, 3), level), exposure=1.0, settings=camera, rng=np.random.default_rng(3)
    )
    light = noise.light(image)
    expected = float(noise.variance(np.array([level]))[0])
    n = light.size
    # Means and variances of n normal numbers within 4.5 standard errors; rounding acts on the mean
    # with a slope of its own, 1e-5 where the curve bends.
    assert abs(light.mean() - level) < 4.5 * math.sqrt(expected / n) + 2e-5
    assert abs(light.var() / expected - 1) < 4.5 * math.sqrt(2 / n) + 0.01


def test_hidden_pixels_are_those_in_which_the_renderer_sees_the_instrument():
    settings = scene(motion={"start_mm": 0.5, "travel_mm": 1.0, "frames": 2})
    renderer = Renderer(settings)
    instrument = BareFibre(0.25, 6.0)
    v, u = np.mgrid[:128, :128]
    world = World(settings)
    sight = world.microscope.ray(jnp.stack([u, v], axis=-1).astype(float))
    for frame in range(2):
        seen_wall = renderer.render(frame).wall
        hidden = instrument.hides(
            np.asarray(world.wall.intersect(*sight).point),
            np.asarray(sight[1]),
            tip=np.asarray(renderer.world.truth.beam.tip[frame]),
            axis=np.asarray(renderer.world.truth.beam.axis[frame]),
            margin=0.0,
        )
        # Where a pixel is cut, its centre may lie on either side.
        np.testing.assert_array_equal(hidden[seen_wall > 0.9999], False)
        fibre = ndimage.binary_erosion(seen_wall == 0.0, iterations=1)
        np.testing.assert_array_equal(hidden[fibre], True)
        assert fibre.any()


@pytest.mark.parametrize(
    ("choice", "words"),
    [
        ({"start": {"half_angle": 0.05}}, "missing: b"),
        ({"start": START, "free": ("half_angel",)}, "Unknown: half_angel"),
        ({"start": START, "free": ("sag",)}, "Unknown: sag"),
        ({"start": START, "free": ("blur",)}, "missing: blur"),
    ],
)
def test_names_that_the_fit_does_not_know_are_refused(choice, words):
    with pytest.raises(ValueError, match=words):
        check_names("cone", choice["start"], choice.get("free", ()), {})


def test_a_damaged_camera_of_a_stack_is_refused_with_the_files_name(tmp_path):
    stack = Path(__file__).parents[1] / "files-0.1" / "small-v1" / "train" / "0000"
    folder = shutil.copytree(stack, tmp_path / "stack")
    file = folder / "stack.toml"
    file.write_text(file.read_text().replace("bit_depth = 8", "bit_depth = 80"))
    with pytest.raises(ValueError, match="bit_depth must be at most 16; got 80") as error:
        footage_of(folder)
    assert str(error.value).startswith(f"{file}: ")


@pytest.fixture(scope="module")
def stack(tmp_path_factory) -> Stack:
    return render_stack(scene(), tmp_path_factory.mktemp("image") / "stack")


@pytest.fixture(scope="module")
def fit(stack) -> calibration.ImageFit:
    return fit_image(footage_of(stack), source="cone", start=START)


@pytest.mark.slow
def test_tips_and_axis_are_those_of_the_labels(stack, fit):
    tips = np.array([labels.tip_mm for labels in stack.labels])
    axis = np.array(stack.labels[0].axis)
    # Errors along the axis are the touch's, and those across it the lean's times the distance.
    touch, lean = fit.parameters["touch"][1], fit.parameters["lean"][1]
    off = fit.tips - tips
    assert np.abs(off @ axis).max() < 4 * touch
    np.testing.assert_allclose(off, 0, atol=4 * (touch + 6.0 * lean))
    assert np.linalg.norm(np.cross(fit.axis, axis)) < 6 * lean


@pytest.mark.slow
def test_labels_are_not_read(stack, tmp_path):
    other = read_stack(with_false_labels(stack.folder, tmp_path / "stack"))
    # A fit sees the footage alone.
    blind, seen = (vars(footage_of(own)) for own in (other, stack))
    noises = [vars(own.pop("noise")) for own in (blind, seen)]
    np.testing.assert_equal([blind, noises[0]], [seen, noises[1]])


@pytest.mark.slow
def test_what_shows_in_products_alone_is_said(stack):
    free = ("half_angle", "b", "power")
    fit = fit_image(footage_of(stack), source="cone", start=START, free=free)
    (told,) = fit.undetermined
    assert "power" in told
    assert "sensitivity" in told
    assert math.isinf(fit.parameters["power"][1])
    # What can be seen is seen as well as before.
    assert_within(fit, {"half_angle": HALF_ANGLE}, 3.5)


@pytest.mark.slow
def test_wrong_exposures_are_learnt_frame_by_frame(stack, fit):
    footage = footage_of(stack)
    wrong = 1 + 0.1 * np.sin(np.arange(10))
    told = dataclasses.replace(footage, exposure_s=footage.exposure_s * wrong)
    learnt = fit_image(told, source="cone", start=START)
    # What was told is off by 7 %, RMS; what was right stays within the noise of a frame's light.
    assert 0.04 < learnt.states["exposure"] < 0.12
    assert fit.states["exposure"] < 0.005
    assert_within(learnt, {"half_angle": HALF_ANGLE, "b": B}, 3.5)
    for name in ("half_angle", "b"):
        assert learnt.parameters[name][1] < 1.5 * fit.parameters[name][1]


@pytest.mark.slow
def test_a_camera_noisier_than_its_data_sheet_enlarges_the_errors(stack, fit):
    footage = footage_of(stack)
    sheet = footage.noise.sheet
    sheet = sheet.model_copy(update={"full_well_e": 4 * sheet.full_well_e})
    better = dataclasses.replace(footage.noise, sheet=sheet)
    told = fit_image(dataclasses.replace(footage, noise=better), source="cone", start=START)
    assert told.chi_squared_per_dof > 3
    # What is added is in proportion to the light and not to its root, so it errs to the safe side.
    for name in ("half_angle", "b"):
        assert 0.8 < told.parameters[name][1] / fit.parameters[name][1] < 3.0


def photographed(
    footage: Footage, light: np.ndarray, rng: np.random.Generator, **changed: Any
) -> Footage:
    """The footage with the default camera's images of light in full wells, with their noise."""
    images = [
        expose(np.repeat(frame[..., None], 3, -1), exposure=1.0, settings=CameraSettings(), rng=rng)
        for frame in light
    ]
    return dataclasses.replace(
        footage,
        light=np.stack([footage.noise.light(image) for image in images]).astype(np.float32),
        clear=np.stack([((image > 0) & (image < 255)).all(axis=-1) for image in images]),
        **changed,
    )


SEEDS = range(40)
PRIORS = {
    "touch": 0.02,
    **dict.fromkeys(("lean", "lean_sideways"), math.radians(1.0)),
    **dict.fromkeys(("boresight", "boresight_sideways"), math.radians(3.0)),
}


def ideal_withdrawal(folder: Path) -> tuple[Footage, np.ndarray, dict[str, float]]:
    """Frames without noise, exact as no renderer's samples are, their camera, and the truth."""
    settings = scene(instrument={"visible": False}, microscope={"samples": 4})
    stack = render_stack(settings, folder / "stack")
    footage, beam = footage_of(stack), Renderer(settings).world.truth.beam
    wall, cone = Seen(settings), UniformCone.of(HALF_ANGLE, B)
    light = [
        wall.light(cone, tip, axis)[0] * settings.exposures.sensitivity_mm2_sr_mj * time
        for tip, axis, time in zip(beam.tip, beam.axis, footage.exposure_s, strict=True)
    ]
    truth = {
        **{"half_angle": HALF_ANGLE, "b": B, "sensitivity": 200.0, "illumination": 0.05},
        **{"touch": stack.labels[0].d_mm, "u": 63.5, "v": 63.5},
        **dict.fromkeys(("lean", "lean_sideways", "boresight", "boresight_sideways"), 0.0),
    }
    # This light is that of a moment; the robot rests for half of the first and the last exposure.
    readings = np.linalg.norm(beam.tip - beam.tip[0], axis=1)
    return dataclasses.replace(footage, readings=readings), np.asarray(light), truth


def fit_of_seed(
    seed: int,
    footage: Footage,
    light: np.ndarray,
    truth: dict[str, float],
    joint_prior: JointPrior | None = None,
) -> calibration.ImageFit:
    """The fit to the frames with noise; what is known beforehand scatters as it says, too."""
    rng = np.random.default_rng(seed)
    noisy = photographed(footage, light, rng)
    priors = {
        name: calibration.Prior(truth[name] + sigma * rng.standard_normal(), sigma)
        for name, sigma in PRIORS.items()
    }
    return fit_image(noisy, source="cone", start=START, priors=priors, joint_prior=joint_prior)


@pytest.mark.slow
def test_a_second_recording_adds_its_information_to_a_calibration(tmp_path):
    """Two recordings with noise of their own know as much together as the sum of both."""
    footage, light, truth = ideal_withdrawal(tmp_path)
    first, second = (fit_of_seed(seed, footage, light, truth) for seed in (1, 2))
    own = [list(first.parameters).index(name) for name in ("half_angle", "b")]
    known = first.covariance[np.ix_(own, own)]
    mean = {name: first.parameters[name][0] for name in ("half_angle", "b")}
    both = fit_of_seed(2, footage, light, truth, JointPrior(mean, known))
    alone, together = (fit.covariance[np.ix_(own, own)] for fit in (second, both))
    expected = np.linalg.inv(np.linalg.inv(known) + np.linalg.inv(alone))
    # The noise's weights follow the light, so at another point they differ by some thousandths.
    np.testing.assert_allclose(together, expected, rtol=0.02)
    values = [np.array([fit.parameters[name][0] for name in mean]) for fit in (first, second)]
    weighted = [np.linalg.solve(c, v) for c, v in zip((known, alone), values, strict=True)]
    found = np.array([both.parameters[name][0] for name in mean])
    # The model is linear within these errors, so the mean is off by a small part of them.
    assert np.all(np.abs(found - expected @ sum(weighted)) < 0.05 * np.sqrt(np.diag(expected)))


@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_say(tmp_path):
    footage, light, truth = ideal_withdrawal(tmp_path)
    held = dict.fromkeys(truth, 0)
    # A side of a cell is a chord of the wall. Over 3 px of 0.02 mm the sphere lies two thirds of
    # 0.03^2 / (2 * 11.5) mm deeper on average, which a beam at 30 degrees meets 0.0008 px aside:
    # as much as the standard error of the spot's place.
    chord = {"u": 0.0008, "v": 0.0008}
    for seed in SEEDS:
        fit = fit_of_seed(seed, footage, light, truth)
        for name, true in truth.items():
            value, sigma = fit.parameters[name]
            held[name] += abs(value - true) < 1.959964 * sigma + chord.get(name, 0.0)
    for name, count in held.items():
        chance = stats.binom.cdf(count, len(SEEDS), 0.95)
        assert chance > 0.01 / len(truth), f"{name}: {count} of {len(SEEDS)}"
