"""The report of a diagnosis: what it says, that it stands alone, and that no text from a file gets into its markup."""

from __future__ import annotations

import copy
import dataclasses
import html
import io
import json
import math
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread
from rich.console import Console

from calibration.data.refusals import refuse_unusable
from calibration.data.rows_used import few_used
from calibration.diagnosis import Diagnosis, as_json, diagnose, together
from calibration.diagnosis.next_test.recommend import NextTest
from calibration.diagnosis.result import of_each_recording
from calibration.diagnosis.steps.confirm import Predicted
from calibration.diagnosis.steps.discover import Term
from calibration.diagnosis.steps.locate import Kind, Place
from calibration.diagnosis.steps.verdict import Verdict, VerdictKind
from calibration.fit import fit
from calibration.fit.sampling import Settings
from calibration.likelihood.expected import Capture
from calibration.report import sets_in_words
from calibration.report.diagnosis import figures as diagnosis_figures
from calibration.report.diagnosis import numbers
from calibration.report.diagnosis import page as diagnosis_page
from calibration.report.diagnosis import sets as diagnosis_sets
from calibration.report.diagnosis import table as diagnosis_table
from calibration.report.diagnosis import words as diagnosis_words
from calibration.report.machines import words as machine_words
from calibration.report.units import CAUTION
from calibration.systems.look_up import compared
from calibration.systems.radial_piston.predict.problem import Problem
from rig.recording import read_recording
from tests import browser
from tests.diagnosis_recordings import add_coast_down, sweep
from tests.synthetic_runs import write_sweep

ROOT = Path(__file__).resolve().parents[3]

HOSTILE = "a<b>$x$.csv"  # markup for the page, and mathematics for the plots
LEAK = 4e-14


def hostile(folder: Path) -> Path:
    """The recording with its data file renamed by someone unfriendly."""
    (folder / "sweep.csv").rename(folder / HOSTILE)
    description = folder / "recording.toml"
    origin = '\n[origin]\noperator = "<i>leaky"\noil = "VG 32"\n'
    description.write_text(description.read_text().replace('"sweep.csv"', f'"{HOSTILE}"') + origin)
    return folder


@pytest.fixture(scope="module")
def leak(tmp_path_factory) -> Diagnosis:
    """A sweep with a leak and nothing else."""
    folder = tmp_path_factory.mktemp("recordings") / "<i>leak"
    sweep(folder, 3, {"leakage": {"conductance_kg_s_pa2": LEAK}})
    found = diagnose(read_recording(hostile(folder)), 1)
    chosen = next(c for c in found.candidates if c.names == ("leakage",))
    return dataclasses.replace(found, verdict=Verdict(VerdictKind.NAMED, chosen, (), 0.99, "one set explains it alone"))


@pytest.fixture(scope="module")
def clean(tmp_path_factory) -> Diagnosis:
    """A sweep of the model itself but for one misread row."""
    folder = tmp_path_factory.mktemp("recordings") / "clean"
    sweep(folder, 5, {}, bad_row=7)
    return diagnose(read_recording(hostile(folder)), 1)


@pytest.fixture(scope="module")
def files(leak) -> dict[str, bytes]:
    return diagnosis_page.report(leak, as_json(leak))


@pytest.fixture(scope="module")
def page(files) -> str:
    return files["report.html"].decode()


def confounded(found: Diagnosis) -> Diagnosis:
    """The same, as if it could not be told from a flow meter's scale."""
    rival = next(c.names for c in found.candidates if c.names and "leakage" not in c.names)
    verdict = Verdict(VerdictKind.CONFOUNDED, found.verdict.chosen, (rival,), 0.6, "several sets explain it")
    names = (("leakage",), rival)
    tests = [
        NextTest("coast-down from 1.8 bar", names, 2.0, 3, nats_where_true={names[0]: 0.3, names[1]: 12.0}),
        NextTest("spin-up to 2.4 bar", names, 0.4),
        NextTest("read the flow beside a reference", names, 9.0, 1, "a reference flow meter"),
    ]
    return dataclasses.replace(found, verdict=verdict, next_tests=tests)


def unresolved(found: Diagnosis, column: np.ndarray) -> Diagnosis:
    """The same, as if no set explained it and a law had been found."""
    term = Term("torque", "0.2083*(omega > 32.4) + -0.0049*abs(omega)**1.5", "N m", 5.0, column, (0.97, 0.84))
    return dataclasses.replace(
        found, verdict=Verdict(VerdictKind.UNRESOLVED, None, (), 0.0, ""), term=term, held_out=None
    )


def words_of(found: Diagnosis, *figures: str) -> str:
    """The page's text without figures, or with the captions of some."""
    filled = diagnosis_page.context(found, as_json(found))
    return diagnosis_page.page(filled | {"figures": dict.fromkeys(figures, ""), "models": []}).decode()


