"""Overlapping clocks: what one instrument cannot have read at the same time is refused, all that it can is read."""

from pathlib import Path

import pytest

from calibration.data.joined import as_given
from rig.recording import read_recording, write_recording

ROOT = Path(__file__).resolve().parents[2]
SHARED = ROOT.parent / "shared"
STEADY = "time_s,pressure_bar_abs,flow_l_min,speed_rpm\n"


def steady(*times, name="sweep.csv", start_s=None, kind="steady", lowest_rpm=60):
    """A file of plateaus, or zero rows, at these times."""
    rows = "".join(f"{time},1.{i + 2},{8 * i + 9},{50 * i + lowest_rpm}\n" for i, time in enumerate(times))
    return name, kind, start_s, STEADY + rows


def run(name, first, last, start_s=None, column="speed_rpm"):
    """A run in time of five samples."""
    times = [first + (last - first) * i / 4 for i in range(5)]
    rows = "".join(f"{time!r},2.0,{100 * i + 10}\n" for i, time in enumerate(times))
    return name, "transient", start_s, f"time_s,pressure_bar_abs,{column}\n{rows}"


def put(folder, *files, more=""):
    """Write a recording of these files."""
    folder.mkdir(parents=True)
    text = 'format = "recording/1"\nmotor = "ptm3600"\n' + more
    for name, kind, start_s, csv in files:
        text += f'[[files]]\nfile = "{name}"\nkind = "{kind}"\n' + ("" if start_s is None else f"start_s = {start_s}\n")
        (folder / name).write_text(csv)
    (folder / "recording.toml").write_text(text)
    return folder


OVERLAPPING = {
    "two_runs": (
        [run("up.csv", 0.0, 8.0, 100.0), run("down.csv", 0.0, 8.0, 105.5)],
        "'up.csv' and 'down.csv' overlap by 2.5 s, from 105.5 to 108 s",
    ),
    "one_run_within_another": (
        [run("up.csv", 0.0, 80.0, 100.0), run("down.csv", 3.0, 4.0, 110.0)],
        "'up.csv' and 'down.csv' overlap by 1 s, from 113 to 114 s",
    ),
    "times_on_the_recordings_clock": (
        [run("up.csv", 1100.0, 1130.0), run("down.csv", 1120.0, 1150.0)],
        "'up.csv' and 'down.csv' overlap by 10 s, from 1120 to 1130 s",
    ),
    "a_start_beside_none": (
        [run("up.csv", 0.0, 8.0), run("down.csv", 0.0, 8.0, 6.0)],
        "'up.csv' and 'down.csv' overlap by 2 s, from 6 to 8 s",
    ),
    "plateaus_within_a_run": (
        [steady(0, 40, 80, 120, 160), run("down.csv", 0.0, 90.0, 70.0)],
        "'sweep.csv' and 'down.csv' overlap by 40 s, from 80 to 120 s",
    ),
    "one_plateau_within_a_run": (
        [run("down.csv", 0.0, 8.0, 77.0), steady(0, 40, 80)],
        "'down.csv' and 'sweep.csv' overlap by 0 s, from 80 to 80 s",
    ),
}


@pytest.mark.parametrize(("files", "words"), OVERLAPPING.values(), ids=list(OVERLAPPING))
def test_what_one_instrument_cannot_have_read_at_once_is_told_in_a_line(tmp_path, spinbench_here, files, words):
    folder = put(tmp_path / "bench", *files)
    for command in ("fit", "diagnose"):
        result = spinbench_here(command, folder, "-o", tmp_path / "out", cwd=tmp_path)
        assert result.returncode == 2
        (line,) = result.stderr.splitlines()
        assert line.startswith(f"spinbench: {folder / 'recording.toml'}: {words} on the recording's clock")
        assert "one instrument (pressure_bar_abs) cannot have read both" in line
        assert not (tmp_path / "out").exists()


LEGAL = {
    "captures_between_plateaus": [
        steady(0, 40, 80, 120),
        run("up.csv", 0.0, 20.0, 50.0),
        run("d.csv", 0.0, 20.0, 90.0),
    ],
    "one_after_the_other": [run("up.csv", 0.0, 8.0, 100.0), run("down.csv", 0.0, 8.0, 108.0)],
    "each_from_its_own_zero": [steady(0, 40, 80), run("up.csv", 0.0, 60.0), run("down.csv", 0.02, 60.0)],
    "plateaus_without_times": [
        ("sweep.csv", "steady", None, "pressure_bar_abs,speed_rpm\n1.2,60\n1.3,90\n"),
        run("down.csv", 0.0, 60.0, 5.0),
    ],
    "zeros_anywhere": [
        steady(0, 40, 80),
        steady(1, 41, name="zero.csv", kind="zero"),
        run("down.csv", 0.0, 20.0, 50.0),
        steady(55, name="again.csv", kind="zero"),
    ],
    "two_sweeps_in_turn": [steady(0, 40, 80, name="a.csv"), steady(0, 40, name="b.csv", start_s=20.0)],
}


