"""A sheet printed before a sweep, and entered afterwards as a run with the times that stand on it."""

import html.parser

import pytest

from configs import FOLDER
from rig.bench.bench import read_bench
from rig.by_hand.sheet import print_page, print_sheet, sheet_columns
from rig.by_hand.sheet_entry import SheetError, enter_sheet, read_sheet
from rig.clock import Clock
from rig.exchange.export import recording_of
from rig.replay.player import Player
from rig.runlog import RunWriter, read_run, start_record
from rig.sweep.ambient import Given, at_start
from tests.person import dial_in_kpa

HEADER = "time,level_bar_abs,direction,pressure_bar_abs,flow_l_min,speed_rpm,pressure_bar_abs_after,note\n"
FILLED = (
    HEADER
    + """14:00,zero,,1.01,<10,0,,
14:05,1.6,up,1.60,44,232.3,1.62,the float sticks
14:08:30,1.7,up,1.70,51,272.9,,
,1.8,up,,,,,
14:20,2,up,2.00,>100,394.8,2.00,
14:30,zero,,1.01,<10,0,,
"""
)


@pytest.fixture
def bench():
    return read_bench("manual")


@pytest.fixture
def entered(tmp_path, bench):
    ambient = at_start(bench, Given(1.01325, 20.0, 0.5, "none", 0.0))
    writer = RunWriter.create(tmp_path, start_record(bench, "manual", Clock(), {}), sync_s=60.0)
    outcome = enter_sheet(bench, read_sheet(FILLED, bench), writer, ambient)
    writer.end(outcome.outcome, vented=outcome.vented)
    return read_run(writer.folder)


def test_the_sheet_has_a_line_for_each_level_in_the_sweep_s_order_between_two_zeros(bench):
    lines = print_sheet(bench).splitlines()
    assert lines[0] + "\n" == HEADER
    assert [line.split(",")[1] for line in lines[1:]] == [
        "zero",
        *(rising := ["1.6", "1.7", "1.8", "1.83", "1.85", "1.95", "2"]),
        *reversed(rising),
        "zero",
    ]
    assert [line.split(",")[2] for line in lines[2:-1]] == ["up"] * 7 + ["down"] * 7


def test_the_printed_page_is_well_formed_and_has_the_levels_in_gauge_too(bench):
    opened = []

    class Checker(html.parser.HTMLParser):
        def handle_starttag(self, tag, attributes):
            if tag != "meta":
                opened.append(tag)

        def handle_endtag(self, tag):
            assert opened.pop() == tag

    page = print_page(bench)
    Checker().feed(page)
    assert opened == []
    assert "1.60 <small>(0.59 gauge)</small>" in page
    assert page.count("<tr>") == 1 + 2 + 14
    assert "th.note { width: 40% }" in page
    assert page.count('<th class="note">note</th>') == 1
    assert "size: A4" in page


def test_text_of_the_bench_file_is_escaped_on_the_page(bench):
    file = bench.file.model_copy(update={"title": "<script>alert(1)</script>"})
    object.__setattr__(bench, "file", file)
    assert "<script>" not in print_page(bench)


def test_an_empty_sheet_has_nothing_to_enter(bench):
    with pytest.raises(SheetError, match="no row has readings"):
        read_sheet(print_sheet(bench), bench)


def test_a_filled_sheet_becomes_plateaus_with_its_times(entered):
    assert [(p.level_bar_abs, p.start_s) for p in entered.plateaus] == [(1.6, 300.0), (1.7, 510.0), (2.0, 1200.0)]
    assert entered.plateaus[0].means["speed_rpm"].mean == 232.3
    assert entered.plateaus[0].note == "the float sticks"


def test_the_drift_on_a_sheet_is_an_error_of_the_pressure(entered):
    pressure = entered.plateaus[0].means["pressure_bar_abs"]
    assert pressure.mean == pytest.approx(1.61)
    assert pressure.se == pytest.approx(0.02 / 12**0.5)


def test_a_value_off_the_scale_stays_a_limit(entered):
    assert entered.plateaus[-1].means["flow_l_min"].censored == 1


def test_the_zeros_of_a_sheet_are_events(entered):
    zeros = [event for event in entered.events if event.event == "zero"]
    assert [(event.details["which"], event.time_s) for event in zeros] == [("start", 0.0), ("end", 1800.0)]