def test_the_report_is_a_page_and_a_picture_that_opens(files):
    assert set(files) == {"report.html", "report.png"}
    height, width, _ = imread(io.BytesIO(files["report.png"])).shape
    assert width >= 900
    assert height >= 900


def test_the_page_begins_with_the_verdict_its_size_and_what_is_excluded(leak, page):
    said = as_json(leak)["effects"][0]["parameters"]["conductance_kg_s_pa2"]
    assert f"({said['mean'] * 1e14:.2f} ± {said['sd'] * 1e14:.2f})·10⁻¹⁴ kg/(s Pa²)" in page
    verdict = page.index("Air enters that does no work on the pistons")
    excluded = page.index("Excluded with odds of")
    assert page.index('class="verdict"') < verdict < excluded < page.index("<h2>")


def test_without_a_held_rotor_none_is_pictured(page):
    assert "Flow with the rotor held" not in page


def test_a_coefficient_is_told_as_what_it_does_at_the_highest_level(leak):
    line, ambient, temperature = 2.4e5, 1.01325e5, 293.15
    true = LEAK * (line**2 - ambient**2) * 287.05 * temperature / line * 60_000.0
    said = diagnosis_sets.at_top(leak, leak.verdict.chosen)["leakage"]
    found = re.match(r"([\d.]+) ± ([\d.]+) L/min at the highest level, 2\.4\d bar", said)
    assert found is not None
    assert float(found[1]) == pytest.approx(true, abs=5.0 * float(found[2]))


def test_every_set_weighed_is_in_the_table_with_its_odds(leak, page):
    for one in leak.candidates[: diagnosis_page.MOST]:
        assert f"<td>{' + '.join(one.names) or 'base model: nothing left out'}</td>" in page
    assert page.count(" : 1</td>") >= min(len(leak.candidates), diagnosis_page.MOST) - 2


def test_the_page_tells_f_overall_before_and_after_and_what_it_was_biased_by(leak, page):
    document = as_json(leak)
    before, after = document["f_overall_before"], document["f_overall_after"]
    assert (
        f"too {'low' if before['mean'] < after['mean'] else 'high'} without “air that does no work (leakage)”" in page
    )
    assert f"{before['mean']:.4f} ± {before['sd']:.4f} N m s" in page
    assert f"{after['mean']:.4f} ± {after['sd']:.4f} N m s" in page


def test_the_page_tells_the_error_on_held_out_rows(leak, page):
    held_out = as_json(leak)["improvement"]["held_out"]
    assert "On readings that it had not seen" in page
    assert f"{held_out['rmse_before']['flow_m3_s'] * 60_000.0:.3g} L/min</td>" in page


def test_a_run_that_nothing_had_seen_is_told_from_cross_validation(leak):
    kind = Predicted.UNSEEN_RUN
    unseen = dataclasses.replace(leak.held_out, folds=1, gain_se=0.0, scheme="unseen run <b>monday", kind=kind)
    said = words_of(dataclasses.replace(leak, held_out=unseen))
    assert "On readings of an unseen run &lt;b&gt;monday" in said
    assert re.search(
        r"base model \(\+[\d.]+ in log likelihood\); nothing had seen that run before", said
    )  # of one piece: no error is known
    assert "cross-validated" not in said
    assert "cross-validated in" in words_of(leak)


def test_what_an_unseen_run_says_has_its_error_and_a_loss_is_called_one(leak):
    unseen = dataclasses.replace(leak.held_out, gain=-12.4, gain_se=3.1, kind=Predicted.UNSEEN_RUN)
    found = dataclasses.replace(leak, held_out=unseen)
    told = "worse than the base model (−12.4 ± 3.1 in log likelihood)"
    assert f"It predicts them {told}; nothing had seen that run before" in words_of(found)
    assert told in shown(as_json(found))
    assert "worse" not in words_of(leak)


def shown(document: dict[str, Any]) -> str:
    """The terminal's table as text."""
    out = io.StringIO()
    Console(file=out, width=400).print(diagnosis_table.table(document))
    return out.getvalue()


def test_the_probability_of_a_set_is_told_as_what_it_is_of(leak):
    said = words_of(leak)
    told = as_json(leak)["set_probability"]
    assert f"probability that this set is there, alone or with more, is {told:.3f}, by how often sets came true" in said
    assert "(0.990 among all that were weighed)" in said
    assert f"; probability {told:.2f}, by how often" in shown(as_json(leak))


def test_beside_a_base_model_that_is_not_excluded_the_probability_is_of_the_set_alone(leak):
    verdict = dataclasses.replace(leak.verdict, kind=VerdictKind.CONFOUNDED, alternatives=((),))
    listed = dataclasses.replace(leak, verdict=verdict)
    told = as_json(listed)["set_probability"]
    assert f"probability that the first of these sets is there is {told:.3f}, by how often" in words_of(listed)
    assert "(0.990 among all that were weighed)" in words_of(listed)


