"""The report of a fit: what it says, that it stands alone, and that no text from a file gets into its markup."""

import dataclasses
import html
import io
import itertools
import os
import re
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from calibration.data.left_out import without
from calibration.fit.document import as_json
from calibration.fit.fit import Fit, fit
from calibration.fit.posterior import FitQuality
from calibration.fit.sampling import Settings
from calibration.report import style
from calibration.report.fit import figures as fit_figures
from calibration.report.fit import numbers as fit_numbers
from calibration.report.fit import page as fit_page
from calibration.report.fit import words as fit_words
from calibration.report.origin import origins
from calibration.unknowns.effects import in_a_fit, sampled, searched
from calibration.unknowns.priors import off
from model.effects import effects
from rig.recording import read_recording
from tests import browser

ROOT = Path(__file__).resolve().parents[3]
HOSTILE = "a<b>$x$.csv"  # markup for the page, and mathematics for the plots


@pytest.fixture(scope="module")
def found(tmp_path_factory) -> Fit:
    """A short fit of the published sweep, its data file renamed by someone unfriendly."""
    folder = tmp_path_factory.mktemp("recordings") / "sweep"
    shutil.copytree(ROOT / "logs" / "published_sweep", folder)
    (folder / "sweep.csv").rename(folder / HOSTILE)
    description = folder / "recording.toml"
    origin = '\n[origin]\ndate = "2026-04-01"\nmotor_serial = "<i>A-17"\nnote = "</p><script>alert(1)</script>"\n'
    description.write_text(description.read_text().replace('"sweep.csv"', f'"{HOSTILE}"') + origin)
    return fit(read_recording(folder), Settings(seed=1, effective_samples=500, most_steps=800, times_tau=12.0))


@pytest.fixture(scope="module")
def files(found) -> dict[str, bytes]:
    return fit_page.report(found, [("speed alone", found.posterior)])


@pytest.fixture(scope="module")
def page(files) -> str:
    return files["report.html"].decode()


@pytest.mark.parametrize("count", [1, 8])
def test_a_picture_names_its_suspect_readings_where_they_are_few(found, count):
    (suspect,) = fit_numbers.suspects(found)
    figure = fit_figures.essentials(found, fit_numbers.channels(found), [suspect] * count, [], "")
    names = [text.get_text() for panel in figure.axes for text in panel.texts if "suspect" in text.get_text()]
    keys = [one.get_text() for panel in figure.axes if panel.legend_ for one in panel.legend_.get_texts()]
    assert len(names) == (1 if count == 1 else 0)
    assert ("suspect, 8 readings" in keys) == (count == 8)


def with_share_of_prior(found: Fit, share: float) -> Fit:
    """The fit as if f_overall's spread were this share of its prior's."""
    estimates = tuple(
        dataclasses.replace(one, sd_of_prior=share) if one.unknown.name == "f_overall" else one
        for one in found.posterior.estimates
    )
    return dataclasses.replace(found, posterior=dataclasses.replace(found.posterior, estimates=estimates))


def judged(found: Fit, p: float, why: str = "The torque balance <b>does not close.") -> Fit:
    return dataclasses.replace(found, quality=FitQuality(p, p >= 0.01, why))


@pytest.mark.long
def test_a_model_that_is_contradicted_is_what_the_page_says_first(found):
    wrong = judged(found, 3e-5)
    page = fit_page.report(wrong, [("speed alone", found.posterior)])["report.html"].decode()
    verdict, *after = re.findall(r"<p[^>]*>(.*?)</p>", page)
    assert verdict == "The model does not explain the readings (p = 3e-05): do not rely on its f_overall."
    assert after[0] == "The torque balance &lt;b&gt;does not close."
    assert after[1].startswith("What it gives, not to be relied on: f_overall is ")
    assert "spinbench diagnose" in after[2] and str(wrong.recording.folder) in after[2]
    assert "this fit, not to be relied on" in page
    assert "The data determine f_overall" not in page


def test_of_a_model_that_is_contradicted_no_reading_is_said_to_be_bad(found):
    assert any("probably a bad reading" in words for words in fit_page.remarks(found))
    remarks = fit_page.remarks(judged(found, 1e-9))
    assert not any("probably a bad reading" in words for words in remarks)
    assert any(words.startswith("1 reading looks bad by this model") for words in remarks)


