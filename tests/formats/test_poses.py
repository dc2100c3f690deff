"""Tables of any robot become poses, and robots that are wrong are refused with the reason."""

import math

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from eyespot.estimator.distance.withdrawal import withdrawal_of
from eyespot.estimator.rig.rig_reader import RecentPoses
from eyespot.formats.inputs import InputError
from eyespot.formats.poses import PoseTrack, RobotKeys, poses_of_table, read_poses

TIMES_S = np.linspace(0.0, 5.0, 51)
AXIS = np.array([0.5, 0.0, -math.sqrt(0.75)])
TRAVEL_MM = np.linspace(0.0, 5.0, 51)
TIPS_MM = np.array([3.0, -2.0, -8.0]) - np.outer(TRAVEL_MM, AXIS)
# A tool that points along AXIS, and is turned about it by 0.7 rad.
TURN = Rotation.align_vectors([AXIS], [[0.0, 0.0, 1.0]])[0] * Rotation.from_rotvec([0, 0, 0.7])


def table(names: str, *columns: np.ndarray) -> pd.DataFrame:
    """A table of one row a time; a column of one row is repeated."""
    rows = [
        np.broadcast_to(np.asarray(c, float), (TIMES_S.size, *np.shape(c)[-1:])) for c in columns
    ]
    return pd.DataFrame(np.column_stack([TIMES_S, *rows]), columns=names.split())


def plain(positions: np.ndarray = TIPS_MM, axis: np.ndarray = AXIS) -> pd.DataFrame:
    return table("time_s x_mm y_mm z_mm axis_x axis_y axis_z", positions, axis)


def withdrawn(poses: PoseTrack, **robot):
    return withdrawal_of(poses, np.linspace(0.1, 4.9, 9), robot=RobotKeys(**robot), where="trial")


@pytest.mark.parametrize(
    ("names", "position", "direction"),
    [
        ("time_s x_mm y_mm z_mm qx qy qz qw", TIPS_MM, TURN.as_quat()),
        ("stamp px py pz rx ry rz", TIPS_MM, TURN.as_rotvec()),
        ("timestamp tx ty tz q_x q_y q_z q_w", TIPS_MM, TURN.as_quat()),
        ("t x_m y_m z_m quat_x quat_y quat_z quat_w", TIPS_MM / 1e3, TURN.as_quat()),
        ("Time Pos_X[µm] Pos_Y[µm] Pos_Z[µm] Rx Ry Rz", TIPS_MM * 1e3, TURN.as_rotvec()),
    ],
)
def test_tables_of_other_software_have_the_same_poses(names, position, direction):
    poses = poses_of_table(table(names, position, direction))
    np.testing.assert_allclose(poses.positions_mm, TIPS_MM, atol=1e-12)
    for pose in poses:
        turn = Rotation.from_quat(pose.rotation)
        assert (turn * TURN.inv()).magnitude() < 1e-12
    np.testing.assert_allclose(poses.axes, np.tile(AXIS, (51, 1)), atol=1e-12)


def test_columns_whose_names_say_nothing_are_stated_in_the_rig_file():
    odd = table("clock c1 c2 c3 a b c note", TIPS_MM / 1e3, TURN.as_rotvec(), np.zeros(1))
    with pytest.raises(
        InputError, match=r"no times among the columns 'clock', 'c1'.*robot\.columns"
    ):
        poses_of_table(odd)
    names = dict(zip(["time_s", "x", "y", "z", "rx", "ry", "rz"], odd.columns, strict=False))
    poses = poses_of_table(odd, robot=RobotKeys(columns=names, unit="m"))
    np.testing.assert_allclose(poses.positions_mm, TIPS_MM, atol=1e-12)
    with pytest.raises(InputError, match=r"robot\.columns names 'q9'; the columns are 'clock'"):
        poses_of_table(odd, robot=RobotKeys(columns=names | {"x": "q9"}))
    with pytest.raises(ValueError, match="'speed' is no part of a pose"):
        RobotKeys(columns={"speed": "clock"})