def test_a_run_that_a_diagnosis_uses_is_said_to_be_left_out_by_a_fit_of_plateaus_alone(tmp_path):
    sweep(tmp_path, 3, {})
    recording = add_coast_down(tmp_path, 3, {})
    motor, measured, likelihood = fit.prepare(recording)
    steady = fit.Fit(recording, motor, measured, likelihood, None, Settings())
    assert "coast_down.csv: a run in time; a fit to the plateaus alone does not use it" in steady.notes
    assert not any("coast_down.csv" in note for note in Problem(recording).blocks.measured.notes)


@pytest.mark.long
def test_a_verdict_that_rests_on_bad_readings_alone_tells_the_document_s_probability(clean):
    document = as_json(clean) | {"set_probability": 0.61}
    assert clean.verdict.chosen is None
    said = diagnosis_page.context(clean, document)["certainty"]
    assert said.endswith("these readings alone are off is 0.610, as such verdicts have turned out in blind tests.")


def test_f_overall_is_as_before_only_where_its_mean_and_its_error_are(clean):
    before = {"mean": 0.064, "sd": 0.0010, "q05": 0.062, "q95": 0.066}
    same = {"f_overall_before": before, "verdict": "consistent", "rivals": []}
    told = diagnosis_sets.bias_in_words(same | {"f_overall_after": before})
    assert told == "f_overall is 0.0640 ± 0.0010 N m s, as before; nothing has to be corrected."
    told = diagnosis_sets.bias_in_words(same | {"f_overall_after": before | {"sd": 0.0040}})
    assert "as before" not in told
    assert "0.0640 ± 0.0040 N m s; in the base model alone it is 0.0640 ± 0.0010 N m s" in told


def test_f_overall_is_shown_before_and_after_though_only_its_error_changed(clean):
    document = as_json(clean)
    document["f_overall_after"] = document["f_overall_before"] | {"sd": 0.02}
    first, second = diagnosis_sets.frictions(clean, document)
    assert (first.mean, first.name) == (second.mean, "before: base model")
    assert second.name.startswith("after: ")


def test_sets_of_several_effects_are_set_off_by_commas():
    sets = (["leakage"], ["flow_offset", "flow_scale"], [])
    assert sets_in_words.in_a_row(sets, "or") == (
        "“air that does no work (leakage)”, “flow meter reads high or low by a constant (flow_offset)” and “flow meter "
        "reads high or low in proportion (flow_scale)”, or nothing left out"
    )
    assert sets_in_words.in_a_row([["windage"], ["nothing missing"]], "and") == (
        "“drag growing with the square of speed (windage)” and nothing missing"
    )


def explained_by(*sets: list[str]) -> dict[str, Any]:
    """A confounded document of these sets, the likeliest first."""
    effects = [{"id": name, "parameters": {}} for name in sets[0]]
    said = {"verdict": "confounded", "mismatch": {"p_value": 1e-9}, "set_probability": 0.6, "check": [], "left": None}
    return said | {"effects": effects, "alternatives": list(sets[1:]), "next_tests": []}


def test_an_effect_that_every_explanation_has_is_told_as_that():
    document = explained_by(["leakage", "windage"], ["windage", "flow_offset"], ["windage"])
    drag, leak = "“drag growing with the square of speed (windage)”", "“air that does no work (leakage)”"
    meter = "“flow meter reads high or low by a constant (flow_offset)”"
    assert diagnosis_words.sentence(document) == (
        f"The model does not fit (p < 10⁻⁶). Every explanation has {drag}. Beside it, most likely {leak}; also "
        f"possible: {meter} or nothing more. No test is known that would decide."
    )
    assert sets_in_words.alternatives(document, 6)[-1] == ("in all of them", drag)
    assert machine_words.sentence(document) == (
        f"The model does not fit (p < 1e-06), and this recording cannot tell what there is beside {drag}: {leak}, "
        f"{meter} or nothing more."
    )


def test_where_no_effect_is_in_every_explanation_none_is_told_as_that():
    document = explained_by(["leakage", "windage"], ["windage"], ["leakage"])
    for sentence in (diagnosis_words.sentence(document), machine_words.sentence(document)):
        assert "Every explanation" not in sentence
        assert "beside" not in sentence
    assert len(sets_in_words.alternatives(document, 6)) == 2


@pytest.mark.parametrize(
    ("odds", "text"),
    [
        (1.0, "1 : 1"),
        (1.26, "1.3 : 1"),
        (99.7, "100 : 1"),
        (12_345.0, "12000 : 1"),
        (999_999.0, "1000000 : 1"),
        (2e6, "over 10⁶ : 1"),
        (float("inf"), "over 10⁶ : 1"),
        (0.01003, "1 : 100"),
        (0.0, "1 : over 10⁶"),
    ],
)
def test_odds_are_told_to_two_digits_without_an_exponent(odds, text):
    assert diagnosis_page._odds(odds) == text