def test_a_model_that_is_not_contradicted_is_said_so_beside_f_overall(found):
    right = judged(found, 0.42, "What it leaves over is no more than noise.")
    said = "The readings do not contradict the model (p = 0.42). What it leaves over is no more than noise."
    assert fit_words.headline(right) == [f"{fit_words.verdict(found.posterior)} {said}"]
    page = fit_page.report(right, [])["report.html"].decode()
    assert said in page and "The data determine f_overall" in page


def test_a_model_with_effects_is_named_with_them(found):
    wrong = dataclasses.replace(judged(found, 0.001), effects=("leakage", "windage"))
    assert fit_words.headline(wrong)[0].startswith("The model with leakage and windage does not explain")


def test_the_next_command_can_be_typed_as_it_stands(found):
    folder = dataclasses.replace(found.recording, folder=Path("my runs/a;b"))
    words = fit_words.next_command(dataclasses.replace(found, recording=folder))
    assert shlex.split(words) == ["spinbench", "diagnose", "my runs/a;b"]
    (less,) = without([folder], [f"{folder.files[0].file}:1", f"{folder.files[0].file}:2"])
    words = fit_words.next_command(dataclasses.replace(found, recording=less))
    asked = [f"--without={folder.files[0].file}:{row}" for row in (1, 2)]
    assert shlex.split(words) == ["spinbench", "diagnose", *asked, "my runs/a;b"]
    of_several = dataclasses.replace(less, without=tuple(f"a;b/{one}" for one in less.without))
    assert fit_words.next_command(dataclasses.replace(found, recording=of_several)) == words
    dashed = dataclasses.replace(folder, folder=Path("-may"))
    assert fit_words.next_command(dataclasses.replace(found, recording=dashed)) == "spinbench diagnose -- -may"


def test_an_unknown_of_a_recording_that_is_called_like_mathematics_is_pictured(found):
    estimates = [
        dataclasses.replace(one, unknown=dataclasses.replace(one.unknown, whose="may$_$1"))
        if one.unknown.name != "f_overall"
        else one
        for one in found.posterior.estimates
    ]
    assert fit_figures.ridge(dataclasses.replace(found.posterior, estimates=estimates)).startswith(b"\x89PNG")


def test_a_folder_of_any_bytes_is_told_on_the_page(found):
    folder = dataclasses.replace(found.recording, folder=Path(os.fsdecode(b"M\xfcller")))
    page = fit_page.report(dataclasses.replace(found, recording=folder), [])["report.html"].decode()
    assert "M\\udcfcller" in page


def test_the_report_is_a_page_and_a_picture(files):
    assert set(files) == {"report.html", "report.png"}
    assert all(len(content) > 10_000 for content in files.values())


def test_the_picture_opens(files):
    height, width, _ = imread(io.BytesIO(files["report.png"])).shape
    assert width >= 900
    assert height >= 900


def test_the_first_sentence_is_the_posterior_of_f_overall(found, page):
    one = found.posterior["f_overall"]
    sentence = f"f_overall is {one.mean:.4f} ± {one.sd:.4f} N m s (90 %: {one.quantiles['q05']:.4f} to "
    assert sentence in page
    assert page.index(sentence) < page.index("<h2>")


def test_the_page_says_what_f_overall_is_correlated_with(found, page):
    strongest, _ = fit_numbers.trade_offs(found.posterior)[0]
    assert strongest.name == "port_lap"
    assert "f_overall is correlated most with the port lap (−0." in page


def test_the_pictures_show_the_pairs_that_the_text_names_and_their_ticks_stand_apart(found, monkeypatch):
    monkeypatch.setattr(style, "png", lambda figure: figure)
    drawn = fit_figures.ridge(found.posterior)
    drawn.draw_without_rendering()
    named = [unknown for unknown, _ in fit_numbers.strongest(fit_numbers.trade_offs(found.posterior))]
    assert fit_words.hangs_on(fit_numbers.trade_offs(found.posterior)).count("(") == len(named) > 1
    panels = [panel for panel in drawn.axes if panel.get_xlabel()]
    assert [panel.get_xlabel().split(" ")[0] for panel in panels] == [one.name for one in named]
    for panel in panels:
        boxes = [one.get_window_extent() for one in panel.get_xticklabels() if one.get_text()]
        inside = sorted((box.x0, box.x1) for box in boxes)
        assert all(one[1] < other[0] for one, other in itertools.pairwise(inside)), panel.get_xlabel()


