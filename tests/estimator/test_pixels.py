"""The mode pixels: its light, its texture, its poses on rendered frames, and what it refuses."""

import itertools
import json
import math

import numpy as np
import pytest

import optics
from estimator.pixels.cells import COUNT, CellLight, CellWindow, rolled
from estimator.pixels.picture import _most_even
from estimator.pixels.tracker import PixelRanger
from estimator.run.options import Options
from estimator.sources.opening import open_source
from formats.inputs import InputError
from formats.spots import NoSpot, Reason, RecordedPose, SpotRecord, read_spots, write_spots
from optics.wall_light.cone import UniformCone
from optics.wall_light.pose_light import BeamFrame, Steps, irradiance_and_slopes, square_lattice
from tests.pixel_stacks import assert_posed, calibration_in, cone_stack, reader_in, readings_of

_HALF_ANGLE, _APEX = math.atan(1 / 20), -5.117
_WALL = optics.Sphere(11.5)
_CAMERA = optics.microscope(
    scale=0.0067, pinhole_height=11.5, eye_radius=11.5, principal_point=(100.0, 100.0)
)
_ACROSS = np.zeros((0, 0))


def _frame(tip, axis, distance):
    first, second = (np.asarray(v) for v in optics.perpendicular_frame(np.asarray(axis)))
    return BeamFrame(
        tip=np.asarray(tip),
        axis=np.asarray(axis),
        distance=np.asarray(distance),
        right=np.array([1.0, 0.0, 0.0]),
        down=np.array([0.0, 1.0, 0.0]),
        first=first,
        second=second,
    )


def _light(frame, *, corner=(-30.5, -30.5), side=10.0, steps=None):
    lattice = square_lattice(
        _CAMERA, _WALL, corner=np.array(corner), right=np.array([side, 0.0]), count=COUNT
    )
    value, slopes = irradiance_and_slopes(
        lattice,
        UniformCone.of(_HALF_ANGLE, _APEX),
        frame,
        own=np.zeros(2),
        spread=np.eye(2),
        steps=steps,
    )
    return np.asarray(value), np.asarray(slopes), np.asarray(lattice.area).ravel()


def test_a_cone_s_whole_power_falls_on_the_cells_around_its_spot():
    value, _, area = _light(_frame([0.0, 0.0, -9.0], [0.0, 0.0, -1.0], 2.5))
    # The cells' areas are those of their tangent planes: off by the sagitta of a cell of 0.067 mm
    # on a sphere of 11.5 mm, 4e-6 of the area. Elsewhere the sum telescopes, edge by edge.
    assert value @ area == pytest.approx(1.0, abs=2e-5)


def test_derivatives_of_the_cells_light_are_central_differences():
    tip, axis = np.array([0.05, -0.1, -9.0]), np.array([0.1, 0.05, 0.0])
    axis[2] = -math.sqrt(1 - axis @ axis)
    frame = _frame(tip, axis, 2.45)
    _, slopes, _ = _light(frame)
    step = 1e-5

    def moved(sign):
        turned = frame.axis + sign * step * frame.first
        turned = turned / np.linalg.norm(turned)
        spot = tip + 2.45 * axis
        return _light(frame._replace(tip=spot - 2.45 * turned, axis=turned))[0]

    differences = (moved(1) - moved(-1)) / (2 * step)
    # The edge moves by 2.5 mm x 1e-5, 4e-4 of a cell. Where it crosses a corner within the step,
    # the derivative changes by some ten times that.
    scale = np.abs(slopes[3]).max()
    np.testing.assert_allclose(differences, slopes[3], atol=5e-3 * scale)
    assert np.mean(np.abs(differences - slopes[3]) < 1e-4 * scale) > 0.98