def test_a_single_row_is_told_as_a_row(clean):
    assert clean.places[0].where == (7.0, 7.0)
    assert "<td>row 7</td>" in words_of(clean)


def test_the_caption_tells_of_the_markers_that_are_drawn(clean):
    assert diagnosis_figures.markers_in_words(clean) == "▲ up, ▼ down"
    plateaus = clean.comparison.problem.blocks.plateaus
    nowhere = dataclasses.replace(plateaus, up=np.zeros_like(plateaus.up))
    assert diagnosis_figures.markers_in_words(_with_plateaus(clean, nowhere)) == "■ direction not noted"


def _with_plateaus(found: Diagnosis, plateaus: Any) -> Any:
    blocks = dataclasses.replace(found.comparison.problem.blocks, plateaus=plateaus)
    return SimpleNamespace(comparison=SimpleNamespace(problem=SimpleNamespace(blocks=blocks)))


def odds_panel(found: Diagnosis) -> Any:
    """The panel of the sets' odds."""
    axes = Figure().subplots()
    diagnosis_figures._odds_panel(axes, found)
    return axes


def test_a_base_model_that_leaves_something_is_hatched_though_it_is_the_likeliest(leak):
    found = unresolved(leak, np.zeros(leak.comparison.read.size))
    base = next(i for i, one in enumerate(diagnosis_sets.shortlist(found)) if not one.names)
    assert odds_panel(found).patches[base].get_hatch()
    explains = dataclasses.replace(found, residual_p={**found.residual_p, (): 0.4})
    assert not odds_panel(explains).patches[base].get_hatch()


def test_a_set_that_is_likelier_than_the_verdict_s_reaches_farther(leak):
    chosen = leak.verdict.chosen
    better = dataclasses.replace(
        chosen, names=("leakage", "windage"), log_probability=math.log(10.0) + chosen.log_probability
    )
    panel = odds_panel(dataclasses.replace(leak, candidates=[better, chosen]))
    ends = [bar.get_x() + bar.get_width() for bar in panel.patches]
    assert ends == pytest.approx([1.0, 0.0])
    assert panel.get_xlim()[1] > 1.0
    assert panel.get_xlabel() == "odds against the verdict's set"


def test_odds_of_an_unresolved_verdict_are_not_said_to_be_of_a_set_that_it_rests_on(leak):
    said = " ".join(words_of(unresolved(leak, np.zeros(leak.comparison.read.size)), "odds").split())
    assert "Odds are those of the likeliest set (the verdict rests on none) against each" in said
    assert "the set that the verdict rests on" not in said
    assert "the set that the verdict rests on" in " ".join(words_of(leak, "odds").split())


def test_a_base_model_that_explains_everything_is_not_drawn_in_the_colour_of_what_is_wrong(clean):
    quiet = dataclasses.replace(clean, verdict=Verdict(VerdictKind.CONSISTENT, None, (), 1.0, ""))
    axes = Figure().subplots()
    intervals = diagnosis_sets.frictions(quiet, as_json(quiet))
    diagnosis_figures._friction_panel(axes, intervals, diagnosis_figures._colours(quiet))
    assert {line.get_color() for line in axes.lines} & {diagnosis_figures.BEFORE} == set()


def test_a_recording_that_would_show_nothing_says_so(clean):
    unseen = [dataclasses.replace(one, seen_from=None) for one in clean.resolved]
    verdict = Verdict(VerdictKind.CONSISTENT, None, (), 1.0, "")
    blind = dataclasses.replace(clean, verdict=verdict, resolved=unseen)
    assert "This recording would show no effect of a believable size." in words_of(blind)
    assert "would show no effect" not in words_of(dataclasses.replace(blind, resolved=clean.resolved))
    wide = dataclasses.replace(clean.base, covariance=np.eye(clean.base.z.size))
    told = diagnosis_sets.blind_in_words(dataclasses.replace(blind, base=wide))
    assert told.endswith("of a believable size; f_overall is as its prior has it.")


def test_a_confounded_page_sets_the_rivals_side_by_side_with_the_test_that_parts_them(leak):
    said = words_of(confounded(leak))
    assert "Most likely “air that does no work (leakage)”; also possible: " in said
    assert "<p>Either “air that does no work (leakage)”: " in said
    assert "<p>Or " in said
    assert re.search(
        r"<td>coast-down from 1\.8 bar: no.*?</td>.*?2\.0 \(0\.3 to 12\.0\)</td><td class=\"n\">3</td>", said
    )
    assert re.search(
        r"<td>spin-up to 2\.4 bar: no.*?</td>.*?0\.4</td><td class=\"n\">some pair stays open</td>",
        said,
    )
    order = ("spin-up to 2.4 bar", "With something that the bench may not have:", "beside a reference")
    assert sorted(order, key=said.index) == list(order)
    assert ">times to take it</th>" in said
    assert CAUTION in said
    assert "Excluded" not in said


