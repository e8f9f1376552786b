"""The room at the start and the end of a run: from the file, the options or the person, and never guessed."""

import pytest

from configs import ConfigError, validate
from rig.bench.bench import AmbientTable
from rig.sweep.ambient import AmbientError, Given, at_end, at_start
from tests.sweep_lab import LabBench


class Person:
    """Answers from a list, and remembers the prompts."""

    def __init__(self, *answers):
        self.answers, self.prompts = list(answers), []

    def __call__(self, prompt):
        self.prompts.append(prompt)
        if not self.answers:
            raise EOFError
        return self.answers.pop(0)


@pytest.fixture
def unknown():
    """A bench whose file says nothing of the room."""
    bench = LabBench()
    bench.file = bench.file.model_copy(update={"ambient": AmbientTable(), "lubrication": ""})
    return bench


def test_the_bench_file_and_the_options_are_not_asked_for():
    room = at_start(LabBench(), Given(minutes_running=12.0))
    assert (room.pressure_bar_abs, room.temperature_c, room.minutes_running) == (1.013, 20.0, 12.0)
    assert room.sources["pressure_bar_abs"] == "bench file"
    assert room.sources["minutes_running"] == "option"


def test_an_option_goes_before_the_bench_file():
    room = at_start(LabBench(), Given(pressure_bar_abs=0.98, minutes_running=0.0))
    assert room.pressure_bar_abs == 0.98


def test_what_nobody_said_is_asked_with_its_unit(unknown):
    person = Person("998.5", "21.5", "45", "WD-40, this morning", "20")
    room = at_start(unknown, ask=person)
    assert room.pressure_bar_abs == pytest.approx(0.9985)
    assert (room.temperature_c, room.relative_humidity) == (21.5, pytest.approx(0.45))
    assert (room.lubrication, room.minutes_running) == ("WD-40, this morning", 20.0)
    assert "[mbar;" in person.prompts[0]
    assert "[degC]" in person.prompts[1]
    assert "[%]" in person.prompts[2]


def test_an_implausible_answer_is_asked_again_with_the_reason(unknown):
    person = Person("1.013", "1013", "20", "50", "", "0")
    assert at_start(unknown, ask=person).pressure_bar_abs == pytest.approx(1.013)
    assert "1.013 mbar is not plausible (500 to 1200" in person.prompts[1]


@pytest.mark.parametrize("typed", ["1009 mbar", "1009hPa", "100.9 kPa", "1.009 bar", "14.63430 psi"])
def test_a_barometer_may_have_another_unit_that_is_typed_too(unknown, typed):
    person = Person(typed, "20", "50", "", "0")
    assert at_start(unknown, ask=person).pressure_bar_abs == pytest.approx(1.009, abs=1e-6)


def test_a_decimal_comma_is_asked_again(unknown):
    person = Person("1013,2", "1013.2", "20", "50", "", "0")
    assert at_start(unknown, ask=person).pressure_bar_abs == pytest.approx(1.0132)
    assert "not a number with a decimal point" in person.prompts[1]


def test_a_person_who_never_answers_usably_is_not_asked_for_ever(unknown):
    with pytest.raises(AmbientError, match="--ambient-pressure-bar-abs"):
        at_start(unknown, ask=Person(*["what?"] * 50))


def test_without_a_person_the_missing_options_are_all_named(unknown):
    with pytest.raises(AmbientError) as caught:
        at_start(unknown, Given(relative_humidity=0.4))
    for option in ("--ambient-pressure-bar-abs", "--ambient-temperature-c", "--lubrication", "--minutes-running"):
        assert option in str(caught.value)
    assert "--relative-humidity" not in str(caught.value)


def test_an_input_that_ends_names_the_option(unknown):
    with pytest.raises(AmbientError, match="--ambient-temperature-c"):
        at_start(unknown, ask=Person("1013"))


@pytest.mark.parametrize("given", [Given(pressure_bar_abs=1013.0), Given(relative_humidity=55.0)])
def test_an_option_in_the_wrong_unit_is_refused(given):
    with pytest.raises(AmbientError, match="expected"):
        at_start(LabBench(), given)


def test_at_the_end_only_what_was_asked_is_asked_again_and_enter_keeps_it(unknown):
    start = at_start(unknown, Given(temperature_c=20.0), Person("1013", "50", "", "5"))
    person = Person("1011", "")
    end = at_end(start, 30.0, person)
    assert end.pressure_bar_abs == pytest.approx(1.011)
    assert end.relative_humidity == start.relative_humidity
    assert end.minutes_running == 35.0
    assert len(person.prompts) == 2
    assert "Enter for 1013" in person.prompts[0]


def test_the_room_fits_the_run_s_record():
    record = at_start(LabBench(), Given(minutes_running=0.0)).record()
    assert (record.pressure_bar_abs, record.relative_humidity) == (1.013, 0.5)


def test_back_at_a_question_puts_the_one_before_once_more(unknown):
    person = Person("back", "1103", "back", "1003", "20", "50", "wrong", "back", "oil", "10")
    room = at_start(unknown, Given(), person)
    assert person.answers == []
    assert room.pressure_bar_abs == pytest.approx(1.003)
    assert (room.temperature_c, room.minutes_running) == (20.0, 10.0)
    assert ["back" in prompt for prompt in person.prompts[:4]] == [False, False, True, False]
    assert (room.lubrication, room.relative_humidity) == ("oil", 0.5)
    assert [prompt[:7] for prompt in person.prompts[:4]] == ["Ambient", "Ambient", "Room te", "Ambient"]


def test_a_bench_file_s_room_in_other_units_is_refused_with_what_it_would_be():
    with pytest.raises(ConfigError) as caught:
        validate(AmbientTable, {"pressure_bar_abs": 101.325, "temperature_c": 293.15}, "bench.toml")
    assert "(given: 101.325); 101.325 kPa is 1.01325 bar" in str(caught.value)
    assert "293.15 K is 20 degC" in str(caught.value)