@pytest.mark.parametrize("name", ["t_ms", "stamp [us]", "timestamp_ns", "time_s"])
def test_times_have_the_unit_of_their_column(name):
    unit = next(
        s for end, s in {"ms": 1e-3, "us": 1e-6, "ns": 1e-9, "_s": 1.0}.items() if end in name
    )
    epoch = 1_700_000_000.0
    given = plain().rename(columns={"time_s": name})
    given[name] = (
        np.round((epoch + TIMES_S) / unit).astype(np.int64) if unit < 1 else epoch + TIMES_S
    )
    # Doubles of this size are 2.4e-7 apart.
    np.testing.assert_allclose(poses_of_table(given).times_s, epoch + TIMES_S, rtol=0, atol=5e-7)
    if unit <= 1e-6:
        with pytest.raises(InputError, match=r"row 0: t must be a time in s.*_ms, _us, _ns"):
            poses_of_table(given.rename(columns={name: "t"}))


def test_times_after_iso_8601_count_from_1970(tmp_path):
    path = tmp_path / "robot.csv"
    rows = [f"2026-01-02T03:04:0{s}.250Z,0,0,{s},0,0,-1" for s in range(3)]
    path.write_text("\n".join(["time;x;y;z;axis_x;axis_y;axis_z", *rows]).replace(",", ";"))
    begin = pd.Timestamp("2026-01-02 03:04:00.25", tz="UTC").timestamp()
    np.testing.assert_allclose(read_poses(path).times_s, begin + np.arange(3), rtol=0, atol=5e-7)
    path.write_text(path.read_text().replace("04:01", "04:71"))
    with pytest.raises(InputError, match=r"robot\.csv, line 3: time must be a time \(ISO 8601\)"):
        read_poses(path)


def test_a_unit_that_contradicts_the_header_is_refused():
    with pytest.raises(InputError, match=r"'x_mm' and robot\.unit = 'm' differ"):
        poses_of_table(plain(), robot=RobotKeys(unit="m"))
    names = {"time_s": "t_ms"}
    with pytest.raises(InputError, match=r"time_s = 't_ms', but their units differ"):
        poses_of_table(plain().rename(columns={"time_s": "t_ms"}), robot=RobotKeys(columns=names))


def test_two_columns_of_one_meaning_are_refused_unless_one_is_named():
    two = plain().rename(columns={"time_s": "t"}).assign(stamp=TIMES_S + 7.0)
    with pytest.raises(InputError, match=r"'t' and 'stamp' can both be 'time'.*robot\.columns"):
        poses_of_table(two)
    assert poses_of_table(two, robot=RobotKeys(columns={"time_s": "stamp"})).times_s[0] == 7.0


def test_a_stages_travel_needs_its_direction():
    stage = table("time_s travel_um", 1e3 * TRAVEL_MM[:, None])
    with pytest.raises(InputError, match=r"robot\.travel_axis, from the tip towards the wall"):
        poses_of_table(stage)
    poses = poses_of_table(stage, robot=RobotKeys(travel_axis=tuple(2 * AXIS)))
    np.testing.assert_allclose(
        poses.positions_mm - poses.positions_mm[0], TIPS_MM - TIPS_MM[0], atol=1e-9
    )
    np.testing.assert_allclose(poses.axes, np.tile(AXIS, (51, 1)), atol=1e-12)


@pytest.mark.parametrize("tool_axis", ["+x", "-x", "+y", "-y", "+z", "-z"])
def test_flange_light_and_clock_are_as_the_rig_file_states(tool_axis):
    names = "time_s x_mm y_mm z_mm qx qy qz qw"
    offset = np.array([1.0, -2.0, 30.0])
    flange = table(names, TIPS_MM - TURN.apply(offset), TURN.as_quat())
    robot = RobotKeys(tool_axis=tool_axis, tip_mm=tuple(offset), clock_offset_s=0.25)
    poses = poses_of_table(flange, robot=robot)
    np.testing.assert_allclose(poses.times_s, TIMES_S + 0.25)
    np.testing.assert_allclose(poses.positions_mm, TIPS_MM, atol=1e-12)
    light = float(f"{tool_axis[0]}1") * np.eye(3)["xyz".index(tool_axis[1])]
    np.testing.assert_allclose(poses.axes[7], TURN.apply(light), atol=1e-12)


def test_the_live_node_turns_poses_as_the_file_reader_does():
    class Message:
        def __init__(self, **fields):
            self.__dict__ |= fields

    offset = (1.0, -2.0, 30.0)
    robot = RobotKeys(tool_axis="-x", tip_mm=offset, clock_offset_s=0.25)
    live = RecentPoses(robot)
    for n, place in enumerate(TIPS_MM.tolist()):
        position = Message(**dict(zip("xyz", place, strict=True)))
        turn = Message(**dict(zip("xyzw", TURN.as_quat().tolist(), strict=True)))
        live.take(Message(translation=position, rotation=turn), TIMES_S[n])
    names = "time_s x_mm y_mm z_mm qx qy qz qw"
    expected = poses_of_table(table(names, TIPS_MM, TURN.as_quat()), robot=robot)
    assert list(live.track()) == list(expected)