def test_a_test_is_told_with_its_odds_and_its_command_or_why_there_is_none(leak):
    told = confounded(leak)
    taken = dataclasses.replace(told.next_tests[0], capture=Capture("coast-down", 1.8))
    rows = diagnosis_table.tests(as_json(dataclasses.replace(told, next_tests=[taken, *told.next_tests[1:]])))
    between = "0.3 to 12.0, depending on which explanation is right"
    assert rows == [
        ("next test", f"coast-down from 1.8 bar (2.0 nats: odds of 7.4 to 1; {between})"),
        ("", "take it 3 times: each two are then parted, on average with 150 : 1"),
        ("", "spinbench capture BENCH --kind coast-down --level-bar-abs 1.8"),
        ("next test", "spin-up to 2.4 bar (0.4 nats: odds of 1.5 to 1)"),
        ("", "however often it is taken, some pair stays open"),
        ("", "no command: take it by hand"),
        ("next test", "read the flow beside a reference (9.0 nats: odds of 8100 to 1)"),
        ("", "take it once: each two are then parted, on average with 150 : 1"),
        ("", "no command: it needs a reference flow meter"),
        ("note", CAUTION),
    ]


def test_terminal_and_page_count_the_rows_used_alike(leak):
    locked = [one | {"rows_used": 5, "why": "1 row: the rotor is held"} for one in leak.comparison.rows_used()]
    few = dataclasses.replace(leak, comparison=copy.copy(leak.comparison))
    few.comparison.rows_used = lambda: locked
    said, document = html.unescape(words_of(few)), as_json(few)
    assert f"Rows used: {HOSTILE}: 5 of {locked[0]['rows']} rows." in said
    assert few_used(document["files"])[0].startswith(f"{HOSTILE}: 5 of {locked[0]['rows']} rows are used;")


def test_an_unresolved_page_tells_the_place_and_the_law_and_warns_of_f_overall(leak):
    said = words_of(unresolved(leak, np.zeros(leak.comparison.read.size)))
    assert "no effect in the list explains why" in said
    assert "error depends on" in said
    assert "0.2083·(ω &gt; 32.4) − 0.0049·abs(ω)^1.5 N m" in said
    assert "do not rely on it" in said
    assert "its terms were found again in 97 % and 84 %" in said


def test_an_unresolved_page_without_a_stable_law_says_so(leak):
    said = words_of(dataclasses.replace(unresolved(leak, np.zeros(leak.comparison.read.size)), term=None))
    assert "No law of one or two terms is stable" in said


def test_the_page_tells_what_the_recording_cannot_show(page):
    assert "Not observable in this recording:" in page
    assert "Shaft angle: every row is a mean over many turns." in page


def test_a_misread_row_is_named_and_ringed(clean):
    said = words_of(clean)
    assert "One reading stands out from everything else" in said
    assert "a&lt;b&gt;$x$.csv, row 7: speed" in said
    assert said.index("<h2>Bad readings</h2>") < said.index("<h2>Assumptions and time</h2>")
    assert diagnosis_page.report(clean, as_json(clean))["report.png"]


def test_a_consistent_page_has_nothing_to_rank(clean):
    verdict = Verdict(VerdictKind.CONSISTENT, None, (), 1.0, "")
    quiet = dataclasses.replace(clean, verdict=verdict, places=[], bad_rows=[])
    said = words_of(quiet)
    assert "No missing effect was detected" in said
    assert "Candidates" not in said
    assert "What to measure next" not in said


def test_text_from_the_recording_is_escaped(page):
    assert "<i>leak" not in page
    assert "&lt;i&gt;leak" in page
    assert "a<b>" not in page
    assert '<p class="origin">By &lt;i&gt;leaky; oil: VG 32</p>' in page


def test_the_page_needs_nothing_from_outside(page):
    links = re.findall(r"(?:src|href)\s*=\s*[\"']([^\"']*)", page)
    assert len(links) >= 5
    assert all(link.startswith("data:image/png;base64,") for link in links)
    assert not re.search(r"@import|url\(|<script|<link", page)


def test_the_page_names_the_recording_by_its_hash_and_not_by_its_place(leak, page):
    recording = leak.comparison.problem.recording
    assert recording.sha256 in page
    assert str(recording.folder.parent) not in page


def test_the_model_that_the_verdict_rests_on_leaves_less(leak):
    before, after = numbers.models(leak)
    assert np.nansum(after.white**2) < 0.5 * np.nansum(before.white**2)