def test_the_page_counts_rows_as_the_document_does(found, page):
    told = as_json(found)["files"][0]
    assert f"Rows used: {HOSTILE}: {told['rows_used']} of {told['rows']} rows; channels" in html.unescape(page)


def test_the_suspect_reading_is_named_with_what_the_fit_expects(found, page):
    (suspect,) = fit_numbers.suspects(found)
    assert (suspect.row.row, suspect.channel, suspect.reading) == (7, "flow", 55.0)
    assert suspect.expected == pytest.approx(72.0, abs=2.0)
    assert "row 7: flow_l_min 55 is probably a bad reading" in page
    assert "and gives the reading little weight" in page


def test_remarks_name_the_suspect_and_do_not_repeat_the_recording_s_warnings(found):
    words = fit_page.remarks(found)
    assert any("row 7: flow_l_min 55" in sentence for sentence in words)
    assert found.recording.warnings
    assert not set(words) & set(found.recording.warnings)


def test_a_prior_that_dominates_is_told(found):
    assert not any("prior dominates" in words for words in fit_page.remarks(found))
    weak = with_share_of_prior(found, 0.8)
    said = "7 rows: the prior dominates f_overall. Its standard deviation is 80 % of its prior"
    assert any(words.startswith(said) for words in fit_page.remarks(weak))
    assert said in fit_page.report(weak, [])["report.html"].decode()


def test_a_fit_that_learned_nothing_has_all_of_its_prior_s_width(found):
    nothing = with_share_of_prior(found, 0.999)
    assert any("Its standard deviation is 100 % of its prior" in words for words in fit_page.remarks(nothing))


def test_a_row_or_two_leave_f_overall_to_the_prior(found):
    rows = found.measured.steady
    few = dataclasses.replace(rows, row=rows.row[:2])
    thin = dataclasses.replace(found, measured=dataclasses.replace(found.measured, steady=few))
    assert fit_words.prior_says(thin).startswith("2 rows: the prior dominates f_overall")


def test_a_speed_above_the_manufacturer_s_limit_is_told(found):
    rows = found.measured.steady
    fast = dataclasses.replace(found.measured, steady=dataclasses.replace(rows, speed=rows.speed * 2.0))
    words = fit_page.remarks(dataclasses.replace(found, measured=fast))
    assert any(re.search(r"5 rows are above the manufacturer's 600 rpm \(up to 789.6 rpm\)", one) for one in words)


def test_the_picture_ends_where_the_air_s_properties_do(found):
    rows = found.measured.steady
    high = dataclasses.replace(rows, pressure=rows.pressure + 7.98 - rows.pressure.max())
    drawn = fit_numbers.channels(dataclasses.replace(found, measured=dataclasses.replace(found.measured, steady=high)))
    assert all(one.curve.pressure_bar.max() == pytest.approx(8.0) for one in drawn)


def test_the_comparisons_stand_beside_the_fit(found, page):
    assert "<td>speed alone</td>" in page
    assert "speed alone" not in fit_page.report(found, [])["report.html"].decode()


def test_every_unknown_is_in_the_table_with_its_prior(found, page):
    for estimate in found.posterior.estimates:
        assert f"<td>{estimate.unknown.name}</td>" in page
        assert fit_words.prior_in_words(estimate.unknown) in page


def test_a_hostile_file_name_is_escaped(page):
    assert "a<b>" not in page
    assert "a&lt;b&gt;$x$.csv" in page


def test_the_page_says_where_the_recording_comes_from(page):
    (line,) = re.findall(r'<p class="origin">(.*?)</p>', page)
    assert line == ("Taken 2026-04-01; motor no. &lt;i&gt;A-17; note: &lt;/p&gt;&lt;script&gt;alert(1)&lt;/script&gt;")


def test_a_simulated_bench_is_called_one(found):
    (one,) = found.recordings
    gauge = dataclasses.replace(one.channels["pressure_bar_abs"], calibrated="none (simulated)")
    virtual = dataclasses.replace(one, channels={**one.channels, "pressure_bar_abs": gauge})
    assert origins([virtual])[0].startswith("readings of a simulated bench; taken ")
    assert origins([one])[0].startswith("taken ")


def test_the_page_needs_nothing_from_outside(page):
    links = re.findall(r"(?:src|href)\s*=\s*[\"']([^\"']*)", page)
    assert links
    assert all(link.startswith("data:image/png;base64,") for link in links)
    assert not re.search(r"@import|url\(|<script|<link", page)