def test_the_light_of_a_beam_that_moves_has_the_derivatives_of_its_whole_way():
    tip, axis = np.array([0.05, -0.1, -9.0]), np.array([0.1, 0.05, 0.0])
    axis[2] = -math.sqrt(1 - axis @ axis)
    frame = _frame(tip, axis, 2.45)
    ways = np.linspace(-0.1, 0.1, 8)  # three cells
    aways = ways[:, None] * np.array([1.0, 0.5, 0.0])
    turns = 0.02 * ways[:, None] * np.array([0.0, 1.0, 0.0])
    steps = Steps(tips=aways, axes=turns, shares=np.full(8, 1 / 8))
    value, slopes, _ = _light(frame, steps=steps)
    step = 1e-5

    def seen(aside):
        """One place after the other, each as a beam at rest."""
        light = []
        for away, turn in zip(aways, turns, strict=True):
            turned = axis + turn
            place = tip + aside * frame.right + away
            light.append(_light(_frame(place, turned / np.linalg.norm(turned), 2.45))[0])
        return np.mean(light, axis=0)

    np.testing.assert_allclose(value, seen(0.0), rtol=1e-12, atol=1e-12)
    differences = (seen(step) - seen(-step)) / (2 * step)
    # As above: where an edge crosses a corner of a cell within the step, the derivative jumps.
    scale = np.abs(slopes[0]).max()
    np.testing.assert_allclose(differences, slopes[0], atol=5e-3 * scale)
    # A beam at rest has all of its edge in one place, and there the steepest light.
    assert scale < 0.6 * np.abs(_light(frame)[1][0]).max()


def test_a_cell_that_the_cone_s_edge_cuts_has_the_mean_light_of_its_points():
    tip, axis = np.array([0.05, -0.1, -9.0]), np.array([0.3, 0.25, 0.0])
    axis[2] = -math.sqrt(1 - axis @ axis)
    meeting = _WALL.intersect(tip, axis)
    corner = np.round(np.asarray(_CAMERA.project(meeting.point)) - 130.0) - 0.5
    distance = float(np.linalg.norm(np.asarray(meeting.point) - tip))
    value, _, _ = _light(_frame(tip, axis, distance), corner=corner)
    light, side, fine = value.reshape(COUNT, COUNT), 10.0, 100
    cut = np.argwhere((light > 0.05 * light.max()) & (light < 0.9 * light.max()))[::4]
    place = side * (np.arange(fine) + 0.5) / fine
    for row, column in cut:
        u, v = np.meshgrid(corner[0] + side * column + place, corner[1] + side * row + place)
        seen = _WALL.intersect(*_CAMERA.ray(np.stack([u.ravel(), v.ravel()], axis=-1)))
        offset = np.asarray(seen.point) - (tip + _APEX * axis)
        far = np.linalg.norm(offset, axis=1)
        inside = offset @ axis > far * math.cos(_HALF_ANGLE)
        cosine = -np.sum(offset * np.asarray(seen.normal), axis=1) / far
        points = np.where(inside, cosine / far**2, 0.0) / (2 * np.pi * (1 - math.cos(_HALF_ANGLE)))
        # Of 100 rows of points each is cut at a random place: 0.3 / sqrt(100) of a point's share,
        # 3e-4 of the step. Rows along the edge are cut alike, which is up to ten times as much.
        assert light[row, column] == pytest.approx(points.mean(), abs=3e-3 * light.max())


def test_the_mixture_of_channels_cancels_what_they_share():
    rng = np.random.default_rng(5)
    vessel = rng.standard_normal(500)
    contrast = np.array([0.05, 0.20, 0.15])
    residuals = contrast[:, None] * vessel + 0.003 * rng.standard_normal((3, 500))
    parts = _most_even(residuals)
    assert parts.sum() == pytest.approx(1.0)
    assert np.std(parts @ residuals) < 0.5 * np.std(residuals[0])