def test_an_entered_sheet_replays_like_a_run_that_was_typed(entered, bench):
    player = Player(bench, False, {"pressure_bar_abs": 1.01325, "temperature_c": 20.0})
    for _, exchange in entered.exchanges():
        assert player.play(exchange).readings == exchange.readings
    assert player.differences == []
    assert len(entered.samples) == 3 * 7


def test_what_was_not_read_again_is_no_unusable_reading(entered):
    assert [note for note in recording_of(entered).notes if "unusable" in note] == []


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("14:05,1.6,up,1.60,44,232.3,", "row 1: 7 cells, expected 8"),
        ("14:65,1.6,up,1.60,44,232.3,,", "row 1: time: '14:65' is no time of the day"),
        ("soon,1.6,up,1.60,44,232.3,,", "row 1: time: 'soon'"),
        (",1.6,up,1.60,44,232.3,,", "row 1: time: ''"),
        ("14:05,high,up,1.60,44,232.3,,", "row 1: level_bar_abs: 'high'"),
        ("14:05,1.6,sideways,1.60,44,232.3,,", "row 1: direction: 'sideways'"),
        ("14:05,1.6,up,1.60,44 L,232.3,,", "row 1: "),
        ("14:05,1.6,up,1.60,144,232.3,,", "row 1: flow_l_min: 144 L/min is above the scale"),
    ],
)
def test_a_wrong_cell_is_named_with_its_row(bench, line, says):
    with pytest.raises(SheetError) as caught:
        read_sheet(f"{HEADER}{line}\n", bench)
    assert str(caught.value).startswith(says)


def test_all_mistakes_are_told_at_once(bench):
    with pytest.raises(SheetError) as caught:
        read_sheet(f"{HEADER}soon,1.6,up,1.6,44,232,,\n14:05,high,sideways,44 L,144,23O,99,\n", bench)
    first, second = str(caught.value).splitlines()
    assert first == "row 1: time: 'soon': expected 14:05, 14:05:30 or seconds"
    places = [words.partition(":")[0] for words in second.removeprefix("row 2: ").split("; ")]
    wrong = ["level_bar_abs", "direction", "pressure_bar_abs", "flow_l_min", "speed_rpm", "pressure_bar_abs_after"]
    assert [place for place in places if place in wrong] == wrong


def test_times_that_go_back_are_refused_and_midnight_is_none_of_them(bench):
    late = f"{HEADER}23:58,1.6,up,1.6,44,232,,\n00:03,1.7,up,1.7,51,272,,\n"
    assert [row.time_s for row in read_sheet(late, bench)] == [0.0, 300.0]
    with pytest.raises(SheetError, match="before the row above"):
        read_sheet(f"{HEADER}14:05,1.6,up,1.6,44,232,,\n14:01,1.7,up,1.7,51,272,,\n", bench)


def test_another_bench_s_sheet_is_refused_by_its_header(bench):
    with pytest.raises(SheetError, match="expected time,level_bar_abs"):
        read_sheet("time,level,pressure\n", bench)


def test_the_columns_are_those_of_the_instrument_s_file(bench):
    assert ",".join(sheet_columns(bench).values()) + "\n" == HEADER


def test_a_sheet_is_headed_with_the_units_of_the_faces_and_read_in_them(tmp_path):
    bench = dial_in_kpa(tmp_path)
    head = print_sheet(bench).partition("\n")[0]
    assert "pressure_bar_gauge [kPa gauge],flow_l_min,speed_rpm,pressure_bar_gauge_after [kPa gauge]" in head
    page = print_page(bench)
    assert "pressure after [kPa gauge]" in page and "dial: 58.6" in page
    (row,) = read_sheet(f"{head}\n14:05,1.6,up,58.7,44,232.3,58.9,\n", bench)
    assert (row.entry, row.after) == ("58.7 44 232.3", "58.9 - -")


ROOM = ["--ambient-pressure-bar-abs", "1.009", "--ambient-temperature-c", "21", "--relative-humidity", "0.5"]
ROOM += ["--lubrication", "none", "--minutes-running", "10"]
PLATEAUS = [
    "14:05,1.6,up,1.60,44,232.3,1.62,",
    "14:09,1.7,up,1.70,51,272.9,1.70,",
    "14:13,1.8,up,1.80,59,314.3,1.80,",
]


@pytest.fixture
def enter(spinbench_here, tmp_path):
    def enter(*lines, options=()):
        (tmp_path / "sheet.csv").write_text(HEADER + "\n".join(lines) + "\n")
        return spinbench_here("sheet", "manual", "--enter", "sheet.csv", *ROOM, *options, cwd=tmp_path)

    return enter