@pytest.mark.parametrize("files", LEGAL.values(), ids=list(LEGAL))
def test_what_can_have_been_read_is_read_and_written_again(tmp_path, files):
    found = read_recording(put(tmp_path / "bench", *files))
    write_recording(found, tmp_path / "copy")
    assert len(read_recording(tmp_path / "copy").files) == len(files)


def test_runs_of_different_instruments_may_overlap(tmp_path):
    """A motor that turns without a supply: one logger has its speed, another its angle."""
    files = [
        ("speed.csv", "transient", 5.0, "time_s,speed_rpm\n0,300\n1,250\n2,200\n"),
        ("angle.csv", "transient", 6.0, "time_s,angle_rad\n0,0\n1,27\n2,50\n"),
    ]
    folder = put(tmp_path / "rotor", *files)
    toml = folder / "recording.toml"
    toml.write_text(toml.read_text().replace('"ptm3600"', '{ kind = "free_rotor", inertia_kg_m2 = 0.01 }'))
    assert len(read_recording(folder).files) == 2


def test_a_diagnosis_of_an_angle_alone_says_what_it_needs(tmp_path, spinbench_here):
    folder = put(tmp_path / "rotor", ("angle.csv", "transient", 0.0, "time_s,angle_rad\n0,0\n1,27\n2,50\n"))
    toml = folder / "recording.toml"
    toml.write_text(toml.read_text().replace('"ptm3600"', '{ kind = "free_rotor", inertia_kg_m2 = 0.01 }'))
    done = spinbench_here("diagnose", folder, "-o", tmp_path / "out", cwd=tmp_path)
    assert (done.returncode, "(angle.csv: angle_rad alone; add a column speed_rpm, made of" in done.stderr) == (2, True)


def test_every_recording_at_hand_is_read():
    if not SHARED.is_dir():
        pytest.skip("../shared is not beside the repository")
    places = [place for top in SHARED.iterdir() if top.is_dir() for place in top.rglob("recording.toml")]
    assert places
    for place in [*places, ROOT / "logs" / "published_sweep" / "recording.toml"]:
        read_recording(place.parent)


# Recordings of one instrument that say when they were taken.

TAKEN = '[origin]\ndate = "{date}"\n[channels.speed_rpm]\nnoise_sd = 0.4\nserial = "{serial}"\n'


def both(folder, first, second, serials=("T-7", "T-7")):
    """Two recordings of 80 s each, taken at these dates."""
    return [
        put(folder / name, steady(0, 40, 80, lowest_rpm=rpm), more=TAKEN.format(date=date, serial=serial))
        for name, date, serial, rpm in zip(("monday", "friday"), (first, second), serials, (60, 61), strict=True)
    ]


@pytest.mark.parametrize("command", ["fit", "diagnose"])
def test_two_recordings_of_one_instrument_at_one_time_are_told_in_a_line(tmp_path, spinbench_here, command):
    one, other = both(tmp_path, "2026-05-28T20:00:00Z", "2026-05-28T22:01:05.5+02:00")
    result = spinbench_here(command, one, other, "-o", tmp_path / "out", cwd=tmp_path)
    assert result.returncode == 2
    line = result.stderr.splitlines()[-1]
    assert line.startswith(f"spinbench: {other} and {one} overlap by 14.5 s by [origin] date")
    assert "one instrument (speed_rpm, serial T-7) cannot have read both" in line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("first", "second", "serials"),
    [
        ("2026-05-28T20:00:00Z", "2026-05-28T20:01:20Z", ("T-7", "T-7")),  # one after the other
        ("2026-05-28T20:00:00Z", "2026-05-28T20:00:00Z", ("T-7", "T-8")),  # two instruments
        ("2026-05-28", "2026-05-28", ("T-7", "T-7")),  # no time of day
        ("2026-05-28T20:00:00Z", "2026-05-28T20:00:00", ("T-7", "T-7")),  # of an unknown time zone
        ("last spring, in the evening", "last spring, in the evening", ("T-7", "T-7")),
        ("9999-12-31T23:59:59Z", "9999-12-31T23:59:59Z", ("T-7", "T-7")),  # beyond all dates
    ],
)
def test_other_dates_are_taken_as_they_are(tmp_path, first, second, serials):
    assert as_given([read_recording(folder) for folder in both(tmp_path, first, second, serials)])
