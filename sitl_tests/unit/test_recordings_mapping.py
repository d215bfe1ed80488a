"""Tables in another layout: mapping files, text and MATLAB readers, errors that name file, line, column and unit."""

from __future__ import annotations

import argparse
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.io import savemat

from companion.adapters.recordings.recording_factory import open_recording
from companion.adapters.recordings.tables.mapped_recording import MappedRecording
from companion.adapters.recordings.tables.mapped_table import MappedTable, files_of, read_mapped
from companion.adapters.recordings.tables.mapping import load_mapping, parse_mapping, shipped_mappings
from companion.adapters.recordings.tables.matlab_file import read_matlab
from companion.adapters.recordings.tables.units import conversion
from companion.errors import ConfigError, RecordingError, TableError
from companion.evaluation import measured_structures
from companion.evaluation.findings_output import write_findings
from companion.params.files import load_airframe
from companion.records import Axis, Station
from sitl_tests.unit.text_table_mapping import text_table_mapping

VOLTS = text_table_mapping("strain_v V")


def table(tmp_path: Path, text: str, name: str = "one.txt") -> Path:
    path = tmp_path / name
    path.write_text(text)
    return path


def test_a_text_table_with_a_foreign_header_is_read_in_si(tmp_path: Path) -> None:
    path = table(tmp_path, "rig 7\nno date\nTime\tOther\tAcc L\n\n0\tx\t1\n2.5\ty\t-0.5\n4\tz\t0\n")
    read = read_mapped(path, parse_mapping(VOLTS, "lab.toml"))
    np.testing.assert_allclose(read.t_s, [0.0, 0.0025, 0.004])
    np.testing.assert_allclose(read.channels["left_z_mps2"], [-11.80665, -8.80665, -9.80665])
    assert read.notes == ("one.txt: no column 'Gauge' (strain_v)",)


@pytest.mark.parametrize(
    ("rows", "line", "complaint"),
    [
        ("0\tx\t1\n1\tx\thigh\n", 6, "column 'Acc L' (left_z_mps2, unit V): 'high' is not a number"),
        ("0\tx\t1\n1\tx\tnan\n", 6, "column 'Acc L' (left_z_mps2, unit V): 'nan' is not a finite number"),
        ("0\tx\t1\n1\tx\t\n", 6, "column 'Acc L' (left_z_mps2, unit V) is empty"),
        ("0\tx\t1\n1\tx\n", 6, "2 cells, but column 'Acc L' is number 3"),
        ("", 5, "no row of numbers"),
    ],
)
def test_what_is_wrong_in_a_table_is_named_with_line_column_and_unit(
    tmp_path: Path, rows: str, line: int, complaint: str
) -> None:
    path = table(tmp_path, f"rig 7\nno date\nTime\tOther\tAcc L\n\n{rows}")
    with pytest.raises(TableError) as error:
        read_mapped(path, parse_mapping(VOLTS, "lab.toml"))
    assert f"{path}, line {line}: " in str(error.value)
    assert complaint in str(error.value)


COMMAS = VOLTS.replace('delimiter = "tab"', 'delimiter = "tab"\ndecimal = "comma"')


def test_decimal_commas_are_read(tmp_path: Path) -> None:
    path = table(tmp_path, "rig 7\nno date\nTime\tOther\tAcc L\n\n0\tx\t1\n2,5\ty\t-0,5\n4\tz\t0\n")
    read = read_mapped(path, parse_mapping(COMMAS, "lab.toml"))
    np.testing.assert_allclose(read.t_s, [0.0, 0.0025, 0.004])
    np.testing.assert_allclose(read.channels["left_z_mps2"], [-11.80665, -8.80665, -9.80665])
    thousands = table(tmp_path, "rig 7\nno date\nTime\tOther\tAcc L\n\n0\tx\t1\n1.000\ty\t1\n")
    with pytest.raises(TableError, match=r"line 6: column 'Time': '1\.000' has a point, but decimals follow a comma"):
        read_mapped(thousands, parse_mapping(COMMAS, "lab.toml"))
    mistyped = table(tmp_path, "rig 7\nno date\nTime\tOther\tAcc L\n\n0\tx\t1\n1\ty\t2,5V\n")
    with pytest.raises(TableError, match=r"line 6: column 'Acc L' .*: '2,5V' is not a number"):
        read_mapped(mistyped, parse_mapping(COMMAS, "lab.toml"))
    with pytest.raises(ConfigError, match=r"'table\.decimal' is the delimiter, too"):
        parse_mapping(COMMAS.replace('"tab"', '"comma"'), "lab.toml")