def test_cells_with_an_unusable_pixel_and_cells_outside_of_the_image_are_left_out():
    usable = np.ones((200, 200), bool)
    usable[57, 83] = False
    cells = CellLight(np.full((200, 200), 0.25), usable, np.zeros_like)
    light, kept = cells.means(CellWindow(left=40, top=30, side=7))
    assert not kept[(57 - 30) // 7, (83 - 40) // 7]
    assert not kept[-1].any()  # 30 + 26 * 7 = 212 px
    assert np.count_nonzero(~kept[:24, :22]) == 1
    np.testing.assert_allclose(light[:24, :22], 0.25)


def test_a_window_stays_as_long_as_it_serves_and_moves_ahead_by_whole_cells():
    window = CellWindow.around(np.array([300.0, 200.0]), 70.0)
    for way in (3.0, -3.0):
        places = [np.array([300.0 + way * k, 200.0]) for k in range(60)]
        now, changes = window, 0
        for before, place in itertools.pairwise(places):
            then = now.following(place, 70.0, place - before)
            changes += then != now
            assert then.side == now.side
            assert (then.left - now.left) % now.side == 0
            now = then
            # All that must be seen of a spot lies within: a reach of 70 px less a fifth.
            assert np.abs(place - now.middle_px).max() + 0.8 * 70.0 < 13 * now.side
        assert 1 <= changes < 20
    assert window.following(np.array([300.0, 200.0]), 100.0, np.zeros(2)).side > window.side


def test_the_model_of_a_moved_window_is_that_of_the_same_cells():
    values = np.arange(2.0 * COUNT**2).reshape(2, -1)
    moved = rolled(values, 3, -2).reshape(2, COUNT, COUNT)
    old = values.reshape(2, COUNT, COUNT)
    # Cell (row, column) of the new window is (row - 2, column + 3) of the old one.
    np.testing.assert_array_equal(moved[:, 2:, :-3], old[:, :-2, 3:])
    assert not moved[:, :2].any()
    assert not moved[:, :, -3:].any()


@pytest.mark.parametrize("way", [(COUNT, 0), (-40, 3), (2, 31)])
def test_a_window_that_has_moved_by_more_than_its_side_has_none_of_its_cells(way):
    assert not rolled(np.ones(COUNT**2), *way).any()


def test_poses_of_rendered_frames_are_within_their_stated_errors(paper_stack, tmp_path):
    # 5 px RMS of the semi-minor axis would be 0.7 mm; a texture of 5 % leaves some micrometres.
    assert_posed(readings_of(paper_stack, tmp_path), within_mm=0.02)
    reader = reader_in(paper_stack, tmp_path)
    assert not any(reader.read(frame.image).doubt for frame in open_source(paper_stack.folder))


def test_a_wall_that_has_changed_does_not_pull_the_pose(paper_stack, tmp_path):
    paper = {"wall": "printed paper", "texture_seed": 9}
    other = cone_stack(tmp_path / "other", phantom=paper)
    reader = reader_in(paper_stack, tmp_path, eye_from_robot=None)
    assert reader.mode == "pixels"
    frames = [list(open_source(one.folder)) for one in (paper_stack, other)]
    for wall, index in ((0, 0), (0, 1), (1, 2)):
        reading = reader.read(frames[wall][index].image)
    assert reading.range is not None
    (pose,) = reading.range.poses
    assert pose.covariance is not None
    off = pose.tip_mm - np.array(other.labels[2].tip_mm)
    # Chi squared of three numbers exceeds 21 once in 10,000.
    assert off @ np.linalg.solve(pose.covariance[:3, :3], off) < 21


def test_a_microscope_file_without_the_camera_s_noise_is_refused(paper_stack, tmp_path):
    content = json.loads((paper_stack.folder / "microscope.json").read_text())
    del content["camera"]
    path = tmp_path / "microscope.json"
    path.write_text(json.dumps(content))
    options = {"mode": "pixels", "calibration": calibration_in(tmp_path), "microscope": path}
    with pytest.raises(InputError, match="needs the camera's noise"):
        Options.of(options).reader()


def test_the_mode_needs_a_calibration_and_takes_no_model(paper_stack, tmp_path):
    microscope = paper_stack.folder / "microscope.json"
    with pytest.raises(InputError, match="needs a calibration"):
        Options.of({"mode": "pixels", "microscope": microscope}).reader()
    options = {"mode": "pixels", "calibration": calibration_in(tmp_path), "microscope": microscope}
    with pytest.raises(InputError, match="model has no effect"):
        Options.of({**options, "model": "exact"}).reader()
    assert PixelRanger.model == "pixels"


def test_a_pose_survives_the_spots_file(tmp_path):
    rng = np.random.default_rng(1)
    root = rng.normal(size=(5, 5))
    pose = RecordedPose(
        np.array([0.1, -0.2, -9.0]), np.array([0.0, 0.6, -0.8]), root @ root.T, 1.07
    )
    record = SpotRecord(
        frame=0,
        file_name="a.png",
        time_s=0.5,
        mode="pixels",
        result=NoSpot(Reason.NONE_FOUND),
        distance_mm=2.5,
        sigma_distance_mm=0.002,
        pose=pose,
    )
    write_spots(tmp_path / "spots.csv", [record])
    (found,) = read_spots(tmp_path / "spots.csv")
    assert found.pose is not None
    for mine, its in zip(pose, found.pose, strict=True):
        np.testing.assert_array_equal(mine, its)