def test_a_law_that_is_in_the_readings_leaves_the_residuals_that_were_there_without_it(leak):
    column = 1e-5 * np.where(leak.comparison.kind == numbers.KINDS["flow"], 1.0, -20.0)
    zero = numbers.models(unresolved(leak, np.zeros_like(column)))[1]
    changed = unresolved(leak, column)
    shifted = dataclasses.replace(changed, comparison=_with_readings(changed, column))
    assert numbers.models(shifted)[1].difference == pytest.approx(zero.difference, abs=1e-9, nan_ok=True)


def _with_readings(found: Diagnosis, column: np.ndarray) -> Any:
    import copy

    changed = copy.copy(found.comparison)
    changed.read = changed.read + column
    return changed


def test_a_free_form_force_is_near_nothing_where_nothing_is_left_out(clean):
    for curve in numbers.curves(clean):
        assert np.mean(np.abs(curve.mean) < 3.0 * curve.sd) >= 0.75


def test_every_balance_and_every_instrument_is_pictured_along_what_it_could_hang_on(clean):
    """Along pressure not: without load the sweep cannot tell that from speed."""
    shown = [(one.quantity, one.unit, one.along.name, one.along.unit) for one in numbers.curves(clean)]
    assert shown[:4] == [
        ("torque", "N m", "speed", "rpm"),
        ("flow", "L/min", "speed", "rpm"),
        ("torque", "N m", "time", "min"),
        ("flow", "L/min", "time", "min"),
    ]
    assert set(shown[4:]) == {
        ("error", "kPa", "pressure", "bar abs"),
        ("error", "L/min", "flow", "L/min"),
        ("error", "rpm", "speed", "rpm"),
    }


def beside(found: Diagnosis, comparison: Any, places: list[Place]) -> Diagnosis:
    """A diagnosis of other readings that rests on nothing, with places."""
    return dataclasses.replace(
        found,
        comparison=comparison,
        base=comparison.base(),
        candidates=[],
        verdict=Verdict(VerdictKind.UNRESOLVED, None, (), 0.0, ""),
        correction=None,
        nuisances_corrected=None,
        detection=dataclasses.replace(found.detection, u=np.zeros(100)),
        places=places,
    )


def test_what_stands_out_in_one_recording_is_not_shaded_on_the_page_of_another(leak, tmp_path):
    place = Place(Kind.METER, "flow", "sensor", "flow", (0.0, 1.0), "m3/s", 1e-4, "An error of the flow meter.", ())
    named = [dataclasses.replace(place, recording=name) for name in ("", "june")]
    both = compared([sweep(tmp_path / name, seed, {}) for name, seed in (("may", 3), ("june", 8))])
    pages = of_each_recording(beside(leak, both, named))
    assert {name: one.places for name, one in pages.items()} == {"may": named[:1], "june": named}


def test_a_run_is_shaded_where_it_stands_out_itself_and_the_table_names_it(leak, tmp_path):
    sweep(tmp_path / "one", 3, {})
    recording = add_coast_down(tmp_path / "one", 3, {})
    (run,) = compared(recording).problem.blocks.runs
    place = Place(Kind.BALANCE, "speed", "torque", "phase", (0.0, 0.1), "s", 1e-4, "It is off.", ())
    for file, shaded in ((run.file, 1), ("spin_up.csv", 0)):
        found = beside(leak, compared(recording), [dataclasses.replace(place, file=file)])
        figure, (upper, lower) = plt.subplots(2)
        diagnosis_figures._run_panels(upper, lower, found, [], 0)
        plt.close(figure)
        assert len(lower.patches) == shaded
        (row,) = diagnosis_page._place_table({"located": [dataclasses.asdict(found.places[0])]}).rows
        assert row[1] == f"speed in {file}"


def test_residuals_stand_along_absolute_pressure_whatever_the_gauge_counts_from(leak, tmp_path):
    sweep(tmp_path / "one", 3, {})
    absolute = compared(read_recording(tmp_path / "one"))
    toml, table = (tmp_path / "one" / name for name in ("recording.toml", "sweep.csv"))
    toml.write_text(toml.read_text().replace("channels.pressure_bar_abs", "channels.pressure_bar_gauge"))
    header, *rows = (line.split(",") for line in table.read_text().splitlines())
    room, column = absolute.problem.motor.si("ambient_pressure") / 1e5, header.index("pressure_bar_abs")
    header[column] = "pressure_bar_gauge"
    for row in rows:
        row[column] = f"{float(row[column]) - room:.6f}"
    table.write_text("\n".join(map(",".join, [header, *rows])) + "\n")
    shown = [
        numbers.coordinates(beside(leak, one, []))[0] for one in (absolute, compared(read_recording(tmp_path / "one")))
    ]
    assert {(one.name, one.unit) for one in shown} == {("pressure", "bar abs")}
    assert shown[1].values == pytest.approx(shown[0].values, abs=2e-6)