def test_a_name_that_is_there_twice_is_refused(tmp_path: Path) -> None:
    """The first of them was taken without a word."""
    path = table(tmp_path, "rig 7\nno date\nTime\tAcc L\tAcc L\n\n0\t1\t2\n1\t1\t2\n")
    with pytest.raises(TableError, match=r"column 'Acc L' is there 2 times; name it by its number in lab\.toml: '#2'"):
        read_mapped(path, parse_mapping(VOLTS, "lab.toml"))


def test_a_kind_of_test_that_nobody_diagnoses_is_refused_with_the_kinds_that_are() -> None:
    mapping = parse_mapping(VOLTS.replace("[table]", "test = 'walk'\n[table]"), "lab.toml")
    with pytest.raises(ConfigError, match=r"^lab\.toml: 'test' must be one of flight, ringing, .*, not 'walk'$"):
        measured_structures.execute(argparse.Namespace(), mapping, lambda _text, _fraction: None)


def test_rows_out_of_order_are_sorted_for_a_bench_test_and_told(tmp_path: Path) -> None:
    path = table(tmp_path, "rig 7\nno date\nTime\tOther\tAcc L\n\n0\tx\t1\n2\tx\t3\n1\tx\t2\n1\tx\t9\n")
    ordered = read_mapped(path, parse_mapping(VOLTS, "lab.toml")).increasing()
    assert np.diff(ordered.t_s).min() > 0.0
    assert np.diff(ordered.channels["left_z_mps2"], n=2) == pytest.approx([0.0], abs=1e-12)  # 1, 2, 3 volts
    assert "stamps of 2 of 4 rows repeat or go back; 3 rows are used" in ordered.notes[-1]


def test_a_missing_column_is_named_with_its_unit_and_with_what_is_there(tmp_path: Path) -> None:
    path = table(tmp_path, "rig 7\nno date\nTime\tAcc R\n\n0\t1\n")
    with pytest.raises(TableError, match=r"line 3: column 'Acc L' \(left_z_mps2, unit V\) of lab.toml is missing") as e:
        read_mapped(path, parse_mapping(VOLTS, "lab.toml"))
    assert "'Time', 'Acc R'" in str(e.value)


def test_columns_go_by_number_where_there_is_no_header_and_time_by_rate(tmp_path: Path) -> None:
    mapping = parse_mapping(
        'rate_hz = 500.0\n[table]\ndelimiter = "space"\nheader_line = 0\n'
        '[columns]\n"#2" = { channel = "right_z_mps2", unit = "g" }\n',
        "bare.toml",
    )
    read = read_mapped(table(tmp_path, " 5   1.0\n 6  -1.0\n 7   0.5\n"), mapping)
    np.testing.assert_allclose(read.t_s, [0.0, 0.002, 0.004])
    np.testing.assert_allclose(read.channels["right_z_mps2"], [9.80665, -9.80665, 4.903325])


def test_a_matlab_file_is_read_by_names_in_the_file(tmp_path: Path) -> None:
    mapping = parse_mapping(
        'test = "vibration"\nrate_hz = 100.0\n[matlab]\narray = "data"\nnames = "channels"\n'
        '[columns]\n"Force" = { channel = "input_n", unit = "lbf" }\n'
        '"Tip" = { channel = "response_tip_mps2", unit = "V", scale = 10.0 }\n'
        '[[recordings]]\nfile = "run2.mat"\nvalues = { sensor_span_m = 0.5 }\n',
        "gvt.toml",
    )
    data = np.array([[9.0, 1.0, 0.1], [9.0, 2.0, -0.2]])
    savemat(tmp_path / "run2.mat", {"data": data, "channels": np.array(["Drive", "Force", "Tip"], dtype=object)})
    read = read_mapped(tmp_path / "run2.mat", mapping)
    np.testing.assert_allclose(read.channels["input_n"], [4.4482216152605, 8.896443230521])
    np.testing.assert_allclose(read.channels["response_tip_mps2"], [1.0, -2.0])
    assert read.constants == {"sensor_span_m": 0.5}
    data[1, 2] = np.inf
    savemat(tmp_path / "run2.mat", {"data": data, "channels": np.array(["Drive", "Force", "Tip"], dtype=object)})
    with pytest.raises(TableError, match=r"run2.mat, line 2: column 'Tip' \(response_tip_mps2, unit V\): inf"):
        read_mapped(tmp_path / "run2.mat", mapping)
    savemat(tmp_path / "run2.mat", {"data": data, "channels": np.array(["Drive", "Force", "Root"], dtype=object)})
    with pytest.raises(RecordingError, match=r"no channel 'Tip' \(response_tip_mps2, unit V\) of gvt.toml; it has"):
        read_mapped(tmp_path / "run2.mat", mapping)
    with pytest.raises(RecordingError, match="not a MATLAB v5 file"):
        read_mapped(table(tmp_path, "no matlab", "x.mat"), mapping)