def test_the_page_names_the_recording_by_its_hash_and_not_by_its_place(found, page):
    assert found.recording.sha256 in page
    assert str(found.recording.folder.parent) not in page


def test_the_bands_hold_the_readings_that_are_not_suspect(found):
    ringed = {(one.channel, one.index) for one in fit_numbers.suspects(found)}
    for channel in fit_numbers.channels(found):
        low, high = channel.at_rows.quantiles[[0, -1]]
        good = np.array([(channel.name, i) not in ringed for i in range(channel.reading.size)])
        inside = (channel.reading > low) & (channel.reading < high)
        assert inside[good].mean() >= 0.5
        assert not inside[~good].any()


def test_the_prior_s_density_integrates_to_one(found):
    for estimate in found.posterior.estimates:
        unknown = estimate.unknown
        low, high = (float(unknown.value(np.array([z]))[0]) for z in (-7.0, 7.0))
        x = np.linspace(low, high, 200_001)
        assert np.trapezoid(fit_numbers.prior_density(unknown, x), x) == pytest.approx(1.0, rel=1e-3)


@pytest.mark.parametrize(
    ("value", "sd", "text"),
    [
        (0.06386, 0.00227, "0.0639"),
        (101266.6, 800.0, "101267"),
        (-4.6e-5, 0.058, "0.000"),
        (-0.0273, 0.0187, "−0.027"),
        (1.7234e-14, 2.1e-15, "1.72·10⁻¹⁴"),  # a leak [kg/(s Pa²)]
        (-3e-16, 2.1e-15, "−0.3·10⁻¹⁵"),
        (0.0, 2.1e-15, "0"),
        (2.73456e7, 3.1e6, "2.73·10⁷"),  # a pressure rise [Pa s²/m⁶]
    ],
)
def test_a_value_is_rounded_to_what_is_known_of_it(value, sd, text):
    assert fit_words.rounded(value, sd) == text


def test_the_terminal_shows_the_figures_of_the_page(found):
    cells = [list(column.cells) for column in fit_page.table(found).columns]
    at = cells[0].index("f_overall")
    one = found.posterior["f_overall"]
    assert cells[2][at] == fit_words.rounded(one.mean, one.sd)
    assert cells[3][at] == fit_words.uncertainty(one.sd)


def test_the_page_opens_in_a_browser(files, tmp_path):
    assert browser.has_print(browser.shown(files["report.html"], tmp_path))


def test_dollars_in_a_name_are_no_mathematics():
    with style.drawing(1, 1, height_in=2.0) as (figure, axes):
        axes.plot([0.0, 1.0], [0.0, 1.0], label=style.plain(r"a$\nosuch$"))
        assert axes.legend().get_texts()[0].get_text() == r"a\$\nosuch\$"
        assert style.png(figure).startswith(b"\x89PNG")


def test_an_instruments_error_is_not_called_by_the_effect_of_the_same_name():
    _, scale = off("flow", "flow_l_min", 1.0, "L/min", 0.01)
    assert fit_words.called(scale) == "the flow meter's scale"
    assert fit_words.called(replace(scale, whose="monday")) == "the flow meter's scale in monday"
    effect = sampled("flow_scale", effects()["flow_scale"].amplitude)
    assert fit_words.called(effect).endswith(", its scale")


def test_an_effects_parameter_is_told_in_words_without_its_key_and_its_prior_as_it_is():
    leak = effects()["leakage"]
    size, shape = (in_a_fit("leakage", searched(one)) for one in leak.parameters)
    assert fit_words.called(size) == "air that does no work, its conductance"
    assert fit_words.prior_in_words(size) == fit_words.prior_in_words(sampled("leakage", leak.amplitude))
    assert fit_words.prior_in_words(size).startswith("above 0, by ")
    assert fit_words.with_unit("0.65", shape.unit) == "0.65"


def test_a_density_is_of_all_that_was_sampled(found):
    few = dataclasses.replace(found.posterior, values=found.posterior.values[:9])
    assert fit_numbers.samples(few, "f_overall").shape == (1, len(found.posterior.chain.flat()))


def test_a_table_that_is_wider_than_the_window_can_be_moved_in_it(page):
    assert page.count("<table") == page.count('<div class="wide">\n<table') > 5