def test_the_file_that_speaks_against_a_rival_is_the_only_one_there_is(leak):
    rival = next(c for c in leak.candidates if not c.names)
    assert diagnosis_sets.told_by(leak, rival) == (HOSTILE, 1.0)


@pytest.mark.parametrize(
    ("figures", "text"),
    [
        ((0.1, 0.01, "N m"), "0.100 ± 0.010 N m"),
        ((-6e-5, 2.5e-6, "m3/s"), "−3.60 ± 0.15 L/min"),
        ((4100.0, 300.0, "Pa"), "4.10 ± 0.30 kPa"),
        ((3.1e-14, 2.6e-15, "kg/(s Pa2)"), "(3.10 ± 0.26)·10⁻¹⁴ kg/(s Pa²)"),
        ((0.147, 0.0081, "-", "share_cold"), "14.70 ± 0.81 %"),
        ((0.03, 0.002, "s"), "30.0 ± 2.0 ms"),
    ],
)
def test_a_figure_has_a_unit_and_an_uncertainty_of_two_digits(figures, text):
    assert diagnosis_words.quantity(*figures) == text


@pytest.mark.parametrize(("offset", "way"), [(4e3, "high"), (-4e3, "low")])
def test_a_signed_effect_is_told_in_its_own_direction(offset, way):
    parameters = {"offset_pa": {"mean": offset, "sd": 300.0, "q05": 0.0, "q95": 0.0}}
    effect = {"id": "pressure_gauge_offset", "parameters": parameters}
    assert diagnosis_words.effect_in_words(effect, {}) == f"The pressure gauge reads 4.00 ± 0.30 kPa {way}."


def test_a_probability_that_no_draw_reached_is_not_told_to_its_last_digit():
    assert diagnosis_words.p_in_words(1e-80) == "p < 10⁻⁶"
    assert diagnosis_words.p_in_words(0.0123) == "p = 0.012"


@pytest.mark.parametrize(("p", "told"), [(0.9999, "100 %"), (0.123, "12 %"), (0.0001234, "0.012 %")])
def test_a_chance_is_told_in_plain_digits(clean, p, told):
    document = as_json(clean)
    document["mismatch"]["p_value"] = p
    assert f" in {told} of all cases" in diagnosis_page.context(clean, document)["certainty"]


def test_the_times_of_like_steps_are_told_together():
    seconds = {"detect": 0.4, "test what is left of leakage": 1.0, "test what is left of windage": 0.5}
    assert diagnosis_words.steps_in_words(seconds) == "detect 0.4 s, test what is left 1.5 s; 1.9 s in all"