def test_channels_may_be_rows_and_a_single_number_holds_for_the_whole_recording(tmp_path: Path) -> None:
    mapping = load_mapping("flutter-rig")
    data = np.arange(18.0).reshape(3, 6)
    savemat(tmp_path / "V163.mat", {"data": data, "time": np.arange(6.0)[None], "Speed": 16.3})
    read = read_mapped(tmp_path / "V163.mat", mapping)
    np.testing.assert_allclose(read.channels["response_heave"], data[1])
    np.testing.assert_allclose(read.channels["response_pitch_rad"], data[0])
    np.testing.assert_allclose(read.channels["airspeed_mps"], 16.3)
    savemat(tmp_path / "still.mat", {"data": data, "time": np.arange(6.0)[None]})
    assert "airspeed_mps" not in read_mapped(tmp_path / "still.mat", mapping).channels


def test_named_channels_may_be_rows_and_as_many_names_as_no_side_has_are_refused(tmp_path: Path) -> None:
    mapping = parse_mapping(
        'test = "limit-cycle"\nband_hz = [1.0, 2.0]\n[matlab]\narray = "data"\nnames = "channels"\n'
        '[columns]\n"time" = { channel = "t_s" }\n"L" = { channel = "response_left" }\n',
        "rows.toml",
    )
    data = np.random.default_rng(0).normal(size=(3, 30))
    savemat(tmp_path / "a.mat", {"data": data, "channels": np.array(["time", "L", "R"], dtype=object)})
    read = read_mapped(tmp_path / "a.mat", mapping)
    np.testing.assert_array_equal(read.t_s, data[0])
    np.testing.assert_array_equal(read.channels["response_left"], data[1])
    savemat(tmp_path / "a.mat", {"data": data, "channels": np.array(["time", "L"], dtype=object)})
    with pytest.raises(RecordingError, match=r"a.mat: 'channels' has 2 names, 'data' is 3 by 30: give one name"):
        read_mapped(tmp_path / "a.mat", mapping)


def test_an_object_of_matlab_s_own_is_left_out(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {"x": np.arange(3.0)})
    # array flags of class 17 (opaque), then a name, and no dimensions
    opaque = struct.pack("<IIIII", 6, 8, 17, 0, 1 | 4 << 16) + b"None"
    path = tmp_path / "b.mat"
    path.write_bytes((tmp_path / "a.mat").read_bytes() + struct.pack("<II", 14, len(opaque)) + opaque)
    assert list(read_matlab(path)) == ["x"]


def test_a_response_that_not_all_files_have_is_left_out_of_a_limit_cycle_and_told() -> None:
    values = np.sin(np.arange(10.0))
    with_both = MappedTable(Path("a.csv"), values, {"response_heave": values, "response_pitch": values}, {})
    without = MappedTable(Path("b.csv"), values, {"response_heave": values}, {})
    names, notes = measured_structures._responses_of_all([with_both, without])
    assert names == ["response_heave"]
    assert notes == ["response_pitch is left out: b.csv has none"]
    with pytest.raises(RecordingError, match="in every file"):
        measured_structures._responses_of_all([MappedTable(Path("c.csv"), values, {}, {}), without])


