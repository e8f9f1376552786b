"""A virtual bench that conceals something: the second rig behind real bytes, its seal, and what is revealed of it."""

from __future__ import annotations

import json
import math
import os
import re
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from calibration.challenge.campaign import sealing
from calibration.challenge.concealed import revealing
from calibration.challenge.concealed.bench import (
    FAMILY,
    ConcealError,
    command,
    contents_of,
    length_s,
    opened_or_drawn,
    plant_of,
)
from calibration.challenge.second_rig import sizes
from calibration.challenge.second_rig.bench import Rig
from calibration.challenge.second_rig.concealed import USUAL, Concealed
from calibration.challenge.second_rig.live import LivePlant
from calibration.challenge.second_rig.machine import marches
from calibration.report.diagnosis.words import effect_in_words
from model.effects.library import effects
from rig.bench.bench import FOLDER, read_bench
from rig.exchange.export import export_recording, recording_of
from rig.readings import NS
from rig.recording.origin import run_bench_and_seal
from rig.run.running import Wanted, take
from rig.runlog import RunError, read_run, verify
from rig.sweep.ambient import Given
from rig.sweep.continuing import refuse_another_seal
from rig.sweep.planning import sweep_course
from rig.virtual import VirtualBenchError, launch
from rig.virtual.plant.truth import LineTruth
from spinbench import readings
from spinbench.earlier import made_of as recordings_of
from tests.documents import check
from tests.five_on_three import five_on_three
from tests.synthetic_runs import write_sweep
from tests.virtual_benches import MODBUS, bench

ROOT = Path(__file__).resolve().parents[3]
QUICK = LineTruth(regulator_lag_s=0.02, line_volume_l=0.1, valve_time_s=0.01)


def plant(*effects, line=QUICK, **nuisances):
    return LivePlant(Rig(nuisances, {}, effects), line, 293.15)


def at(level_bar, *effects, seconds=3, **more):
    made = plant(*effects, **more)
    made.order(level_bar)
    made.advance(seconds * NS)
    return made


def mean_rpm(made, span_s=2.0):
    start = made.angle_rad
    made.advance(made.time_ns + int(span_s * NS))
    return (made.angle_rad - start) / span_s * 30.0 / math.pi


def small_bench(tmp_path, more=""):
    text = (FOLDER / "virtual.toml").read_text()
    text = re.sub(r"levels_bar_abs = .*", "levels_bar_abs = [1.5, 1.9]\nzero_s = 2.0", text)
    text = text.replace("window_s = 3.0", "window_s = 2.0").replace("dwell_s = 5.0", "dwell_s = 3.0")
    text = re.sub(r"captures = .*", 'captures = ["coast-down"]', text) + more
    path = tmp_path / "small.toml"
    path.write_text(text)
    return path


def diagnosis(verdict, *ids, alternatives=(), low=0.05, high=0.07):
    return {
        "format": "diagnosis/1",
        "verdict": verdict,
        "mismatch": {"p_value": 0.01},
        "effects": [{"id": name} for name in ids],
        "alternatives": [list(names) for names in alternatives],
        "f_overall_after": {"mean": 0.06, "sd": 0.001, "q05": low, "q95": high},
    }


def test_it_turns_as_fast_as_the_second_rig_s_plateaus_do():
    made = at(2.0)
    found = marches.steady(np.array(list(Rig({}).figures().values())), np.array([made.line_bar * 1e5]))
    assert mean_rpm(made) == pytest.approx(found[0, 0] * 30.0 / math.pi, rel=3e-3)
    assert made.flow_kg_s == pytest.approx(found[0, 1], rel=5e-3)