@pytest.mark.long
def test_the_command_writes_page_picture_and_document_and_tells_the_time_of_each_step(tmp_path):
    sweep(tmp_path / "recording", 11, {})
    command = [sys.executable, "-m", "spinbench", "diagnose", "recording", "-o", "out", "--json", "found.json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert {place.name for place in (tmp_path / "out").iterdir()} == {"report.html", "report.png", "diagnosis.json"}
    written, copy = (json.loads((tmp_path / place).read_text()) for place in ("out/diagnosis.json", "found.json"))
    folders = [one["recordings"][0].pop("folder") for one in (written, copy)]  # as each is seen from where it lies
    assert folders == ["../recording", "recording"]
    assert written == copy and written["format"] == "diagnosis/1"
    assert re.search(r"base model \d+\.\d s, detect \d+\.\d s.* s in all", done.stderr)


def test_unusable_input_is_refused_in_a_line_and_nothing_is_written(tmp_path, spinbench_here):
    sweep(tmp_path / "recording", 11, {})
    description = tmp_path / "recording" / "recording.toml"
    description.write_text(description.read_text().replace("ptm3600", "nobody"))
    done = spinbench_here("diagnose", tmp_path / "recording", "-o", tmp_path / "out", cwd=ROOT)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "motor 'nobody' is not in configs/motors" in done.stderr
    assert not (tmp_path / "out").exists()


def test_what_is_held_out_may_not_be_diagnosed_too(tmp_path, spinbench_here):
    sweep(tmp_path / "recording", 11, {})
    done = spinbench_here(
        "diagnose", tmp_path / "recording", "--hold-out", tmp_path / "recording", "--json", "-", cwd=ROOT
    )
    assert done.returncode == 2 and done.stdout == ""
    assert "is to be held out and diagnosed" in " ".join(done.stderr.split())


def test_gauge_pressures_under_the_name_of_absolute_ones_are_refused(tmp_path, spinbench_here):
    """One such row may be misread; all of them are not."""
    sweep(tmp_path / "recording", 11, {})
    table = tmp_path / "recording" / "sweep.csv"
    rows = [line.split(",") for line in table.read_text().splitlines()]
    read, rows[1][2] = rows[1][2], "0.9"
    table.write_text("\n".join(map(",".join, rows)) + "\n")
    refuse_unusable(read_recording(tmp_path / "recording"))
    rows[1][2] = read
    rows[1:] = [[*row[:2], f"{float(row[2]) - 1.013:.3f}", *row[3:]] for row in rows[1:]]
    table.write_text("\n".join(map(",".join, rows)) + "\n")
    done = spinbench_here("diagnose", tmp_path / "recording", cwd=ROOT)
    assert done.returncode == 2 and done.stdout == ""
    said = " ".join(done.stderr.split())
    assert "row 1, column pressure_bar_abs: '0.1" in said
    assert "not above the room's 1.013 bar, yet the rotor turns at" in said
    assert "name the column pressure_bar_gauge" in said


@pytest.mark.long
def test_rows_of_recordings_of_one_name_are_told_apart(tmp_path):
    both = [sweep(tmp_path / day / "recording", seed, {}) for day, seed in (("monday", 11), ("tuesday", 12))]
    names = [file.file for file in together(both).files]
    assert names == ["recording (1)/sweep.csv", "recording (2)/sweep.csv"]
    assert diagnose(together(both), 1).verdict.kind == VerdictKind.CONSISTENT


def test_a_recording_given_twice_is_refused(tmp_path, spinbench_here):
    sweep(tmp_path / "recording", 11, {})
    done = spinbench_here("diagnose", tmp_path / "recording", tmp_path / "recording", cwd=ROOT)
    assert done.returncode == 2 and done.stdout == ""
    assert "a recording is given twice" in done.stderr


@pytest.mark.parametrize("other", ["recording/recording.toml", "copy"])
def test_a_recording_given_twice_in_other_words_is_refused(tmp_path, other, spinbench_here):
    sweep(tmp_path / "recording", 11, {})
    shutil.copytree(tmp_path / "recording", tmp_path / "copy")
    first, again = tmp_path / "recording", tmp_path / other
    twice = spinbench_here("diagnose", first, again, cwd=ROOT)
    assert twice.returncode == 2 and twice.stdout == ""
    assert f"given twice: {tmp_path / other.split('/')[0]}" in twice.stderr
    held = spinbench_here("diagnose", first, "--hold-out", again, cwd=ROOT)
    assert held.returncode == 2 and held.stdout == ""
    assert "is to be held out and diagnosed" in held.stderr


def test_a_run_is_named_as_elsewhere(tmp_path, spinbench_here):
    """By the beginning of its name and as the last: the same folder, so it may not be held out too."""
    folder = write_sweep(tmp_path, captures=False)
    again = spinbench_here(
        "diagnose", folder.name[:20], "--hold-out", "last", "--logs", tmp_path, "--json", "-", cwd=ROOT
    )
    assert again.returncode == 2
    assert f"{folder.name} is to be held out and diagnosed" in " ".join(again.stderr.split())
    for command in ("fit", "diagnose"):
        missing = spinbench_here(command, "nothing", "--logs", tmp_path, cwd=ROOT)
        assert missing.returncode == 2 and missing.stdout == ""
        assert "there is no folder 'nothing', and no run in" in " ".join(missing.stderr.split())


def test_a_run_held_out_for_nothing_is_told(tmp_path, spinbench_here):
    """Nothing is named that could predict it."""
    for seed, name in ((11, "recording"), (12, "unseen")):
        sweep(tmp_path / name, seed, {})
    table = (tmp_path / "unseen" / "sweep.csv").read_text().splitlines()
    more = [table[0] + ",humour", *(line + ",1" for line in table[1:])]
    (tmp_path / "unseen" / "sweep.csv").write_text("\n".join(more) + "\n")
    done = spinbench_here(
        "diagnose", tmp_path / "recording", "--hold-out", tmp_path / "unseen", "--json", "-", cwd=ROOT
    )
    assert json.loads(done.stdout)["verdict"] == "consistent"
    assert f"{tmp_path / 'unseen'} was not predicted" in done.stderr
    assert "humour" in done.stderr


def test_a_place_where_nothing_can_be_written_is_told_before_the_work(tmp_path, spinbench_here):
    (tmp_path / "file").write_text("mine")
    for options in (["-o", tmp_path / "file"], ["-o", tmp_path / "file" / "out"], ["--json", tmp_path]):
        done = spinbench_here("diagnose", tmp_path / "recording", *options, cwd=ROOT)
        assert done.returncode == 2
        assert f"{options[1] if options[0] == '--json' else tmp_path / 'file'}: " in done.stderr
        assert "recording/1" not in done.stderr  # nothing was read
    assert (tmp_path / "file").read_text() == "mine"


def test_the_page_opens_in_a_browser(files, tmp_path):
    unfolded = files["report.html"].replace(b"<details>", b"<details open>")
    assert browser.has_print(browser.shown(unfolded, tmp_path))