def test_files_of_a_folder_come_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    for k in (10, 9, 1):
        table(tmp_path, "", f"run{k}.txt")
    table(tmp_path, "", "notes.md")
    mapping = parse_mapping(f'files = "run*.txt"\n{VOLTS}', "lab.toml")
    assert [path.name for path in files_of(tmp_path, mapping)] == ["run1.txt", "run9.txt", "run10.txt"]
    with pytest.raises(RecordingError, match="no such file or folder"):
        files_of(tmp_path / "nowhere", mapping)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (('unit = "ms"', 'unit = "V"'), "'columns.Time.scale' is missing: nothing is known that makes 's' of unit 'V'"),
        (("scale = -2.0, ", ""), "'columns.Acc L.scale' is missing"),
        (("scale = -2.0", "scale = 0"), "'columns.Acc L.scale' must not be 0"),
        (("scale = -2.0", "gain = -2.0"), "'columns.Acc L.scale' is missing"),
        (('"strain_v", unit = "V"', '"left_z_mps2", unit = "g"'), "is the second column of channel 'left_z_mps2'"),
        (('"tab"', '"pipe"'), "'table.delimiter' must be one of comma, semicolon, tab, space, not 'pipe'"),
        (("first_line = 5", "first_line = 2"), "'table.first_line' must come after the header line"),
        (('channel = "t_s"', 'channel = "clock_s"'), "give either a column with channel = 't_s' or rate_hz"),
        (("[table]", "surprise = 1\n[table]"), "'surprise' is no key of a mapping file"),
        (("[table]", "band_hz = [5, 2]\n[table]"), "'band_hz' must be two frequencies"),
    ],
)
def test_what_is_wrong_in_a_mapping_is_named_with_file_and_key(change: tuple[str, str], complaint: str) -> None:
    text = VOLTS.replace(*change)
    assert text != VOLTS
    with pytest.raises(ConfigError) as error:
        parse_mapping(text, "lab.toml")
    assert str(error.value).startswith("lab.toml: ")
    assert complaint in str(error.value)


def test_an_unknown_mapping_lists_the_known_ones() -> None:
    with pytest.raises(ConfigError, match="no mapping 'nowhere'; known: dropbear8"):
        load_mapping("nowhere")


@pytest.mark.parametrize("name", shipped_mappings())
def test_the_mappings_that_travel_with_spanwise_are_whole(name: str) -> None:
    mapping = load_mapping(name)
    assert mapping.description
    assert mapping.columns
    if mapping.test == "ringing":
        assert mapping.band_hz is not None


def test_the_laboratory_table_becomes_a_recording_with_ranges_where_there_are_any(tmp_path: Path) -> None:
    path = table(
        tmp_path,
        "time_ms,right_g,left_g,airspeed_kt,range_m,reference_m\n0,-1,-1.5,10,,\n1,-1,-1,10,52.8,60\n2,-1,-1,11,,\n",
        "wing.csv",
    )
    recording = MappedRecording(path, load_mapping("two-accelerometers"), load_airframe("nadir-2m"))
    assert [(stream.station, stream.axes) for stream in recording.streams] == [
        (Station.LEFT, Axis.Z),
        (Station.RIGHT, Axis.Z),
    ]
    assert recording.streams[0].values[0, 2] == pytest.approx(-1.5 * 9.80665)
    assert recording.covariates["airspeed_mps"].values[2] == pytest.approx(11 * 1852 / 3600)
    assert recording.ranges is not None
    assert recording.ranges.t_s.tolist() == [0.001]
    assert recording.ranges.range_m.tolist() == [52.8]
    assert recording.ranges.reference_m is not None
    assert recording.ranges.reference_m.tolist() == [60.0]
    assert recording.airframe.left.rate_hz == pytest.approx(1000.0)
    assert sum(batch.t_ns.size for batch in recording.records()) == 6


@given(st.sampled_from([("g", "mps2"), ("mg", "g"), ("in", "m"), ("ms", "s"), ("deg", "rad"), ("lbf", "n")]))
def test_conversions_undo_each_other(units: tuple[str, str]) -> None:
    forward, back = conversion(*units), conversion(units[1], units[0])
    assert forward is not None
    assert back is not None
    assert forward * back == pytest.approx(1.0)
    assert conversion(units[0], "k") is None


def test_folders_below_that_hold_the_files_are_named(tmp_path: Path) -> None:
    mapping = load_mapping("dropbear8")
    for name in ("slow1", "slow2", "papers"):
        (tmp_path / name).mkdir()
        (tmp_path / name / ("test0.txt" if name != "papers" else "read.me")).touch()
    with pytest.raises(RecordingError, match=r"no file 'test\*\.txt'") as error:
        files_of(tmp_path, mapping)
    assert str(error.value).endswith(f"; give folders that have them: {tmp_path / 'slow1'} {tmp_path / 'slow2'}")


def test_a_table_in_another_layout_is_told_from_no_recording(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"spanwise diagnose --mapping$"):
        open_recording(table(tmp_path, "Time\tAcc\n0\t1\n", "test0.txt"))


