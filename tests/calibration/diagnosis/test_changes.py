"""What changed between two recordings of one motor, and that nothing did: `spinbench compare`."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

import spinbench as sb
import tests.diagnosis_recordings as recordings
from calibration.diagnosis import changes
from calibration.diagnosis.changes_document import as_json
from calibration.diagnosis.steps.candidate import Candidate
from calibration.diagnosis.steps.search import Search
from calibration.diagnosis.steps.verdict import judge
from calibration.likelihood.descent import find
from calibration.report.comparison import page, words
from calibration.report.fit.words import rounded
from calibration.systems.look_up import compared
from calibration.systems.several.sharing import Sharing
from model.motor import Motor, read_motor
from rig.recording import Recording, read_recording
from tests import browser
from tests.commands import spinbench
from tests.documents import check

pytestmark = pytest.mark.long

LEAK = {"leakage": {"conductance_kg_s_pa2": 2e-14, "exponent": 0.63}}
TRUE = read_motor("ptm3600")["f_overall"].value


def recorded(
    folder: Path, seed: int, chosen: dict, monkeypatch: pytest.MonkeyPatch, friction: float = 1.0
) -> Recording:
    """Every second row of a sweep of a motor whose f_overall is that many times the usual one."""

    def other(name: str) -> Motor:
        motor = read_motor(name)
        return motor.with_values({"f_overall": friction * motor["f_overall"].value})

    with monkeypatch.context() as day:
        day.setattr(recordings, "read_motor", other)
        recordings.sweep(folder, seed, chosen)
    return recordings.every_second_row(folder)


def weighed(before: Recording, after: Recording) -> dict:
    """comparison/1 of a pair."""
    return as_json(changes.compare(before, after, 1))


def figures(found: dict, name: str, parameter: str) -> dict:
    """A quantity before and after, if it is this that changed."""
    return next(one for one in found["changes"] if one["id"] == name)["parameters"][parameter]


def test_two_days_of_an_unchanged_motor_say_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each day has instruments that are off in their own way, as far as they are declared to be."""
    pair = [recorded(tmp_path / name, seed, {}, monkeypatch) for name, seed in (("may", 3), ("june", 8))]
    found = weighed(*pair)
    assert found["verdict"] == "unchanged"
    assert found["unchanged_probability"] > 0.8
    assert found["explanations"][0]["changed"] == []
    friction = figures(found, "f_overall", "f_overall")
    assert abs(friction["change"]["mean"]) < 3.0 * friction["change"]["sd"]
    assert friction["change"]["sd"] < 0.01 * TRUE  # the change is known better than either value
    assert friction["before"]["sd"] > 2.0 * friction["change"]["sd"]


def test_a_leak_of_the_second_day_alone_is_found_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pair = [
        recorded(tmp_path / name, seed, one, monkeypatch) for name, seed, one in (("may", 3, {}), ("june", 8, LEAK))
    ]
    made = changes.compare(*pair, 1)
    found = as_json(made)
    assert found["verdict"] in ("changed", "confounded")
    assert ["leakage"] in [one["changed"] for one in found["explanations"]]
    leak = figures(found, "leakage", "conductance_kg_s_pa2")
    assert leak["after"]["q05"] < 2e-14 < leak["after"]["q95"]
    assert leak["before"]["mean"] < 3.0 * leak["before"]["sd"]  # none, as far as can be told
    written = page.report(made, found)["report.html"]
    for width in (1200, 800):
        assert browser.misfits(written, tmp_path, width) == []