def test_a_sheet_is_held_to_what_the_prompt_is_held_to_and_all_is_told_at_once(enter, tmp_path):
    told = enter(
        PLATEAUS[0],
        PLATEAUS[1].replace("272.9", "3143"),
        "soon,1.75,up,1.75,51,280,,",
        PLATEAUS[2].replace(",1.80,59", ",0.80,59"),
        "14:17,1.83,up,1.83,60,32.8,,",
        "14:21,1.85,up,1.85,60,340,1.05,",
        "14:30,zero,,1.01,<10,20,,",
    )
    assert told.returncode == 2
    lines = told.stderr.splitlines()
    assert [line.partition("row ")[2].partition(":")[0] for line in lines] == ["2", "3", "4", "5", "6", "7"]
    assert "speed_rpm: a speed of 3143 rpm is beyond the bench's limit of 600 rpm" in lines[0]
    assert "pressure_bar_abs: 0.8 bar is not above the room's 1.009 bar, yet the rotor turns" in lines[2]
    assert "speed_rpm: a speed of 32.8 rpm is far from what was expected" in lines[3]
    assert "--as-read" in lines[3]
    assert "pressure_bar_abs_after: that is 1.050 bar abs, where 1.85 was expected" in lines[4]
    assert "speed_rpm: a speed of 20 rpm is far from what was expected, 0 to 0 rpm" in lines[5]
    assert not (tmp_path / "logs").exists()


def test_the_improbable_is_entered_with_a_note_where_it_was_read_so_and_the_impossible_is_not(enter, tmp_path):
    told = enter(*PLATEAUS[:2], PLATEAUS[2].replace("314.3", "31.4"), options=["--as-read"])
    assert told.returncode == 0, told.stderr
    run = read_run(tmp_path / told.stdout.strip())
    assert run.plateaus[2].note.startswith("read so: a speed of 31.4 rpm is far from what was expected")
    assert [event.event for event in run.events].count("doubted") == 1
    starved = enter(*PLATEAUS[:2], PLATEAUS[2].replace("1.80,59", "0.80,59"), options=["--as-read"])
    assert starved.returncode == 2
    assert "not above the room's" in starved.stderr


def test_the_paper_asks_for_the_room_in_the_command_s_units_and_a_figure_in_another_unit_is_told_so(
    bench, spinbench_here, tmp_path
):
    page = print_page(bench)
    assert "[bar abs, as 1.013]" in page
    assert "[0 to 1, as 0.50]" in page
    (tmp_path / "sheet.csv").write_text(HEADER + PLATEAUS[0] + "\n")
    wrong = [{"1.009": "1009", "21": "294.15", "0.5": "50"}.get(word, word) for word in ROOM]
    told = spinbench_here("sheet", "manual", "--enter", "sheet.csv", *wrong, cwd=tmp_path)
    assert told.returncode == 2
    for hint in ("1009 mbar is 1.009 bar", "294.15 K is 21 degC", "50 % is 0.5"):
        assert hint in told.stderr


def test_a_sheet_with_semicolons_and_decimal_commas_is_read_and_one_with_both_decimals_is_not(bench):
    german = FILLED.replace(",", ";").replace(".", ",").replace("the float sticks", "the float, 2.5 mm off")
    english = FILLED.replace("the float sticks", '"the float, 2.5 mm off"')
    assert read_sheet(german, bench) == read_sheet(english, bench)
    with pytest.raises(SheetError, match="after a comma and after a point"):
        read_sheet(german.replace("272,9", "272.9"), bench)
    with pytest.raises(SheetError, match="header: expected time;level_bar_abs"):
        read_sheet("time;level;pressure\n", bench)


def test_a_pressure_within_the_gauge_s_bias_of_the_room_is_entered_where_it_was_read_so(enter):
    low = "14:17,1.05,down,0.99,<10,12.0,,"
    assert "--as-read" in enter(*PLATEAUS, low).stderr
    assert enter(*PLATEAUS, low, options=["--as-read"]).returncode == 0


def test_a_zero_is_its_row_alone_where_plateaus_are_written_in_the_same_minute(enter, tmp_path):
    zero = PLATEAUS[0][:6] + "zero,,1.01,<10,0,,"
    last = PLATEAUS[2][:6] + "zero,,1.02,<10,0,,"
    told = enter(zero, *PLATEAUS, last)
    assert told.returncode == 0, told.stderr
    files = {file.kind: file for file in recording_of(read_run(tmp_path / told.stdout.strip())).recording.files}
    zeros = files["zero"].columns
    assert zeros["pressure_bar_abs"].values.tolist() == [1.01, 1.02]
    assert zeros["speed_rpm"].values.tolist() == [0.0, 0.0]
    assert files["steady"].columns["time_s"].values == pytest.approx([0.0, 240.0, 480.0], abs=0.01)