def test_how_often_it_is_asked_does_not_change_where_it_goes():
    often, once = plant(), plant()
    for made in (often, once):
        made.order(1.9)
    for step in range(1, 700):
        often.advance(step * NS // 350)
    often.advance(2 * NS)
    once.advance(2 * NS)
    assert often.angle_rad == pytest.approx(once.angle_rad, rel=2e-3)


def test_vented_it_coasts_down_to_rest_and_nothing_passes_the_meter():
    made = at(2.0)
    made.order(0.0)
    made.advance(8 * NS)
    assert made.vented
    assert made.pressure_bar == pytest.approx(made.ambient_bar, abs=1e-6)
    assert made.speed_rpm == 0.0
    assert made.flow_kg_s == pytest.approx(0.0, abs=1e-9)


def test_a_larger_line_empties_later():
    took = []
    for volume_l in (0.1, 1.5):
        made = at(2.0, line=LineTruth(line_volume_l=volume_l, valve_time_s=0.01))
        made.order(0.0)
        start_ns = made.time_ns
        while made.pressure_bar > 1.2:
            made.advance(made.time_ns + 2_000_000)
        took.append((made.time_ns - start_ns) / NS)
    assert took[1] > 4.0 * took[0]


@pytest.mark.parametrize(
    ("effect", "reads", "expected"),
    [
        (Concealed("pressure_gauge_offset", "constant", {"offset_pa": 5000.0}), "pressure_bar", 0.05),
        (Concealed("flow_scale", "constant", {"scale": 0.2}), "flow_kg_s", 0.2),
        (Concealed("speed_scale", "constant", {"scale": 0.05}), "speed", 0.05),
    ],
)
def test_what_a_sensor_conceals_is_read_and_the_motor_knows_nothing_of_it(effect, reads, expected):
    plain, with_effect = at(2.0), at(2.0, effect)
    assert with_effect.line_bar == pytest.approx(plain.line_bar, rel=1e-9)
    if reads == "pressure_bar":
        assert with_effect.pressure_bar - plain.pressure_bar == pytest.approx(expected, rel=1e-6)
        return
    told = {"flow_kg_s": lambda made: made.flow_kg_s, "speed": mean_rpm}[reads]
    assert told(with_effect) / told(plain) == pytest.approx(1.0 + expected, rel=1e-4)


def test_what_begins_at_a_moment_counts_from_the_first_pressure():
    made = plant(Concealed("torque_from_a_moment_on", "step", {"moment_s": 6.0, "torque_nm": 0.3}))
    made.advance(20 * NS)  # a bench stands for a while before anybody looks
    made.order(2.0)
    made.advance(23 * NS)
    before = mean_rpm(made)
    made.advance(28 * NS)
    assert mean_rpm(made) < 0.95 * before


@pytest.mark.parametrize("form", ["first_order", "delay", "moving_average"])
def test_a_slow_tachometer_comes_after_the_shaft_and_counts_all_its_turns(form):
    lag = Concealed("speed_lag", form, {"time_s": 0.05})
    plain, late = plant(), plant(lag)
    for made in (plain, late):
        made.order(2.0)
        made.advance(int(0.15 * NS))
    assert late.speed_rpm < 0.9 * plain.speed_rpm
    for made in (plain, late):
        made.advance(3 * NS)
    assert plain.angle_rad - late.angle_rad == pytest.approx(0.05 * plain.speed_rpm * math.pi / 30.0, rel=0.05)


def test_a_torque_in_the_motor_slows_it_down():
    dry = Concealed("coulomb_friction", "sharp", {"torque_nm": 0.2})
    assert mean_rpm(at(2.0, dry)) < mean_rpm(at(2.0)) - 10.0


def test_the_same_seed_conceals_the_same_and_another_something_else():
    read = read_bench(Path("virtual"))
    assert contents_of(read, 1) == contents_of(read, 1)
    assert contents_of(read, 1) != contents_of(read, 2)
    assert length_s(read) < 300.0


@pytest.mark.parametrize("only", ["windage", "none", "pair", "torque_above_a_speed"])
def test_what_is_wished_for_is_concealed(only):
    truth = contents_of(read_bench(Path("virtual")), 3, only)["truth"]
    assert only in {truth["category"], *(effect["id"] for effect in truth["effects"])}


def test_what_cannot_be_concealed_is_refused_in_words():
    with pytest.raises(ConcealError, match="--only magic: no such thing"):
        contents_of(read_bench(Path("virtual")), 1, "magic")
    with pytest.raises(ConcealError, match="takes no captures"):
        contents_of(bench(MODBUS), 1, "speed_lag")  # only a run in time shows it


def test_a_bench_whose_motor_has_other_counts_than_the_second_rig_conceals_nothing(tmp_path):
    five_on_three(tmp_path)
    text = (FOLDER / "virtual.toml").read_text(encoding="utf-8").replace('"ptm3600"', '"five_on_three"')
    (tmp_path / "bench.toml").write_text(text, encoding="utf-8")
    with pytest.raises(ConcealError, match="5 pistons on 3 lobes; only a motor with 7 on 4 can conceal something"):
        opened_or_drawn(read_bench(tmp_path / "bench.toml"), tmp_path / "seal", tmp_path / "key", 1, "")
    assert not (tmp_path / "seal").exists() and not (tmp_path / "key").exists()


def test_a_bench_file_that_sets_the_motor_s_figures_cannot_conceal_any():
    contents = contents_of(read_bench(Path("virtual")), 1)
    with pytest.raises(ConcealError, match=r"virtual\.truth\.f_overall"):
        plant_of(contents, bench(MODBUS, "truth = { f_overall = 0.07 }"))
    made = plant_of(contents, bench(MODBUS, "truth = { line_volume_l = 0.77 }"))
    assert made.line.line_volume_l == 0.77


def test_the_key_lies_elsewhere(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    read, seal = read_bench(Path("virtual")), tmp_path / "seal"
    drawn = opened_or_drawn(read, seal, sealing.default_key(), 4, "")
    assert sealing.default_key() == tmp_path / "state" / "spinbench" / "conceal.key"
    assert sorted(path.name for path in seal.rglob("*") if path.is_file()) == ["hash", "truths.bin"]
    again = opened_or_drawn(read, seal, sealing.default_key(), None, "")
    assert again["truth"] == drawn["truth"]
    with pytest.raises(ConcealError, match="sealed already"):
        opened_or_drawn(read, seal, sealing.default_key(), 5, "")
    with pytest.raises(ConcealError, match="elsewhere"):
        opened_or_drawn(read, tmp_path / "other", tmp_path / "other" / "key", 4, "")
    with pytest.raises(sealing.SealError, match="--key"):
        opened_or_drawn(read, seal, tmp_path / "no.key", 4, "")


def test_a_bench_that_cannot_conceal_is_told_in_one_line(tmp_path):
    with pytest.raises(VirtualBenchError, match="no such thing can be concealed"):
        launch("virtual", server=command(tmp_path / "seal", tmp_path / "key", 1, "magic"))
    assert not (tmp_path / "seal").exists()


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """A sweep over the wire of a bench that conceals dry friction."""
    folder = tmp_path_factory.mktemp("concealed")
    path = small_bench(folder)
    seal, key = folder / "seal", folder / "keys" / "key"
    server = command(seal, key, 1, "coulomb_friction")
    made, outcome = take(
        path, Given(minutes_running=0.0), sweep_course, Wanted("sweep", folder / "logs", rate=8.0, server=server)
    )
    return folder, made, outcome, seal, key


@pytest.mark.long
def test_a_sweep_over_the_wire_finishes_and_reads_what_is_concealed(swept):
    _, made, outcome, seal, key = swept
    assert (outcome.outcome, outcome.reason) == ("finished", "")
    run = read_run(made)
    assert verify(made) == []
    contents = revealing.reveal(seal, key)
    assert run.start.seal == contents["truth_sha256"]
    note = recording_of(run).recording.origin["note"]
    assert note == f"run {run.name}, bench {run.start.bench}, seal {run.start.seal}"
    (effect,) = contents["truth"]["effects"]
    assert effect["id"] == "coulomb_friction"
    for plateau in run.plateaus:
        pressure, speed = plateau.means["pressure_bar_abs"].mean, plateau.means["speed_rpm"].mean
        if not speed:
            continue
        truth = contents["truth"]
        figures = Rig(truth["nuisances"], {}, (Concealed(**effect),)).figures()
        slow, fast = (
            marches.steady(np.array(list(figures.values())), np.array([(pressure + d) * 1e5]))[0, 0] * 30.0 / math.pi
            for d in (-0.02, 0.02)  # what the gauge is off by
        )
        assert slow < speed < fast


@pytest.mark.long
def test_a_further_test_is_refused_on_a_bench_that_conceals_something_else(swept, tmp_path, spinbench_here):
    folder, made, _, seal, key = swept
    capture = ("capture", folder / "small.toml", "--kind", "zero", "--after", made.name, "--logs", folder / "logs")
    plain = spinbench_here(*capture, "--minutes-running", 0, cwd=tmp_path)
    assert plain.returncode == 2
    assert plain.stderr.splitlines()[-1] == (
        f"spinbench: {made.name} is of a bench that conceals something; name the folder of its seal with --conceal"
    )
    other = ("--conceal", tmp_path / "other", "--key", tmp_path / "key")
    assert (
        "name the folder of its seal" in spinbench_here(*capture, *other, "--minutes-running", 0, cwd=tmp_path).stderr
    )
    assert [run.name for run in (folder / "logs").iterdir()] == [made.name]
    same = spinbench_here(*capture, "--conceal", seal, "--key", key, "--minutes-running", 0, cwd=tmp_path)
    assert same.returncode == 0, same.stderr


def test_a_run_that_does_not_say_its_seal_is_gone_on_with():
    refuse_another_seal("old", None, "f" * 64)
    refuse_another_seal("plain", "", "")
    with pytest.raises(RunError, match="leave --conceal out"):
        refuse_another_seal("plain", "", "f" * 64)


@pytest.mark.long
def test_nothing_in_the_chain_knows_what_is_concealed(swept, tmp_path):
    """With the key, and with it gone: the same bytes. Nor does a run hold the key, or a word of the truth."""
    folder, made, _, _, key = swept
    secret = key.read_bytes().strip()
    for path in made.rglob("*"):
        if path.is_file():
            text = path.read_bytes()
            assert secret not in text
            assert b"coulomb" not in text
            assert b"second_rig" not in text

    def chain(out):
        from rig.replay.replaying import bench_of_run, replay

        run = read_run(made)
        assert replay(run, bench_of_run(run)).same
        export_recording(run, out / "recording")
        environment = os.environ | {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
        command_ = [sys.executable, "-m", "spinbench", "diagnose", str(out / "recording"), "--workers", "1"]
        done = subprocess.run(
            [*command_, "--json", str(out / "diagnosis.json")], env=environment, cwd=folder, capture_output=True
        )
        told = out / "diagnosis.json"
        found = json.loads(told.read_text()) if told.exists() else {"failed": done.stderr}
        found.pop("seconds", None)
        files = {path.name: path.read_bytes() for path in (out / "recording").iterdir()}
        shutil.rmtree(out)
        return done.returncode, found, files

    with_key = chain(tmp_path / "out")
    key.rename(folder / "gone")
    try:
        without = chain(tmp_path / "out")
    finally:
        (folder / "gone").rename(key)
    assert with_key == without


@pytest.mark.parametrize(
    ("only", "said", "word"),
    [
        ("windage", diagnosis("named", "windage"), "right"),
        ("windage", diagnosis("named", "leakage"), "wrong name"),
        ("windage", diagnosis("confounded", "leakage", alternatives=[["windage"]]), "listed"),
        ("windage", diagnosis("unresolved", "unknown"), "not excluded"),
        ("windage", diagnosis("consistent"), "missed"),
        ("none", diagnosis("consistent"), "right"),
        ("none", diagnosis("named", "windage"), "false name"),
        ("none", diagnosis("unresolved", "unknown"), "false alarm"),
        ("torque_above_a_speed", diagnosis("unresolved", "unknown"), "right"),
    ],
)
def test_a_diagnosis_is_scored_in_a_word_and_in_a_sentence(only, said, word):
    contents = contents_of(read_bench(Path("virtual")), 3, only)
    scored = revealing.score(contents, said)
    assert scored["score"] == word
    assert all(sentence.endswith(".") for sentence in revealing.score_in_words(scored))


def every_form():
    """Each effect in each form that is drawn, and each that is in no list."""
    chance = np.random.default_rng(1)
    yield from (sizes.usual(name, FAMILY, False, chance) for name in USUAL)
    for name, forms in sizes.OTHER_FORMS.items():
        seen = {}
        while set(seen) != set(forms[1]):
            drawn = sizes.other(name, FAMILY, chance)
            seen[drawn.form] = drawn
        yield from seen.values()
    unlisted = {}
    while set(unlisted) != set(sizes.UNLISTED[FAMILY]):
        drawn, _ = sizes.unlisted(FAMILY, chance, True)
        unlisted[drawn.id] = drawn
    yield from unlisted.values()


@pytest.mark.parametrize("drawn", list(every_form()), ids=lambda drawn: f"{drawn.id}-{drawn.form}")
def test_what_is_revealed_has_every_figure(drawn):
    effect = {"id": drawn.id, "form": drawn.form, "values": dict(drawn.values)}
    line = {"line_volume_l": 0.5, "regulator_lag_s": 0.1, "valve_time_s": 0.01}
    told = revealing.in_words({"truth": {"effects": [effect], "f_overall": 0.06}, "line": line})[0]
    assert "{" not in told and "}" not in told and told.endswith(".")


@pytest.mark.parametrize("name", effects())
def test_what_is_diagnosed_has_every_figure(name):
    sizes_of = {one.name: {"mean": one.scale, "sd": 0.1 * one.scale} for one in effects()[name].parameters}
    told = effect_in_words({"id": name, "parameters": sizes_of}, {})
    assert "{" not in told and "}" not in told


def test_the_interval_of_f_overall_holds_the_truth_or_does_not():
    contents = contents_of(read_bench(Path("virtual")), 3, "none")
    true = contents["truth"]["f_overall"]
    held = revealing.score(contents, diagnosis("consistent", low=true - 0.001, high=true + 0.001))
    missed = revealing.score(contents, diagnosis("consistent", low=true + 0.001, high=true + 0.002))
    assert (held["f_overall"]["holds"], missed["f_overall"]["holds"]) == (True, False)
    assert "does not hold" in revealing.score_in_words(missed)[1]


@pytest.fixture
def reveal(spinbench_here, tmp_path):
    return partial(spinbench_here, "reveal", cwd=tmp_path)


def test_reveal_tells_what_was_concealed_and_scores_a_diagnosis(tmp_path, reveal):
    seal, key, told = tmp_path / "seal", tmp_path / "key", tmp_path / "diagnosis.json"
    opened_or_drawn(read_bench(Path("virtual")), seal, key, 1, "windage")
    told.write_text(json.dumps(diagnosis("named", "windage")))
    done = reveal(seal, "--key", key, "--diagnosis", told, "--json", tmp_path / "reveal.json")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("windage: A drag of ")
    assert "The diagnosis is right: it said named, and windage was concealed." in done.stdout
    revealed = json.loads((tmp_path / "reveal.json").read_text())
    check(revealed)
    assert (revealed["format"], revealed["score"]["score"]) == ("reveal/1", "right")


def of_a_recording(date="2999-01-01", note="run evening, bench virtual", folder="out/run"):
    return {"recordings": [{"folder": folder, "origin": {"date": date, "note": note}}]}


@pytest.mark.parametrize(
    ("made_of", "says"),
    [
        (of_a_recording(note="an oil; run morning, bench cellar"), "is run morning of bench cellar, and the seal"),
        (of_a_recording(date="2001-01-01"), "out/run was taken on 2001-01-01, before anything was sealed"),
    ],
)
def test_a_diagnosis_of_another_bench_or_time_is_not_scored(tmp_path, reveal, made_of, says):
    seal, key, told = tmp_path / "seal", tmp_path / "key", tmp_path / "diagnosis.json"
    opened_or_drawn(read_bench(Path("virtual")), seal, key, 1, "windage")
    told.write_text(json.dumps(diagnosis("named", "windage") | made_of))
    done = reveal(seal, "--key", key, "--diagnosis", told)
    assert done.returncode == 2 and done.stdout == ""
    assert says in done.stderr and len(done.stderr.splitlines()) == 1


def test_two_benches_of_one_name_and_day_are_told_apart_by_what_is_sealed(tmp_path, reveal):
    key, told, bench = tmp_path / "key", tmp_path / "diagnosis.json", read_bench(Path("virtual"))
    for name in ("mine", "other"):
        opened_or_drawn(bench, tmp_path / name, key, 1, "windage")
    of_mine = f"an oil; run evening, bench virtual, seal {sealing.hash_of(tmp_path / 'mine')}"
    told.write_text(json.dumps(diagnosis("named", "windage") | of_a_recording(note=of_mine)))
    done = reveal(tmp_path / "mine", "--key", key, "--diagnosis", told)
    assert done.returncode == 0
    assert done.stderr == "spinbench: out/run is run evening of bench virtual, taken with this seal\n"
    done = reveal(tmp_path / "other", "--key", key, "--diagnosis", told)
    assert (done.returncode, done.stdout) == (2, "")
    assert "out/run is run evening, which was taken with another seal; give a diagnosis" in done.stderr


@pytest.mark.parametrize(
    ("made_of", "says"),
    [
        (of_a_recording(), "out/run is run evening of bench virtual: see for yourself"),
        (of_a_recording(note="by hand"), "out/run does not say of which run it is: see for yourself"),
        ({}, "the diagnosis does not say of which run it is: see for yourself"),
    ],
)
def test_it_is_told_of_which_run_a_scored_diagnosis_is(tmp_path, reveal, made_of, says):
    seal, key, told = tmp_path / "seal", tmp_path / "key", tmp_path / "diagnosis.json"
    opened_or_drawn(read_bench(Path("virtual")), seal, key, 1, "windage")
    told.write_text(json.dumps(diagnosis("named", "windage") | made_of))
    done = reveal(seal, "--key", key, "--diagnosis", told)
    assert done.returncode == 0 and says in done.stderr
    assert reveal(seal, "--key", key, "--diagnosis", tmp_path).stdout == done.stdout  # by its folder


def test_a_diagnosis_says_of_which_run_its_recordings_are(tmp_path):
    run = write_sweep(tmp_path)
    (source,) = recordings_of(None, [readings.read(run, quiet=True)], [], tmp_path)
    assert run_bench_and_seal(source["origin"]) == (run.name, read_run(run).start.bench, "")


@pytest.mark.parametrize("wrong", ["no key", "another key", "no seal", "no diagnosis"])
def test_reveal_refuses_in_a_line(tmp_path, reveal, wrong):
    seal, key, told = tmp_path / "seal", tmp_path / "key", tmp_path / "diagnosis.json"
    opened_or_drawn(read_bench(Path("virtual")), seal, key, 1, "windage")
    told.write_text("[]" if wrong == "no diagnosis" else json.dumps(diagnosis("consistent")))
    if wrong == "another key":
        sealing.seal(tmp_path / "other", {}, tmp_path / "other.key")
        key = tmp_path / "other.key"
    elif wrong == "no key":
        key.unlink()
    elif wrong == "no seal":
        seal = tmp_path / "nothing"
    done = reveal(seal, "--key", key, "--diagnosis", told)
    assert done.returncode == 2
    assert done.stderr.startswith("spinbench: ")
    assert len(done.stderr.splitlines()) == 1
    assert done.stdout == ""