def test_what_a_diagnosis_wrote_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page, findings = str(tmp_path / "a.html"), str(tmp_path / "a.json")
    said = {findings: f"wrote {findings} and {page}\n", None: f"wrote {page}\n", "-": "{}\n"}
    for json_target, printed in said.items():
        write_findings({}, json_target, page, lambda _: None, lambda: "")
        assert capsys.readouterr().out == printed


def test_values_that_reach_no_file_are_told() -> None:
    entry = '[[recordings]]\nfile = "R2.csv"\nvalues = { temperature_degc = 20.0 }\n'
    mapping = parse_mapping(VOLTS + entry, "lab.toml")
    values = np.zeros(3)
    tables = [
        MappedTable(Path("r1.csv"), values, {}, {"temperature_degc": 20.0}),
        MappedTable(Path("r2.csv"), values, {}, {}),
    ]
    assert measured_structures._unmatched(tables, mapping) == [
        "[[recordings]] names R2.csv, which is no file beside the others",
        "temperature_degc cannot be a cause: r2.csv has no value of it",
    ]


def test_an_airspeed_that_changes_within_a_file_is_noted_and_a_negative_refused() -> None:
    def table_of(first: float, last: float) -> MappedTable:
        speed = np.linspace(first, last, 50)
        return MappedTable(Path("r1.csv"), np.arange(50.0), {"airspeed_mps": speed}, {})

    notes: list[str] = []
    assert measured_structures._airspeed(table_of(13.0, 13.2), notes) == pytest.approx(13.1)
    assert measured_structures._airspeed(table_of(-0.2, -0.1), notes) == 0.0
    assert not notes
    measured_structures._airspeed(table_of(10.0, 16.7), notes)
    assert "the airspeed goes from 10.1 to 16.6 m/s, and counts as 13.3 m/s" in notes[0]
    with pytest.raises(RecordingError, match=r"an airspeed of -12\.0 m/s is negative"):
        measured_structures._airspeed(table_of(-12.0, -12.0), notes)


@pytest.mark.parametrize(
    ("printed", "written"),
    [("m/s^2", "mps2"), ("m/s²", "mps2"), ("ft/s^2", "ftps2"), ("km/h", "kmh"), ("rad/s", "radps"), ("°/s", "degps"),
     ("µs", "us"), (" N ", "n")],
)  # fmt: skip
def test_a_unit_may_be_written_as_in_print(printed: str, written: str) -> None:
    assert conversion(printed, written) == 1.0


NAMED = """
[columns]
"t" = { channel = "t_s", unit = "s" }
"force" = { channel = "input_n", unit = "n" }
"""


@pytest.mark.parametrize(
    ("text", "delimiter", "complaint"),
    [
        ("t,force,temp\n1,0.00,5,20\n2,0.01,6,20\n", "comma", "line 2: 4 cells, but the header in line 1 has 3 names"),
        ("t (s) force (N)\n0.00 5\n0.01 6\n", "space", "line 2: 2 cells, but the header in line 1 has 4 names"),
    ],
)
def test_names_that_are_not_above_their_columns_are_refused(
    tmp_path: Path, text: str, delimiter: str, complaint: str
) -> None:
    """The row number of a table that R wrote was taken for the time, and the time for the force."""
    mapping = parse_mapping(f'[table]\ndelimiter = "{delimiter}"\n{NAMED}', "lab.toml")
    with pytest.raises(TableError) as error:
        read_mapped(table(tmp_path, text), mapping)
    assert complaint in str(error.value)


def test_a_delimiter_between_quotes_ends_no_cell(tmp_path: Path) -> None:
    """The column after the one that was named was read."""
    text = 't,"note, by hand",force,load\n0.00,"so, so",5,7\n0.01,,6,8,\n'
    read = read_mapped(table(tmp_path, text), parse_mapping(NAMED, "lab.toml"))
    np.testing.assert_array_equal(read.t_s, [0.0, 0.01])
    np.testing.assert_array_equal(read.channels["input_n"], [5.0, 6.0])


def test_an_airspeed_that_the_mapping_states_for_a_file_counts() -> None:
    """Cycles at stated airspeeds were judged as in still air."""
    stated = MappedTable(Path("r1.csv"), np.arange(50.0), {}, {"airspeed_mps": 18.0})
    assert measured_structures._airspeed(stated, []) == 18.0