def test_readings_that_are_taken_for_bad_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pair = [recorded(tmp_path / name, seed, {}, monkeypatch) for name, seed in (("may", 3), ("june", 8))]
    rows = [line.split(",") for line in (tmp_path / "june" / "sweep.csv").read_text(encoding="utf-8").splitlines()]
    flow = rows[0].index("flow_l_min")
    rows[4][flow] = f"{10.0 * float(rows[4][flow]):.3f}"
    (tmp_path / "june" / "sweep.csv").write_text("\n".join(map(",".join, rows)) + "\n", encoding="utf-8")
    found = weighed(pair[0], read_recording(tmp_path / "june"))
    told = [(one["file"], one["row"], one["channel"]) for one in found["suspect_rows"]]
    assert (found["verdict"], told) == ("unchanged", [("june/sweep.csv", 4, "flow")])
    assert words.sentence(found).endswith("Taken for bad: june/sweep.csv, row 4: flow.")


def test_a_change_acts_in_the_later_recording_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pair = [recorded(tmp_path / name, seed, {}, monkeypatch) for name, seed in (("may", 3), ("june", 8))]
    several = compared(pair, sharing=Sharing(changes=True))
    problem, base = several.problem, several.base()
    raw = several.raw(problem.predict(base.z, {}))
    more = several.raw(problem.predict(base.z, {"f_overall_changed": {"share": 0.1}}))
    moved = abs(more - raw)
    assert moved[several.at[0]].max() == 0.0
    assert moved[several.at[1]].max() > 0.0
    place = problem.place("f_overall")
    z = base.z.copy()
    z[place] = problem.nuisances[place].z(1.1 * float(problem.nuisances[place].value(z[place])))
    by_hand = several.raw(problem.predict(z, {}))
    assert by_hand[several.at[1]] == pytest.approx(more[several.at[1]], rel=1e-9)


def test_what_both_days_have_alike_is_tried_where_a_change_of_it_was_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drag = {"windage": {"drag_nm_s2": 2e-4}}
    pair = [recorded(tmp_path / name, seed, drag, monkeypatch) for name, seed in (("may", 3), ("june", 8))]
    several = compared(pair, sharing=Sharing(changes=True))
    base = several.base()
    search = Search(several, base)
    search.modes[("windage_changed",)] = find(several, ("windage_changed",), base)
    search.share()
    alike, changed = search.modes[("windage",)], search.modes[("windage_changed",)]
    assert alike.log_evidence > changed.log_evidence > base.log_evidence


@pytest.mark.parametrize(("probability", "said"), [(0.30, ("windage",)), (0.97, ("windage_changed",))])
def test_an_effect_has_changed_only_if_the_recordings_ask_for_it(probability: float, said: tuple[str, ...]) -> None:
    """The effect that both have alike is part of it: 20 to 1 is asked for, as of any further effect."""
    found = [
        Candidate(("windage_changed",), None, 0.0, math.log(probability)),
        Candidate(("windage",), None, 0.0, math.log(0.999 - probability if probability < 0.5 else 0.005)),
        Candidate((), None, 0.0, math.log(1e-9)),
    ]
    tested = {one.names: 0.5 for one in found[:2]} | {(): 1e-9}
    verdict = judge(1e-9, sorted(found, key=lambda one: -one.probability), tested, None)
    assert verdict.kind == "named"
    assert verdict.chosen is not None and verdict.chosen.names == said


def with_serial(folder: Path, serial: str) -> Recording:
    """A recording whose flow meter has a serial number."""
    place, head = folder / "recording.toml", "[channels.flow_l_min]\n"
    place.write_text(place.read_text(encoding="utf-8").replace(head, f'{head}serial = "{serial}"\n'), encoding="utf-8")
    return read_recording(folder)


@pytest.mark.parametrize(("second", "could"), [("FM-8", True), ("FM-7", False)])
def test_an_instruments_error_explains_a_change_unless_it_is_the_same_instrument(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, second: str, could: bool
) -> None:
    for name, seed in (("may", 3), ("june", 8)):
        recorded(tmp_path / name, seed, {}, monkeypatch)
    pair = [with_serial(tmp_path / "may", "FM-7"), with_serial(tmp_path / "june", second)]
    problem = compared(pair, sharing=Sharing(changes=True)).problem
    weighed_too = {effect.id for effect in problem.effects_that_could()}
    assert ("flow_scale_changed" in weighed_too) is could
    assert {"pressure_gauge_scale_changed", "leakage_changed", "f_overall_changed"} <= weighed_too
    assert "inertia_changed" not in weighed_too  # without a run in time nothing is said of it


