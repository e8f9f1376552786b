"""`spinbench challenge` and `spinbench many` as a person types them: real recordings, real diagnoses and fits."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from calibration.challenge.campaign.campaign import make
from calibration.challenge.campaign.layout import read_campaign
from calibration.work import many_table
from calibration.work.many import Result
from tests import sweep_rig

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[3]
SPINBENCH = [sys.executable, "-m", "spinbench"]
LIMIT_S = 300.0


def spinbench(*words, code=0):
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "200"}
    done = subprocess.run(
        [*SPINBENCH, *map(str, words)], env=environment, capture_output=True, text=True, timeout=LIMIT_S, check=False
    )
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
    return done


@pytest.fixture
def here(spinbench_here, monkeypatch, tmp_path):
    """The same in this process."""
    monkeypatch.setenv("COLUMNS", "200")

    def run(*words, code=0):
        done = spinbench_here(*words, cwd=tmp_path)
        assert done.returncode == code, done.stderr
        return done

    return run


@pytest.fixture(scope="module")
def campaign(tmp_path_factory, spinbench_anywhere):
    """Three sweeps, diagnosed by the command; then scored."""
    folder = tmp_path_factory.mktemp("campaign") / "blind"
    make(folder, len(sweep_rig.CONCEALED), 1, "development", maker=sweep_rig.NAME, workers=0)
    away = folder.parent / "sealed"
    shutil.move(folder / "sealed", away)  # the run has to do without
    ran = spinbench("challenge", "run", folder, "--workers", 2)
    shutil.move(away, folder / "sealed")
    book = folder.parent / "ledger.jsonl"
    outputs = ("--page", folder / "page", "--keep", folder / "kept", "--json", "-")
    scored = spinbench_anywhere("challenge", "score", folder, "--ledger", book, *outputs, cwd=folder)
    assert scored.returncode == 0, scored.stderr
    return folder, ran, scored, book


@pytest.mark.slow
def test_a_campaign_of_real_recordings_is_run_without_its_seal(campaign):
    folder, ran, _, _ = campaign
    assert "3 verdicts, 0 failed" in ran.stdout
    table = pq.read_table(folder / "verdicts.parquet").to_pydict()
    assert table["name"] == read_campaign(folder).names
    assert set(table["verdict"]) <= {"consistent", "named", "confounded", "unresolved"}


@pytest.mark.slow
def test_its_score_is_published_and_in_the_ledger(campaign, here):
    folder, _, scored, book = campaign
    assert json.loads(scored.stdout)["make_up"]["single"] == 1
    assert {"result.md", "result.json", "cases.csv"} <= {path.name for path in (folder / "page").iterdir()}
    shown = here("challenge", "ledger", "--ledger", book)
    assert "2 lines, the chain holds" in shown.stdout  # opened, and scored


@pytest.mark.slow
def test_what_was_kept_of_it_gives_the_same_page(campaign, here, tmp_path):
    folder, _, scored, book = campaign
    kept = folder / "kept" / "blind.json.gz"
    pooled = here("challenge", "pool", kept, "--ledger", book, "--page", tmp_path, "--json", "-")
    assert json.loads(pooled.stdout) == json.loads(scored.stdout)
    for name in ("result.md", "result.json", "cases.csv"):
        assert (tmp_path / name).read_bytes() == (folder / "page" / name).read_bytes()
    told = here("challenge", "pool", kept, kept, "--ledger", book, code=2).stderr
    assert "given twice" in told


SEED = 25  # a warm-up and nothing, both sweeps alone


@pytest.mark.slow
def test_a_campaign_of_the_second_rig_from_the_draw_to_the_record(tmp_path, here):
    """Its verdicts are the same to the bit with the seal there and with it away, by one worker and by two."""
    open_, shut, book, kept = (tmp_path / name for name in ("open", "shut", "ledger.jsonl", "kept"))
    words = ("--cases", 2, "--seed", SEED, "--family", "development", "--key", tmp_path / "key")
    here("challenge", "make", open_ / "blind", *words)
    shutil.copytree(open_, shut)
    shutil.rmtree(shut / "blind" / "sealed")
    with_it = spinbench("challenge", "run", open_ / "blind", "--workers", 2).stdout
    without = spinbench("challenge", "run", shut / "blind", "--workers", 1).stdout
    assert with_it.split(";")[-1] == without.split(";")[-1]  # SHA-256 of the verdicts
    words = ("--key", tmp_path / "key", "--ledger", book, "--keep", kept, "--json", "-")
    told = here("challenge", "score", open_ / "blind", "--follow-ups", "--oracle", *words)
    found = json.loads(told.stdout)
    assert (found["make_up"]["single"], found["make_up"]["none"]) == (1, 1)
    assert (found["wrong_names"]["all"]["hits"], found["outcomes"]["none"]) == (0, {"right": 1})
    assert found["separable"]["not_computed"] == 0
    assert found["held_out"]["cases"] == 1 and found["held_out"]["oracle_gain"] > 0.0
    pooled = here("challenge", "pool", kept / "blind.json.gz", "--same-code", "--ledger", book, "--json", "-")
    assert json.loads(pooled.stdout) == found


@pytest.mark.slow
def test_a_broken_ledger_is_refused_in_a_sentence(campaign, here, tmp_path):
    broken = tmp_path / "ledger.jsonl"
    broken.write_bytes(campaign[3].read_bytes().replace(b'"number":1', b'"number":2'))
    told = here("challenge", "ledger", "--ledger", broken, code=2).stderr
    assert "line 1: it does not follow the line before" in told


@pytest.mark.slow
def test_many_recordings_give_one_table_and_a_bad_one_stops_none(campaign, here, tmp_path):
    fleet = tmp_path / "fleet"
    shutil.copytree(campaign[0] / "recordings" / "case0000", fleet / "good")
    shutil.copytree(campaign[0] / "recordings" / "case0000", fleet / "=bad")
    (fleet / "=bad" / "sweep.csv").unlink()
    told = here("many", "diagnose", fleet, "-o", tmp_path / "out", "--workers", 1, code=2)
    assert "=bad" in told.stderr
    table = pq.read_table(tmp_path / "out" / "table.parquet").to_pydict()
    assert [Path(name).name for name in table["recording"]] == ["=bad", "good"]
    assert table["verdict"][0] == "failed"
    assert table["verdict"][1] != "failed"
    assert len((tmp_path / "out" / "table.csv").read_text(encoding="utf-8").splitlines()) == 3


def test_a_recording_that_cannot_be_fitted_is_a_row_with_its_reason(put_recording, here, tmp_path):
    bad = put_recording(("sweep.csv", "steady", "pressure_bar_abs,flow_l_min,speed_rpm\n1.5,30,oops\n"))
    told = here("many", "fit", bad, "-o", tmp_path / "out", "--workers", 1, code=2)
    assert "oops" in told.stderr
    (row,) = pq.read_table(tmp_path / "out" / "table.parquet").to_pylist()
    assert row["error"].startswith("RecordingError")


def test_a_fit_s_row_has_every_unknown():
    one = {"unit": "N m s", "mean": 0.064, "sd": 0.002, "q05": 0.060, "q50": 0.064, "q95": 0.067}
    found = {
        "parameters": {"f_overall": one},
        "convergence": {"rhat_max": 1.001, "ess_min": 2100.0},
        "fit_quality": {"p_value": 0.0001, "model_fits": False, "why": "The torque balance does not close."},
    }
    of = {"date": "2026-05-28", "motor_serial": "PTM-7", "motor": "the motor ptm3600", "motor_sha256": "ab"}
    rows = [many_table.fit_row(Result("good", {"posterior": found, **of}, "", 9.0))]
    rows.append(many_table.fit_row(Result("bad", None, "RecordingError: no flow", 0.1)))
    table = many_table.as_csv(rows, many_table.fit_columns(rows)).decode().splitlines()
    assert table == [
        "name,date,motor_serial,motor,motor_sha256,error,seconds,p_value,model_fits,rhat_max,ess_min,"
        "f_overall_mean,f_overall_sd,f_overall_q05,f_overall_q95,f_overall_unit",
        "good,2026-05-28,PTM-7,the motor ptm3600,ab,,9.0,0.0001,False,1.001,2100.0,0.064,0.002,0.06,0.067,N m s",
        "bad,,,,,RecordingError: no flow,0.1,,,,,,,,,",
    ]


def test_a_folder_without_recordings_is_told(here, tmp_path):
    told = here("many", "diagnose", tmp_path, "-o", tmp_path / "out", code=2).stderr
    assert "neither a recording nor a folder of recordings" in told


def test_a_ledger_that_is_not_there_is_told(here, tmp_path):
    told = here("challenge", "ledger", "--ledger", tmp_path / "nowhere.jsonl", code=2)
    assert "nowhere.jsonl: there is no ledger" in told.stderr
    assert "the chain holds" not in told.stdout


@pytest.mark.parametrize(
    ("command", "option"),
    [("score", "--page"), ("score", "--keep"), ("score", "--json"), ("pool", "--page"), ("pool", "--json")],
)
def test_a_place_for_results_is_looked_at_before_anything_is_opened(here, tmp_path, command, option):
    """Else a seal would be open, and the ledger would say so, with nothing to show for it."""
    (tmp_path / "file").write_text("mine")
    told = here("challenge", command, tmp_path / "campaign", option, tmp_path / "file" / "out", code=2).stderr
    assert f"{tmp_path / 'file'}: " in told
    assert "campaign" not in told


def test_a_folder_without_a_campaign_is_told(here, tmp_path):
    assert "holds no campaign" in here("challenge", "run", tmp_path, code=2).stderr
