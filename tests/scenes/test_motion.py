"""Motion of the tip: trajectories, clocks, labels of moving spots, blur from sub-frames."""

from typing import Any

import numpy as np
import pytest

from eyespot import optics
from eyespot.scenes import (
    Renderer,
    Scene,
    SceneError,
    frame_count,
    load_scene,
    render_stack,
    scene_template,
)
from eyespot.scenes.world.motion import frame_times, kinematics
from eyespot.scenes.world.world import World
from tests.support.drawn.scene_tables import BARE, scene_of

SMALL = {"width_px": 160, "height_px": 120, "scale_mm_px": 0.0268}


def scene(**parts: Any) -> Scene:
    """A uniform wall under the ideal cone's direct light alone, unless told otherwise."""
    spot = {"eccentricity_mm": 2.0, "azimuth_deg": 20.0, "incidence_azimuth_deg": 60.0}
    return scene_of(BARE, {"spot": spot}, parts)


def hand(**keys: Any) -> dict[str, Any]:
    return {"kind": "hand", "duration_s": 2.0, **keys}


@pytest.mark.parametrize("kind", ["eyeball", "plane"])
def test_a_withdrawal_keeps_axis_and_spot_and_goes_at_its_speed(kind):
    settings = scene(
        phantom={"kind": kind},
        motion={"start_mm": 1.0, "travel_mm": 2.0, "frames": 5, "speed_mm_s": 0.5},
    )
    world = World(settings)
    np.testing.assert_allclose(world.times, [0.0, 1.0, 2.0, 3.0, 4.0])
    np.testing.assert_allclose(world.truth.distance, [1.0, 1.5, 2.0, 2.5, 3.0], rtol=1e-12)
    np.testing.assert_allclose(world.truth.eccentricity, 2.0, rtol=1e-12)
    np.testing.assert_allclose(np.degrees(world.truth.azimuth), 20.0, rtol=1e-12)
    np.testing.assert_allclose(np.degrees(world.truth.incidence), 30.0, rtol=1e-12)
    np.testing.assert_allclose(np.degrees(world.truth.incidence_azimuth), 60.0, rtol=1e-12)
    # A difference over 1e-6 s of coordinates of 10 mm: 1e-15 / 1e-6.
    np.testing.assert_allclose(world.speed, 0.5, rtol=1e-6)


@pytest.mark.parametrize("kind", ["eyeball", "plane"])
def test_a_scan_keeps_its_distance_and_its_trocar_while_the_spot_moves_evenly(kind):
    settings = scene(
        phantom={"kind": kind},
        motion={"kind": "scan", "length_mm": 1.0, "speed_mm_s": 0.5, "direction_deg": 40.0},
    )
    world = World(settings)
    spots = world.truth
    assert world.times[-1] == pytest.approx(2.0)
    np.testing.assert_allclose(spots.distance, 3.0, rtol=1e-12)
    steps = np.linalg.norm(np.diff(np.asarray(spots.origin), axis=0), axis=1)
    # Chords of 0.05 mm are shorter than their arcs by s^2/24r^2 = 1e-6.
    np.testing.assert_allclose(steps, 0.05, rtol=2e-6)
    # All lines of the beam meet in the trocar, 20 mm up the middle one.
    middle = np.asarray(spots.origin[10]) - 20.0 * np.asarray(spots.beam.axis[10])
    away = middle - np.asarray(spots.beam.tip)
    np.testing.assert_allclose(np.cross(away, np.asarray(spots.beam.axis)), 0.0, atol=1e-9)


def test_the_hands_tremor_has_its_amplitude_and_band_and_the_tip_its_top_speed():
    settings = scene(motion=hand(damping=0.5, top_speed_mm_s=20.0, trocar_mm=float("inf")))
    times = np.arange(0.0, 400.0, 0.005)
    tip = World(settings).motion.at(times).tip
    frequency = np.fft.rfftfreq(times.size, 0.005)
    power = np.sum(np.abs(np.fft.rfft(tip - tip.mean(axis=0), axis=0)) ** 2, axis=1)
    # A finite record leaks out of a band by the 1/T of its lines, 0.0025 Hz.
    tremor, slow = (frequency > 7.9) & (frequency < 12.1), (frequency > 0) & (frequency < 2.0)
    assert power[tremor].sum() + power[slow].sum() > 0.9999 * power[1:].sum()
    rms = np.sqrt(2 * power[tremor].sum()) / times.size
    # 64 lines 4 Hz / 64 apart: over 400 s their products average out to 1e-2.
    assert rms == pytest.approx(0.09, rel=0.02)
    own = World(settings).motion
    speed = own.speed(np.linspace(0.0, own.moments[-1], 20001))
    # Sought among moments 1 ms apart: 1 - cos(2 pi 12 Hz 0.5 ms) = 1e-3.
    assert speed.max() == pytest.approx(20.0, rel=1e-3)