def check_python(since: sb.ComparisonResult, found: dict) -> None:
    """What Python gives is what the command wrote, with a table and a picture."""
    check(found)
    assert since.document == found
    assert (since.verdict, since.changed, since.p_value) == ("changed", ["f_overall"], found["mismatch"]["p_value"])
    assert since.unchanged_probability == found["unchanged_probability"]
    row = since.table.iloc[0]
    assert (row["changed"], row["parameter"], row["unit"], row["listed"]) == ("f_overall", "f_overall", "N m s", True)
    for when in ("before", "after", "change"):
        assert row[f"{when}_q05"] == figures(found, "f_overall", "f_overall")[when]["q05"]
    assert since.sets["changed"].iloc[0] == "f_overall"
    assert len(since.next_tests) == len(found["next_tests"])
    assert since.sentence in repr(since) and since.sentence in since._repr_html_()
    assert since.plot()._repr_png_().startswith(b"\x89PNG")


def test_a_motor_with_more_friction_is_told_with_how_much_in_json_and_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, seed, factor in (("may", 3, 1.0), ("june", 8, 1.15)):
        recorded(tmp_path / name, seed, {}, monkeypatch, factor)
        with (tmp_path / name / "recording.toml").open("a", encoding="utf-8") as file:
            file.write(f'[origin]\ndate = "2026-0{9 - seed}-01"\n')  # the second is the earlier one
    done = spinbench("compare", tmp_path / "may", tmp_path / "june", "-o", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "out" / "comparison.json").read_text(encoding="utf-8"))
    assert found["format"] == "comparison/1"
    assert [one["recording"] for one in found["recordings"]] == ["may", "june"]
    assert found["verdict"] == "changed"
    assert [one["changed"] for one in found["explanations"]] == [["f_overall"]]
    assert found["unchanged_probability"] < 1e-6
    friction = figures(found, "f_overall", "f_overall")
    assert friction["change"]["q05"] < 0.15 * TRUE < friction["change"]["q95"]
    assert friction["before"]["q05"] < TRUE < friction["before"]["q95"]
    assert "What changed is f_overall" in done.stderr
    check_python(sb.compare(tmp_path / "may", sb.open(tmp_path / "june")), found)
    text = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "N m s" in text and "may and june" in text
    assert "is the earlier one by its date" in text
    assert "one motor that did not change: p " in text.replace("&lt;", "<")
    rows = [f"{one['file']}: {one['rows_used']} of {one['rows']} rows" for one in found["files"]]
    assert f"Rows used: {'; '.join(rows)}." in text
    change = next(one for one in found["changes"] if one["id"] == "f_overall")["parameters"]["f_overall"]["change"]
    low, high = (rounded(change[key], change["sd"]) for key in ("q05", "q95"))
    assert f"{low} to {high} N m s" in text.replace("\N{NO-BREAK SPACE}", " ")
    assert (tmp_path / "out" / "report.png").read_bytes().startswith(b"\x89PNG")


def test_what_cannot_be_compared_is_refused_in_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, spinbench_here
) -> None:
    for name, seed in (("may", 3), ("june", 8)):
        recorded(tmp_path / name, seed, {}, monkeypatch)
    for name, serial in (("may", "A1"), ("june", "B2")):
        with (tmp_path / name / "recording.toml").open("a", encoding="utf-8") as file:
            file.write(f'[origin]\nmotor_serial = "{serial}"\n')
    for other, said in (("june", "not of the motor"), ("may", "given twice"), ("july", "july")):
        done = spinbench_here("compare", "may", other, "-o", "out", cwd=tmp_path)
        assert done.returncode == 2, done.stderr
        assert said in done.stderr.splitlines()[-1]
        assert "Traceback" not in done.stderr
        assert not (tmp_path / "out").exists()
