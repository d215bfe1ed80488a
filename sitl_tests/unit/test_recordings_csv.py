"""The laboratory's CSV folder: units, other rates, gaps, and errors that name file, line and column."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from companion.adapters.recordings.recording import InertialStream
from companion.adapters.recordings.recording_factory import open_recording
from companion.adapters.recordings.tables.csv import Covariate, CsvRecording, RangeTable
from companion.adapters.recordings.tables.csv_writer import streams_of, write_folder
from companion.errors import RecordingError, TableError
from companion.params.files import load_airframe
from companion.records import Axis, ClockName, ImuBatch, Station

AIRFRAME = load_airframe("nadir-2m")


def folder(tmp_path: Path, **files: str) -> Path:
    for name, text in files.items():
        (tmp_path / f"{name}.csv").write_text(text)
    return tmp_path


def read(tmp_path: Path, **files: str) -> CsvRecording:
    return CsvRecording(folder(tmp_path, **files), AIRFRAME)


def stream(recording: CsvRecording, station: Station) -> InertialStream:
    (station_stream,) = [entry for entry in recording.streams if entry.station is station]
    return station_stream


def test_units_become_si_and_every_column_finds_its_axis(tmp_path: Path) -> None:
    recording = read(
        tmp_path,
        accel="t_s,left_z_g,left_p_degps,right_z_mg,right_y_mps2,root_q_radps,left_x_mps2\n"
        "0.000,-1,180,-1000,2.5,0.25,0.5\n0.001,-2,90,-500,3.5,0.5,0.75\n",
    )
    left, right, root = (stream(recording, station) for station in (Station.LEFT, Station.RIGHT, Station.ROOT))
    np.testing.assert_allclose(left.values[:, 2], [-9.80665, -19.6133], rtol=1e-15)
    np.testing.assert_allclose(left.values[:, 3], [np.pi, np.pi / 2], rtol=1e-15)
    np.testing.assert_allclose(right.values[:, 2], [-9.80665, -4.903325], rtol=1e-15)
    assert left.axes == Axis.X | Axis.Z | Axis.P
    assert right.axes == Axis.Y | Axis.Z
    assert root.axes == Axis.Q
    assert right.values[:, 1].tolist() == [2.5, 3.5]
    assert left.t_ns.tolist() == [0, 1_000_000]
    assert not left.values[:, [1, 4, 5]].any()


def test_the_airframe_learns_what_is_really_there(tmp_path: Path) -> None:
    recording = read(tmp_path, accel="t_s,left_z_mps2,right_z_mps2\n0,1,2\n0.002,1,2\n0.004,1,2\n0.006,1,2\n")
    assert recording.airframe.left.sends == "z"
    assert recording.airframe.right.rate_hz == pytest.approx(500.0)
    assert recording.airframe.root == AIRFRAME.root
    assert recording.hub is ClockName.HOST
    assert recording.airframe.left.source.clock is ClockName.HOST
    assert any("no samples of 'root'" in notice.text for notice in recording.notices)


def test_places_at_other_rates_come_in_files_of_their_own(tmp_path: Path) -> None:
    recording = read(
        tmp_path,
        accel="t_s,left_z_mps2,airspeed_mps\n0,1,14\n0.01,2,15\n0.02,3,15\n",
        accel_right="t_s,right_z_mps2\n0.001,1\n0.006,2\n0.011,3\n0.016,4\n0.021,5\n",
        accel_root="t_s,z_g,q_degps\n0.0,-1,0\n0.02,-1,10\n",
    )
    sizes = {entry.station: entry.t_ns.size for entry in recording.streams}
    assert sizes == {Station.LEFT: 3, Station.RIGHT: 5, Station.ROOT: 2}
    assert stream(recording, Station.ROOT).axes == Axis.Z | Axis.Q
    assert recording.covariates["airspeed_mps"].values.tolist() == [14, 15, 15]
    arrivals = [batch.received_host_ns for batch in recording.records()]
    assert arrivals == sorted(arrivals)
    assert sum(batch.t_ns.size for batch in recording.records()) == 10


def test_axes_of_a_place_in_two_files_are_put_on_the_stamps_of_the_longer(tmp_path: Path) -> None:
    fast = [i / 100 for i in range(101)]
    slow = [t for t in fast[2:99:4] if not 0.4 < t < 0.6]
    recording = read(
        tmp_path,
        accel="t_s,left_z_mps2\n" + "".join(f"{t},{-9.8 - t}\n" for t in fast),
        accel_left="t_s,left_p_radps\n" + "".join(f"{t},{2 * t}\n" for t in slow),
    )
    left = stream(recording, Station.LEFT)
    assert left.axes == Axis.Z | Axis.P
    np.testing.assert_allclose(left.values[:, 2], -9.8 - left.t_ns * 1e-9, rtol=1e-12)
    np.testing.assert_allclose(left.values[:, 3], 2 * left.t_ns * 1e-9, rtol=1e-12)
    t_s = left.t_ns * 1e-9
    assert (t_s.min(), t_s.max()) == pytest.approx((slow[0], slow[-1]))
    assert not ((t_s > 0.385) & (t_s < 0.615)).any(), "nothing is made up inside the gap"


def test_covariates_keep_their_unit_and_inputs_become_si(tmp_path: Path) -> None:
    recording = read(
        tmp_path, accel="t_s,left_z_mps2,airspeed_kmh,rpm,input_g,roller\n0,1,36,5000,2,0.5\n1,1,36,5000,2,0.5\n"
    )
    assert recording.covariates["airspeed_kmh"].values[0] == 36
    assert recording.covariates["rpm"].values[0] == 5000
    assert recording.covariates["input_mps2"].values[0] == pytest.approx(19.6133)
    notice_texts = [notice.text for notice in recording.notices if "no unit" in notice.text]
    assert len(notice_texts) == 1
    assert "'roller'" in notice_texts[0]


def test_the_range_table(tmp_path: Path) -> None:
    accel = "t_s,left_z_mps2\n0,1\n1,1\n"
    recording = read(
        tmp_path, accel=accel, range="t_s,range_m,disparity_px,reference_m\n0.1,52.8,30,60\n0.2,inf,0,61\n"
    )
    assert recording.ranges is not None
    assert recording.ranges.range_m.tolist() == [52.8, np.inf]
    assert recording.ranges.reference_m is not None
    assert recording.ranges.reference_m.tolist() == [60, 61]
    assert recording.ranges.t_command_s is None


def test_gaps_are_allowed_and_told(tmp_path: Path) -> None:
    rows = [i * 0.001 for i in range(100) if not 40 <= i < 60]
    recording = read(tmp_path, accel="t_s,left_z_mps2\n" + "".join(f"{t:.6f},1\n" for t in rows))
    assert stream(recording, Station.LEFT).t_ns.size == 80
    (gap_notice,) = [notice.text for notice in recording.notices if " longer than " in notice.text]
    assert "left: 1 gap longer than 2.5 ms" in gap_notice
    assert "21.0 ms" in gap_notice


GOOD = "t_s,left_z_mps2,right_z_mps2\n0,1,2\n0.001,1,2\n0.002,1,2\n"


@pytest.mark.parametrize(
    ("accel", "line", "words"),
    [
        (GOOD.replace("t_s", "time"), 1, "column 't_s' is missing"),
        (GOOD.replace("left_z_mps2", "left_z_ms2"), 1, "'left_z_ms2': unit 'ms2' must be one of mps2, g, mg"),
        (GOOD.replace("left_z_mps2", "left_z_radps"), 1, "unit 'radps' must be one of mps2, g, mg"),
        (GOOD.replace("left_z_mps2", "left_p_mps2"), 1, "unit 'mps2' must be one of radps, degps, mradps"),
        (GOOD.replace("left_z_mps2", "left_w_mps2"), 1, "axis 'w' must be x, y, z"),
        (GOOD.replace("left_z_mps2", "lift_z_mps2"), 1, "place 'lift' must be one of root, left, right"),
        (GOOD.replace("left_z_mps2", "left_z"), 1, "'left_z' must be <place>_<axis>_<unit>"),
        (GOOD.replace("left_z_mps2", "right_z_mps2"), 1, "column 'right_z_mps2' is there twice"),
        (GOOD.replace("left_z_mps2", ""), 1, "column 2 has no name"),
        (GOOD.replace("0.001,1,2", "0.001,,2"), 3, "column 'left_z_mps2' is empty"),
        (GOOD.replace("0.001,1,2", "0.001,nan,2"), 3, "column 'left_z_mps2': 'nan' is not a finite number"),
        (GOOD.replace("0.001,1,2", "0.001,1,-inf"), 3, "column 'right_z_mps2': '-inf' is not a finite number"),
        (GOOD.replace("0.001,1,2", "0.001,1,2.x"), 3, "column 'right_z_mps2': '2.x' is not a number"),
        (GOOD.replace("0.001,1,2", "0.001,1"), 3, "2 cells, but the header has 3 columns"),
        (GOOD.replace("0.001,1,2", "0.001,1,2,3"), 3, "4 cells, but the header has 3 columns"),
        ("t_s,left_z_mps2\n", 2, "no row of numbers"),
        ("t_s;left_z_mps2\n0;1\n", 1, "columns separated by commas"),
        ("", 1, "columns separated by commas"),
        ("t_s,airspeed_mps\n0,1\n", 1, "no column <place>_<axis>_<unit>"),
        ("t_s,left_z_mps2\n" + "".join(f"{i},1,2\n" for i in range(5)), 2, "3 cells, but the header has 2 columns"),
    ],
)
def test_whatever_is_wrong_is_named_with_file_and_line(tmp_path: Path, accel: str, line: int, words: str) -> None:
    with pytest.raises(TableError) as caught:
        read(tmp_path, accel=accel)
    assert str(caught.value).startswith(f"{tmp_path / 'accel.csv'}, line {line}: ")
    assert words in str(caught.value)


@pytest.mark.parametrize(("again", "complaint"), [("0.001", "repeat the one before"), ("0.0005", "go back")])
def test_stamps_that_repeat_or_go_back_are_read_and_told(tmp_path: Path, again: str, complaint: str) -> None:
    recording = read(tmp_path, accel=GOOD.replace("0.002,", f"{again},"))
    assert sum(len(batch.t_ns) for batch in recording.records() if batch.station is Station.LEFT) == 3
    assert any(f"1 of 3 stamps {complaint}" in notice.text for notice in recording.notices)


def test_errors_in_the_other_files_name_them(tmp_path: Path) -> None:
    with pytest.raises(TableError, match=r"range\.csv, line 1: column 'range_m' is missing"):
        read(tmp_path, accel=GOOD, range="t_s,distance_m\n0,1\n")
    with pytest.raises(TableError, match=r"range\.csv, line 3: column 'range_m': 'nan'"):
        read(tmp_path, accel=GOOD, range="t_s,range_m\n0,1\n1,nan\n")
    with pytest.raises(TableError, match=r"accel_right\.csv, line 1: axes of 'right' are in accel\.csv as well"):
        read(tmp_path, accel=GOOD, accel_right="t_s,right_z_g\n0,1\n")
    with pytest.raises(TableError, match=r"'left_z_g' does not belong into accel_right\.csv"):
        read(tmp_path, accel="t_s,left_z_g\n0,1\n", accel_right="t_s,left_z_g\n0,1\n")
    (tmp_path / "accel_right.csv").rename(tmp_path / "accel_tail.csv")
    with pytest.raises(RecordingError, match=r"accel_tail\.csv: the place must be one of root, left, right"):
        CsvRecording(tmp_path, AIRFRAME)


def test_a_folder_without_samples_or_airframe_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"no accel\.csv in this folder"):
        open_recording(tmp_path, AIRFRAME)
    with pytest.raises(RecordingError, match="give its airframe"):
        open_recording(folder(tmp_path, accel=GOOD))
    assert open_recording(tmp_path, AIRFRAME).hub is ClockName.HOST


_NUMBERS = st.floats(-1e6, 1e6, allow_nan=False)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_what_is_written_comes_back_bit_for_bit(data: st.DataObject, tmp_path: Path) -> None:
    streams, n = [], 0
    for station in data.draw(st.lists(st.sampled_from(list(Station)), min_size=1, max_size=3, unique=True)):
        n = data.draw(st.integers(1, 4))
        t_ns = np.cumsum(data.draw(st.lists(st.integers(1, 10**12), min_size=n, max_size=n))).astype(np.int64)
        axes = Axis(data.draw(st.integers(1, 63)))
        values = np.zeros((n, 6))
        for i in [i for i in range(6) if axes >> i & 1]:
            values[:, i] = data.draw(st.lists(_NUMBERS, min_size=n, max_size=n))
        streams.append(InertialStream(station, ClockName.HOST, axes, t_ns, values))
    first = streams[0]
    count = first.t_ns.size
    covariate = Covariate("airspeed_mps", first.t_ns / 1e9, np.arange(count, dtype=float))
    ranges = RangeTable(np.array([0.5, 1.5]), np.array([60.1, np.inf]), t_command_s=np.array([0.49, 1.49]))
    for stale in tmp_path.glob("*.csv"):
        stale.unlink()
    write_folder(tmp_path, streams, [covariate], ranges)
    back = CsvRecording(tmp_path, AIRFRAME)
    for written in streams:
        read_back = stream(back, written.station)
        assert read_back.axes == written.axes
        assert read_back.t_ns.tobytes() == written.t_ns.tobytes()
        assert read_back.values.tobytes() == written.values.tobytes()
    assert back.covariates["airspeed_mps"].values.tobytes() == covariate.values.tobytes()
    assert back.ranges is not None
    assert back.ranges.t_command_s is not None
    assert back.ranges.t_command_s.tolist() == [0.49, 1.49]


def test_batches_are_joined_to_streams_in_order_of_time() -> None:
    def batch(station: Station, *t_ns: int) -> ImuBatch:
        values = np.array(t_ns, dtype=float)[:, None] * np.ones(6)
        return ImuBatch(station, ClockName.HOST, np.array(t_ns, dtype=np.int64), values, Axis.ALL, max(t_ns))

    streams = streams_of([batch(Station.LEFT, 3, 4), batch(Station.ROOT, 1), batch(Station.LEFT, 1, 4, 2)])
    assert [entry.station for entry in streams] == [Station.ROOT, Station.LEFT]
    assert streams[1].t_ns.tolist() == [1, 2, 3, 4]
    assert streams[1].values[:, 0].tolist() == [1, 2, 3, 4]


def level(tmp_path: Path, header: str, z: float) -> CsvRecording:
    return read(tmp_path, accel=header + "\n" + "".join(f"{0.001 * k:.3f},{z + 0.01 * (k % 3)}\n" for k in range(300)))


def test_stamps_in_unix_milliseconds_are_refused(tmp_path: Path) -> None:
    rows = "".join(f"{1.7e12 + 2 * i:.0f},-9.8\n" for i in range(5))
    with pytest.raises(RecordingError, match=r"accel\.csv: t_s reaches 1\.7e\+12, t_s must be in seconds"):
        read(tmp_path, accel="t_s,left_z_mps2\n" + rows)


@pytest.mark.parametrize(("unit_s", "said"), [(1e-3, "every 5 s"), (1e-6, "every 5000 s")])
def test_stamps_in_another_unit_are_refused(tmp_path: Path, unit_s: float, said: str) -> None:
    """Samples at 200 Hz whose stamps begin at 0, in ms or us."""
    rows = "".join(f"{0.005 * k / unit_s:.9g},-9.8\n" for k in range(600))
    with pytest.raises(RecordingError, match=rf"accel\.csv: samples come {said}.* is t_s in seconds"):
        read(tmp_path, accel="t_s,left_z_mps2\n" + rows)


def test_a_vertical_axis_that_points_up_is_refused_with_what_it_should_read(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"'left_z' reads \+1\.00 g .*turn its sign"):
        level(tmp_path, "t_s,left_z_mps2", 9.80665)


def test_a_wild_sample_turns_no_sign(tmp_path: Path) -> None:
    rows = [f"{0.001 * k:.3f},{1e5 if k == 7 else -9.8}\n" for k in range(300)]
    notices = read(tmp_path, accel="t_s,left_z_mps2\n" + "".join(rows)).notices
    assert not any("gravity" in notice.text for notice in notices)


def test_metres_labelled_as_g_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"'right_z' reads -9\.\d+ g .*unit"):
        level(tmp_path, "t_s,right_z_g", -9.80665)


def test_missing_gravity_is_told(tmp_path: Path) -> None:
    texts = [notice.text for notice in level(tmp_path, "t_s,left_z_mps2", 0.0).notices]
    assert any("'left_z' reads +0.00 g" in text and "gravity was taken out" in text for text in texts)
    assert not any("gravity was" in notice.text for notice in level(tmp_path, "t_s,left_z_g", -1.0).notices)


def test_a_header_in_quotes_is_read(tmp_path: Path) -> None:
    assert [entry.station for entry in level(tmp_path, '"t_s","left_z_mps2"', -9.8).streams] == [Station.LEFT]


@pytest.mark.parametrize("name", ["left_z_m_s2", "Left_Z_mps2", "left_z_m/s²"])
def test_a_column_that_is_nearly_right_is_named_with_the_units(tmp_path: Path, name: str) -> None:
    with pytest.raises(TableError, match=f"column '{name}'.*mps2, g, mg"):
        read(tmp_path, accel=f"t_s,{name}\n0,-9.8\n0.001,-9.8\n")


def test_other_separators_are_pointed_to_the_mapping_file(tmp_path: Path) -> None:
    with pytest.raises(TableError, match="mapping"):
        read(tmp_path, accel="t_s;left_z_mps2\n0;-9,8\n")


def test_unrecognised_columns_are_listed(tmp_path: Path) -> None:
    with pytest.raises(TableError, match="the columns are z_left_mps2"):
        read(tmp_path, accel="t_s,z_left_mps2\n0,-9.8\n0.001,-9.8\n")