def beside(folder, typed, read):
    """The manual bench in a folder of its own, one of whose quantities an instrument on a cable reads."""
    instrument, channel = read
    text = (FOLDER / "instruments" / "manual_bench.toml").read_text()
    head, *channels = text.split("[channels.")
    columns = [name for name in ("pressure_bar_abs", "flow_l_min", "speed_rpm") if name != typed]
    head = head.replace('"pressure_bar_abs", "flow_l_min", "speed_rpm"', ", ".join(f'"{name}"' for name in columns))
    kept = [f"[channels.{table}" for table in channels if not table.startswith(typed)]
    (folder / "two_dials.toml").write_text(head + "".join(kept))
    text = (FOLDER / "benches" / "manual.toml").read_text().replace('"manual_bench"', '"two_dials.toml"')
    text = text.replace(f"person.{typed}", f"cable.{channel}").replace(
        "[roles]",
        f'[lines.bus]\nkind = "serial"\nport = "/dev/ttyUSB0"\n[devices.cable]\ninstrument = "{instrument}"\n'
        f'line = "bus"\nunit_id = 1\n[roles]',
    )
    (folder / "bench.toml").write_text(text)


@pytest.mark.parametrize("options", [["-o", "out.csv"], ["-o", "out.html"], ["--enter", "sheet.csv"]])
def test_there_is_no_sheet_of_a_bench_whose_gauge_nobody_reads(spinbench_here, tmp_path, options):
    beside(tmp_path, "pressure_bar_abs", ("keller_30x_abs", "pressure_bar_abs"))
    (tmp_path / "sheet.csv").write_text(
        "time,level_bar_abs,direction,flow_l_min,speed_rpm,pressure_bar_abs_after,note\n"
    )
    told = spinbench_here("sheet", "bench.toml", *options, *ROOM, cwd=tmp_path)
    assert told.returncode == 2
    assert "roles.pressure is 'cable.pressure_bar_abs', which nobody reads" in told.stderr
    assert not list(tmp_path.glob("out.*"))


def test_a_sheet_of_a_bench_whose_tachometer_reads_itself_has_no_speed(spinbench_here, tmp_path):
    beside(tmp_path, "speed_rpm", ("monarch_act3x", "speed_rpm"))
    (tmp_path / "sheet.csv").write_text(f"{HEADER.replace('speed_rpm,', '')}14:05,1.6,up,1.60,44,1.62,\n")
    told = spinbench_here("sheet", "bench.toml", "--enter", "sheet.csv", *ROOM, cwd=tmp_path)
    assert told.returncode == 0, told.stderr
    (plateau,) = read_run(tmp_path / told.stdout.strip()).plateaus
    assert sorted(plateau.means) == ["flow_l_min", "pressure_bar_abs"]


def test_hours_and_minutes_with_a_point_between_are_no_seconds(bench):
    points = f"{HEADER}14.05,1.6,up,1.6,44,232,,\n14.09,1.7,up,1.7,51,272,,\n"
    with pytest.raises(SheetError, match=r"^time: '14\.05' may be .* write 14:05, or whole seconds"):
        read_sheet(points, bench)
    with pytest.raises(SheetError, match="write 14:05, or whole seconds"):
        read_sheet(points.replace(",", ";").replace(".", ","), bench)
    assert [row.time_s for row in read_sheet(points.replace("14.05", "14"), bench)] == pytest.approx([0.0, 0.09])


def test_the_page_has_gauge_values_for_the_room_that_is_given_and_says_which_it_took(bench, spinbench_here, tmp_path):
    low = ["--ambient-pressure-bar-abs", "0.90"]
    told = spinbench_here("sheet", "manual", "-o", "low.html", *low, cwd=tmp_path)
    assert told.returncode == 0, told.stderr
    page = (tmp_path / "low.html").read_text()
    assert "1.60 <small>(0.70 gauge)</small>" in page
    assert "with 0.9 bar abs in the room" in page
    assert "with 1.01325 bar abs in the room" in print_page(bench)
    wrong = spinbench_here("sheet", "manual", "-o", "high.html", low[0], "900", cwd=tmp_path)
    assert wrong.returncode == 2
    assert "900 mbar is 0.9 bar" in wrong.stderr