def test_two_seeds_are_two_hands_and_one_is_one():
    first, again, other = (
        World(scene(motion=hand(seed=seed))).motion.at(np.arange(5.0)).tip for seed in (1, 1, 2)
    )
    assert np.array_equal(first, again)
    assert not np.allclose(first, other)


def test_labels_of_any_beam_lead_back_to_the_beam():
    world = World(scene(motion=hand()))
    for frame in range(0, world.times.size, 5):
        spots = world.truth
        beam = optics.beam_at_spot(
            World(scene()).wall,
            eccentricity=spots.eccentricity[frame],
            azimuth=spots.azimuth[frame],
            incidence=spots.incidence[frame],
            incidence_azimuth=spots.incidence_azimuth[frame],
            distance=spots.distance[frame],
            half_angle=0.1,
            apex_offset=0.0,
        )
        np.testing.assert_allclose(beam.tip, spots.beam.tip[frame], atol=1e-12)
        np.testing.assert_allclose(beam.axis, spots.beam.axis[frame], atol=1e-12)


def test_a_spot_on_the_axis_has_an_azimuth_that_its_direction_counts_from():
    settings = scene(spot={"eccentricity_mm": 0.0}, motion={"frames": 1, "start_mm": 2.0})
    spots = World(settings).truth
    assert float(spots.azimuth[0]) == 0.0
    # The scene counts 60 deg from its own azimuth of 20 deg.
    assert np.degrees(float(spots.incidence_azimuth[0])) == pytest.approx(80.0)


def test_a_recorded_motion_repeats_the_poses_of_its_file(tmp_path):
    settings = scene(motion=hand(duration_s=0.1), microscope=SMALL)
    first = render_stack(settings, tmp_path / "first")
    file = first.folder / "kinematics.csv"
    again = scene(motion={"kind": "recorded", "file": str(file)})
    own, other = World(settings).motion, World(again).motion
    stamps = np.arange(0.0, 0.1, 0.005)
    found = other.at(stamps + 0.1)  # the robot reports from 0.1 s before the first frame
    expected = own.at(stamps)
    # The file keeps 1 nm and 1 nrad.
    np.testing.assert_allclose(found.tip, expected.tip, atol=1e-6)
    np.testing.assert_allclose(found.axis, expected.axis, atol=1e-8)
    assert frame_count(again) == 4  # 0.1 s of motion and 0.1 s on either side, at 10 Hz


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "time_s,x_mm,y_mm,z_mm,axis_x,axis_y,axis_z\n0,0,0,0,0,0,-1\n1,0,here,0,0,0,-1\n",
            "line 3: y_mm must be a finite number; got 'here'",
        ),
        ("time_s,x_mm,y_mm,z_mm,axis_x,axis_y,axis_z\n0,0,0,0,0,0,-1\n", "at least two poses"),
    ],
)
def test_a_broken_recording_is_named_by_file_and_line(tmp_path, text, message):
    file = tmp_path / "poses.csv"
    file.write_text(text)
    with pytest.raises(SceneError, match=f"poses.csv.*{message}"):
        World(scene(motion={"kind": "recorded", "file": str(file)})).motion  # noqa: B018


def test_the_robots_clock_is_ahead_late_and_in_order():
    clocks = {"kinematics_offset_s": 0.25, "kinematics_jitter_s": 0.004, "camera_jitter_s": 0.002}
    settings = scene(motion=hand(duration_s=20.0), clocks=clocks)
    motion = World(settings).motion
    rows = kinematics(settings, motion)
    late = rows[:, 0] - (np.arange(len(rows)) / 200 - 0.1)
    assert np.all(np.diff(rows[:, 0]) >= 0)
    # Waiting for the one before delays stamps 4 ms apart in 5 ms: by less than their scatter.
    assert 0.25 < late.mean() < 0.254
    np.testing.assert_allclose(rows[:, 1:4], motion.at(np.arange(len(rows)) / 200 - 0.1).tip)
    jitter = frame_times(settings, motion) - np.arange(201) / 10
    # The standard error of a standard deviation of 201 numbers is 5 %.
    assert jitter.std() == pytest.approx(0.002, rel=0.15)
    still = scene(motion=hand())
    np.testing.assert_array_equal(
        frame_times(still, World(still).motion), World(still).motion.moments
    )


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        (
            {"motion": {"kind": "scan", "distance_mm": 0.01}, "instrument": {"visible": True}},
            r"at 0.000 s the tip.*in the wall",
        ),
        (
            {"motion": {"start_mm": 15.0, "travel_mm": 9.0}},
            r"at \d+\.\d+ s the tip.*leaves the eye",
        ),
        ({"motion": {"kind": "scan", "length_mm": 6.0}}, r"at 0.000 s the spot leaves the 640 x"),
        (
            {"motion": hand(top_speed_mm_s=0.1)},
            r"top_speed_mm_s must exceed the speed of the tremor",
        ),
        ({"motion": hand(trocar_mm=2.0)}, r"trocar_mm must exceed motion.distance_mm"),
    ],
)
def test_an_impossible_motion_is_refused_with_its_moment(parts, message):
    with pytest.raises(SceneError, match=message):
        World(scene(**parts)).truth  # noqa: B018