def test_an_axis_alone_knows_no_other_axes_of_the_tool():
    with pytest.raises(InputError, match=r"tool_axis = '\+x'.*whole rotation"):
        poses_of_table(plain(), robot=RobotKeys(tool_axis="+x"))
    turned = poses_of_table(plain(axis=-AXIS), robot=RobotKeys(tool_axis="-z"))
    np.testing.assert_allclose(turned.axes[0], AXIS, atol=1e-12)


def test_a_million_cells_are_read_as_they_were_written(tmp_path):
    rng = np.random.default_rng(0)
    path = tmp_path / "robot.csv"
    times = np.sort(1.7e9 + rng.uniform(0, 1e4, 2000))
    many = pd.DataFrame(np.column_stack([times, rng.normal(size=(2000, 3))]), columns=list("txyz"))
    many.assign(axis_x=0.0, axis_y=0.0, axis_z=-1.0).to_csv(path, index=False)
    poses = read_poses(path)
    assert (poses.times_s == times).all()
    assert (poses.positions_mm == many[["x", "y", "z"]].to_numpy()).all()


def test_a_withdrawal_has_the_distances_from_its_first_frame():
    found = withdrawn(poses_of_table(plain()), eye_from_robot=(0.0, 0.0, 0.0, 1.0))
    np.testing.assert_allclose(found.readings, np.linspace(0.0, 4.8, 9), atol=1e-12)
    np.testing.assert_allclose(found.motion, AXIS, atol=1e-12)
    np.testing.assert_allclose(found.axis, AXIS, atol=1e-12)


IDENTITY = (0.0, 0.0, 0.0, 1.0)


@pytest.mark.parametrize(
    ("positions", "axis", "robot", "said"),
    [
        (TIPS_MM[:1], AXIS, {}, r"stands still.*at least 0\.1 mm.*robot\.pose_topic"),
        (TIPS_MM / 1e3, AXIS, {}, r"moves by 0\.0048 mm.*in m but .*then 4\.8 mm\), write its own"),
        (TIPS_MM * 1e3, AXIS, {}, r"moves by 4800 mm.*in mm but .*then 4\.8 mm\), write its own"),
        (2 * TIPS_MM[0] - TIPS_MM, AXIS, {}, r"4\.8 mm towards the wall.*reverse robot\.tool_axis"),
        (TIPS_MM, -AXIS, {}, r"4\.8 mm towards the wall.*reverse robot\.tool_axis \(now '\+z'\)"),
        (TIPS_MM, -AXIS, {"eye_from_robot": IDENTITY}, r"points to the microscope.*z = \+0\.87"),
        (TIPS_MM, [0.0, 0.0, -1.0], {}, r"30\.0° from the tool's axis.*robot\.tool_axis"),
        (TIPS_MM + [0, 0.2, 0] * (TIMES_S[:, None] > 2), AXIS, {}, "leaves a straight line by"),
        (
            TIPS_MM[np.abs(np.arange(51) - 10)],
            AXIS,
            {},
            r"goes 0\.6 mm further.*before the contact",
        ),
    ],
)
def test_a_robot_that_is_wrong_is_refused_with_the_likely_cause(positions, axis, robot, said):
    poses = poses_of_table(plain(positions, np.array(axis)))
    with pytest.raises(InputError, match=said):
        withdrawn(poses, **robot)


def test_an_approach_has_a_free_first_distance():
    poses = poses_of_table(plain(TIPS_MM[::-1]))
    np.testing.assert_allclose(
        withdrawn(poses, touch="free").readings, -np.linspace(0.0, 4.8, 9), atol=1e-12
    )
    assert withdrawn(poses, touch=(4.8, 0.02)).readings[-1] == pytest.approx(-4.8)
    with pytest.raises(InputError, match=r"4\.8 mm towards the wall, from which it is 4 mm away"):
        withdrawn(poses, touch=(4.0, 0.02))


def test_rows_of_one_time_are_refused():
    twice = plain().loc[np.repeat(np.arange(51), 2)]
    with pytest.raises(InputError, match=r"of 96 poses .* at 0\.2.*its place, too.*twice"):
        withdrawn(poses_of_table(twice))
    coarse = plain().assign(time_s=np.floor(TIMES_S / 0.2) * 0.2 + 0.05)
    with pytest.raises(InputError, match=r"but another place.*more digits"):
        withdrawn(poses_of_table(coarse))
    with pytest.raises(InputError, match=r"All 51 poses .* 7\.000 s.*robot\.columns"):
        withdrawn(poses_of_table(plain().assign(time_s=7.0)))


def test_a_recording_given_twice_goes_back_in_time():
    with pytest.raises(InputError, match=r"row 51: the time goes back.*two recordings"):
        poses_of_table(pd.concat([plain(), plain()], ignore_index=True))


def test_times_in_milliseconds_that_are_called_seconds_are_a_likely_cause():
    slow = plain().assign(time_s=1e3 * TIMES_S)
    with pytest.raises(InputError, match=r"last 5000 s and the frames' 4\.8 s.*time_ms"):
        withdrawn(poses_of_table(slow))


def test_frames_without_a_time_have_no_poses():
    with pytest.raises(InputError, match=r"1 of 2 frames of trial have no time.*frames\.csv"):
        withdrawal_of(
            poses_of_table(plain()), np.array([0.1, np.nan]), robot=RobotKeys(), where="trial"
        )


@pytest.mark.parametrize(("comma", "cells"), [(",", ";"), (".", ";"), (".", "\t"), (".", ",")])
def test_a_spreadsheets_table_has_the_same_poses(tmp_path, comma, cells):
    path = tmp_path / "robot.csv"
    text = plain().to_csv(index=False, sep=cells, decimal=comma, lineterminator="\r\n")
    # A spreadsheet marks UTF-8 and keeps the rows that were emptied.
    path.write_text(f"\ufeff{text}{cells * 6}\r\n", newline="")
    poses = read_poses(path)
    np.testing.assert_allclose(poses.times_s, TIMES_S, rtol=0, atol=1e-12)
    np.testing.assert_allclose(poses.positions_mm, TIPS_MM, rtol=0, atol=1e-12)


BEGUN = "time_s,x_mm,y_mm,z_mm,axis_x,axis_y,axis_z\n0.5,1,2,3,0,0,1\n\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (f"{BEGUN}1,2,3,4,0,0\n", "line 4: 7 cells expected"),
        (f"{BEGUN}1,2,3,4,0,0,1,9\n", "not a CSV file.*line 4"),
        (f"{BEGUN}1,2,,4,0,0,1\n", "line 4: y_mm must be a finite number; got ''"),
        (f'{BEGUN}1,2,3,4,0,0,"1\n"x\n', "line 5: axis_z"),
        (f"{BEGUN}0.1,2,3,4,0,0,1\n", r"line 4: the time goes back from 0\.5.* to 0\.1"),
        (f"{BEGUN}1,2,3,4,0,0,2\n", "line 4: .* unit vector"),
        (f"{BEGUN}nan,2,3,4,0,0,1\n", "line 4: .* finite"),
        ("time_s,x_mm,y_mm\n0,1,2,3,4,5\n", "more cells than its header.*decimal commas"),
        (
            "time_s;x;y;z;axis_x;axis_y;axis_z\n0;1.000,5;2;3;0;0;-1\n",
            r"x must be a finite number; got '1\.000,5'",
        ),
        ("time_s,x_mm,y_mm,z_mm\n1,2,3,4\n", "no direction of the tool among the columns 'time_s'"),
        ("time_s,x_mm,y_mm,z_mm,qx,qy,qz,qw\n1,2,3,4,0,0,0,0\n", "line 2: .* unit quaternion"),
        ("", "no times among the columns none"),
        ("0.1,2,3,-4,0,0,-1\n0.2,2,3,-4,0,0,-1\n", "no header: the first line is the numbers"),
        ("time_s,x_mm\n".encode("utf-16").decode("latin-1"), "not a text file.*UTF-8"),
    ],
)
def test_a_bad_row_is_named_by_its_line_and_another_table_with_what_to_do(tmp_path, text, said):
    path = tmp_path / "robot.csv"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match=rf"(?s)robot\.csv.*{said}"):
        read_poses(path)


def test_a_table_without_rows_is_refused():
    with pytest.raises(InputError, match="robot holds no poses"):
        poses_of_table(plain().iloc[:0], where="robot")