@pytest.mark.parametrize("kind", ["scan", "hand", "recorded"])
def test_the_template_shows_every_motion_ready_to_be_put_in_place(kind, tmp_path):
    blocks = scene_template().split("\n\n")
    block = next(b for b in blocks if f'# kind = "{kind}"' in b)
    plain = next(b for b in blocks if "\n[motion]" in b)
    lines = [line.removeprefix("# ") for line in block.splitlines()[1:]]
    file = tmp_path / "scene.toml"
    file.write_text("\n\n".join("\n".join(lines) if b is plain else b for b in blocks))
    assert load_scene(file).motion.kind == kind


def test_doubling_the_sub_frames_changes_no_pixel_by_more_than_the_noise():
    settings = scene(
        motion=hand(),
        microscope={**SMALL, "illumination_mw_mm2": 0.05},
        instrument={"visible": True},
    )
    renderer = Renderer(settings)
    frame = int(np.argmax(renderer.world.speed))
    duration = 0.01  # 80 % of full scale at the spot's peak, as metered below
    sharp = renderer.render(frame)
    exposed = renderer.exposed(frame, sharp, exposure_s=duration)
    count = 2 * exposed.sub_frames
    twice = renderer.gathered(frame, duration, count, range(count))
    electrons = duration * settings.exposures.sensitivity_mm2_sr_mj * settings.camera.full_well_e
    light = twice * electrons
    assert 0.5 * settings.camera.full_well_e < light.max() < settings.camera.full_well_e
    noise = np.sqrt(light + settings.camera.read_noise_e**2)
    change = np.abs(exposed.radiance - twice) * electrons
    assert np.all(change <= noise)
    # The frame is blurred at all, and its light is that of a sharp one but for the tip's way.
    assert np.max(np.abs(exposed.radiance - sharp.radiance) * electrons / noise) > 10


def test_blur_is_a_box_as_long_as_the_spots_way():
    settings = scene(
        phantom={"kind": "plane"},
        spot={"eccentricity_mm": 0.0, "azimuth_deg": 0.0, "incidence_deg": 0.0},
        motion={
            "kind": "scan",
            "distance_mm": 1.0,
            "length_mm": 1.0,
            "speed_mm_s": 5.0,
            "trocar_mm": float("inf"),
        },
        microscope={"width_px": 280, "height_px": 100},
    )
    renderer = Renderer(settings)
    sharp = renderer.render(1)
    exposed = renderer.exposed(1, sharp, exposure_s=0.02)
    row = exposed.radiance[50, :, 0] / exposed.radiance.max()
    # 5 mm/s for 0.02 s are 0.1 mm, 14.9 px; the rim rises in a straight line over so many px.
    rising = row[: np.argmax(row)]
    way = np.interp([0.1, 0.9], rising, np.arange(rising.size))
    # Of the box 80 %; the cone's inverse square adds 1 % of slope within the spot's radius.
    assert np.diff(way)[0] == pytest.approx(0.8 * 0.1 / 0.0067, abs=0.5)


def test_a_slow_withdrawal_needs_one_render_a_frame():
    settings = scene(
        instrument={"visible": True},
        motion={"start_mm": 1.0, "travel_mm": 1.0, "frames": 2},
        microscope=SMALL,
    )
    renderer = Renderer(settings)
    sharp = renderer.render(1)
    exposed = renderer.exposed(1, sharp, exposure_s=0.066)
    assert exposed.sub_frames == 1
    assert exposed.radiance is sharp.radiance


def test_a_withdrawal_starts_where_the_whole_spot_is_lit():
    # The cone's edge is 0.256 mm from its axis at the tip, 6 um outside of the fibre's rim.
    world = World(scene(spot={"incidence_deg": 0.0}, motion={"frames": 1}))
    ((tip,), (axis,)) = world.motion.at(np.zeros(1))
    edge = np.asarray(world.truth.contour)[0]
    assert np.min((edge - tip) @ axis) == pytest.approx(0.0, abs=1e-9)
    with pytest.raises(SceneError, match=r"0\.002 mm behind the tip.*Raise the distance"):
        World(scene(spot={"incidence_deg": 0.0}, motion={"start_mm": 0.001})).check()
