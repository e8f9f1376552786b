"""The instruments' codecs on documented bytes, and on any bytes: what is damaged never reads as good."""

import math
import re
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from configs import ConfigError
from rig.bench.instrument import FOLDER, ChannelFile, instrument_of
from rig.instruments import adam_4024, alicat, alicat_modbus, ascii, keller_30x, lutron, manual, modbus
from rig.instruments.codecs import edge_frames
from rig.instruments.codecs.blocks import Span, blocks_of
from rig.instruments.codecs.registers import WORD_ORDERS, number_of, width_of, words_of
from rig.instruments.codecs.values import Value, bounded
from rig.lines import BadReplyError
from rig.lines import modbus as wire
from rig.readings import Quality
from tests.instrument_peers import edge_bytes, lutron_bytes, read_instrument
from tests.modbus_peer import rtu

BAR = ChannelFile(unit="bar", lowest=0.0, highest=10.0)


def asked(text):
    """The registers in a documented answer, and the question that it answers."""
    question, answer = (bytes.fromhex(part) for part in text.split("->"))
    request = wire.Request(question[0], question[1], *struct.unpack(">HH", question[2:6]))
    assert wire.encode(request, "rtu", 0) == question
    return wire.decode(request, "rtu", 0, answer)


def file_of(**changes):
    """A generic Modbus file with one channel, as TOML would give it."""
    data = {"format": "instrument/1", "family": "modbus", "title": "t", "source": "s", "trust": "documented"}
    channel = {"address": 16, "type": "u16", "unit": "L/min", **changes.pop("channel", {})}
    return modbus.Settings.model_validate(data | {"channels": {"flow_l_min": channel}} | changes)


def only_block(settings):
    (block,) = settings.blocks()
    return block.first, block.count


def decoded(settings, words):
    """The values of a device that is read in one block."""
    (block,) = settings.blocks()
    return modbus.decode(settings, modbus.image_of({block: words}))


# The documents' own examples.


def test_the_keller_manual_s_answer_is_six_bar():
    words = asked("01 03 00 02 00 02 65 CB -> 01 03 04 40 C0 00 00 EF CF")
    assert keller_30x.decode((*words, 0, 0, 0, 0), ["pressure_bar_abs"])["pressure_bar_abs"] == Value(6.0, raw="6.0")


def test_the_siargo_manual_s_answer_is_20_340_litres():
    words = asked("01 03 00 3A 00 02 E4 06 -> 01 03 04 00 00 4F 74 CE 24")
    settings = read_instrument("siargo_mf5700")
    assert only_block(settings) == (0x003A, 2)
    assert decoded(settings, words)["flow_sl_min"].value == pytest.approx(20.340, abs=1e-12)


@pytest.mark.parametrize(
    ("name", "unit", "frame"),
    [
        ("red_lion_paxi", 0xF7, "F7 03 00 06 00 02 30 9C"),
        ("bronkhorst_el_flow", 1, "01 03 A1 00 00 02 E7 F7"),
        ("siargo_mf5700", 1, "01 03 00 3A 00 02 E4 06"),
    ],
)
def test_a_file_asks_the_documented_question(name, unit, frame):
    request = wire.Request(unit, wire.READ_HOLDING, *only_block(read_instrument(name)))
    assert wire.encode(request, "rtu", 0) == bytes.fromhex(frame)


def test_the_alicat_block_holds_the_documented_question():
    settings = read_instrument("alicat_pc_modbus")
    assert settings.numbering == "from 1"
    first = alicat_modbus.STATUS - 1 + alicat_modbus.PLACE_IN_BLOCK["pressure"]
    request = wire.Request(1, wire.READ_HOLDING, first, 2)
    assert wire.encode(request, "rtu", 0) == bytes.fromhex("01 03 04 B2 00 02 65 1C")


def test_the_suto_manual_s_bytes_are_read_low_word_first():
    assert number_of((0x0A11, 0x42C5), "f32", "little") == struct.unpack(">f", bytes.fromhex("42C50A11"))[0]


def test_the_lutron_manual_s_frame_is_431_0():
    frame = bytes.fromhex("02 34 31 30 38 30 31 30 30 30 30 34 33 31 30 0D")
    assert lutron.decode(frame) == lutron.Frame("1", "08", 431.0)


def test_an_alicat_frame_is_taken_apart_by_the_layout():
    fields, flags = alicat.decode("A +014.70 +025.00 +010.1 Air MOV HLD", "A", ["pressure_bar_abs", "-", "flow", "gas"])
    assert fields == {"pressure_bar_abs": "+014.70", "-": "+025.00", "flow": "+010.1", "gas": "Air"}
    assert flags == ("MOV", "HLD")


# Registers.


EITHER = st.sampled_from(["big", "little"])


@given(st.sampled_from(["u16", "i16", "u32", "i32", "u64", "i64"]), EITHER, EITHER, st.data())
def test_a_whole_number_survives_its_registers(kind, order, byte_order, data):
    bits = 16 * width_of(kind)
    low = -(2 ** (bits - 1)) if kind.startswith("i") else 0
    number = data.draw(st.integers(low, low + 2**bits - 1))
    assert number_of(words_of(number, kind, order, byte_order), kind, order, byte_order) == number


@given(st.floats(width=32, allow_nan=False), st.sampled_from(["f32", "f64"]), EITHER, EITHER)
def test_a_float_survives_its_registers(number, kind, order, byte_order):
    assert number_of(words_of(number, kind, order, byte_order), kind, order, byte_order) == number


@pytest.mark.parametrize(
    ("kind", "number", "abcd"),
    [
        ("f32", 123.456, "42f6e979"),
        ("u32", 16909060, "01020304"),
        ("i32", -2, "fffffffe"),
        ("f64", -2.5, "c004" + "00" * 6),
        ("u64", 2**63 + 1, "8000000000000001"),
        ("i64", -3, "fffffffffffffffd"),
    ],
)
@pytest.mark.parametrize("name", WORD_ORDERS)
def test_a_number_is_read_in_every_order_of_its_bytes(kind, number, abcd, name):
    """ABCD are the bytes as the standard sends them; the wire has them in the order of the name."""
    words = [abcd[i : i + 4] for i in range(0, len(abcd), 4)]
    if name in ("CDAB", "DCBA"):
        words.reverse()
    if name in ("BADC", "DCBA"):
        words = [word[2:] + word[:2] for word in words]
    read = number_of([int(word, 16) for word in words], kind, *WORD_ORDERS[name])
    assert read == (pytest.approx(number, rel=1e-7) if kind == "f32" else number)


@given(st.lists(st.integers(0, 65535), min_size=2, max_size=2), st.sampled_from(["u32", "i32", "f32"]))
def test_words_survive_the_number_they_are(words, kind):
    number = number_of(words, kind)
    assert math.isnan(number) or words_of(number, kind) == tuple(words)


SPANS = st.builds(Span, st.sampled_from(["holding", "input"]), st.integers(0, 400), st.sampled_from([1, 2, 4]))


@given(st.lists(SPANS, min_size=1, max_size=32), st.none() | st.integers(0, 125), st.integers(4, 125))
def test_blocks_hold_every_value_whole_and_no_more_than_the_device_bears(spans, largest_gap, most):
    blocks = blocks_of(spans, largest_gap, most)
    wanted = {(span.table, address) for span in spans for address in range(span.first, span.end)}
    for span in spans:
        assert any(block.holds(span) for block in blocks)
    for block in blocks:
        assert block.count <= most
        unused = "".join("x" if (block.table, i) in wanted else " " for i in range(block.first, block.end))
        assert largest_gap is None or max(map(len, re.split("x+", unused))) <= largest_gap


def test_a_number_beyond_its_registers_is_refused():
    with pytest.raises(ValueError, match="70000 does not fit a register of type u16"):
        words_of(70_000.0, "u16")


# Limits, faults and marks.


def test_a_number_that_is_none_is_a_fault():
    assert bounded(Value(math.nan), BAR).quality is Quality.EXCEPTION
    assert bounded(Value(math.nan), BAR).value is None


@pytest.mark.parametrize(("number", "limit", "side"), [(10.5, 10.0, 1), (math.inf, 10.0, 1), (-0.1, 0.0, -1)])
def test_beyond_the_scale_is_over_range_at_the_limit(number, limit, side):
    found = bounded(Value(number), BAR)
    assert (found.quality, found.value, found.censored) == (Quality.OVER_RANGE, limit, side)


def test_infinity_without_a_known_limit_has_no_value():
    found = bounded(Value(-math.inf), ChannelFile(unit="bar"))
    assert (found.quality, found.value, found.censored) == (Quality.OVER_RANGE, None, -1)


@pytest.mark.parametrize(
    ("raw", "value", "quality"),
    [
        (320, 32.0, Quality.OK),
        (64000, 100.0, Quality.OVER_RANGE),
        (64001, 2.0, Quality.OVER_RANGE),
        (65535, None, Quality.EXCEPTION),
    ],
)
def test_a_raw_number_may_stand_for_a_state(raw, value, quality):
    marks = {"over_range": [64000], "under_range": [64001], "invalid": [65535]}
    settings = file_of(channel={"scale": 0.1, "lowest": 2.0, "highest": 100.0, **marks})
    found = bounded(decoded(settings, (raw,))["flow_l_min"], settings.channels["flow_l_min"])
    assert (found.value, found.quality, found.raw) == (value, quality, str(raw))


@pytest.mark.parametrize("key", ["over_range", "under_range", "invalid"])
@pytest.mark.parametrize(
    ("kind", "number", "words"),
    [
        ("i16", 0x8000, "32768 never comes as i16; as i16 it is -32768"),
        ("i32", 0xFFFFFFFF, "never comes as i32; as i32 it is -1"),
        ("u16", -1, "-1 never comes as u16"),
        ("u16", 99999, "99999 never comes as u16"),
        ("u32", 0.5, "0.5 never comes as u32"),
        ("f32", 1e39, "never comes as f32"),
    ],
)
def test_a_state_s_number_that_the_type_cannot_hold_is_refused(key, kind, number, words):
    with pytest.raises(ValueError, match=re.escape(words)):
        file_of(channel={"type": kind, key: [number]})


@pytest.mark.parametrize(
    ("kind", "state", "data"),
    [("i16", -32768, "8000"), ("f32", -999.9, "C479F99A"), ("f32", 9999, "461C3C00"), ("u16", 65535, "FFFF")],
)
def test_a_state_s_number_is_known_as_it_comes(kind, state, data):
    settings = file_of(channel={"type": kind, "invalid": [state]})
    words = [int(data[i : i + 4], 16) for i in range(0, len(data), 4)]
    assert decoded(settings, words)["flow_l_min"].quality is Quality.EXCEPTION


def test_a_setting_of_the_device_that_the_file_does_not_expect_is_a_fault():
    settings = read_instrument("mindman_mfp01")
    words = [0] * only_block(settings)[1]
    for check in settings.expect:
        words[check.address - 5] = check.values[0]
    words[0] = 425
    assert decoded(settings, words)["flow_sl_min"].value == pytest.approx(42.5)
    words[0x000A - 5] = 1
    found = decoded(settings, words)["flow_sl_min"]
    assert (found.value, found.quality) == (None, Quality.EXCEPTION)
    assert "register 10 holds 1, not 0: reference state" in found.detail


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"most_registers": 1, "channel": {"type": "f32"}}, "channels.flow_l_min has 2 registers, and most_registers"),
        ({"channel": {"scale": 0}}, "scale is 0"),
        ({"channel": {"address": 65535, "type": "f32"}}, "beyond register 65535"),
        (
            {"setpoint": {"address": 1, "type": "u16", "unit": "bar", "lowest": 1.0, "highest": 1.0}},
            "lowest lies below",
        ),
        (
            {"setpoint": {"address": 65535, "type": "f32", "unit": "bar abs", "lowest": 0.0, "highest": 5.0}},
            "it reaches beyond register 65535",
        ),
        ({"channel": {"over_range": [64000], "invalid": [64000]}}, "64000 stands in two of them"),
    ],
)
def test_a_modbus_file_that_makes_no_sense_is_refused(changes, words):
    with pytest.raises(ValueError, match=re.escape(words)):
        file_of(**changes)


# Alicat.


@pytest.mark.parametrize(
    ("flags", "pressure", "flow"),
    [
        ("", Quality.OK, Quality.OK),
        ("HLD LCK", Quality.OK, Quality.OK),
        ("POV", Quality.OVER_RANGE, Quality.OK),
        ("MOV", Quality.OK, Quality.OVER_RANGE),
        ("TOV OVR", Quality.OK, Quality.OK),
        ("ADC", Quality.EXCEPTION, Quality.EXCEPTION),
        ("EXH MOV", Quality.EXCEPTION, Quality.EXCEPTION),
        ("TMF OPL P2O", Quality.OK, Quality.OK),
        ("XYZ", Quality.UNVERIFIED, Quality.UNVERIFIED),
        ("XYZ MOV", Quality.UNVERIFIED, Quality.OVER_RANGE),
    ],
)
def test_an_alicat_flag_marks_what_it_speaks_of_and_is_never_dropped(flags, pressure, flow):
    numbers = {"pressure_bar_abs": 2.0, "flow_sl_min": 99.0}
    found = alicat.judge(numbers, dict.fromkeys(numbers, "raw"), flags.split())
    assert (found["pressure_bar_abs"].quality, found["flow_sl_min"].quality) == (pressure, flow)
    assert all(value.detail == flags for value in found.values())


def test_where_alicat_shows_dashes_that_channel_alone_has_no_value():
    fields, flags = alicat.decode("A --.-- +99.0 TMF", "A", ["pressure_bar_abs", "flow_sl_min"])
    assert (fields["pressure_bar_abs"], fields["flow_sl_min"], flags) == ("--.--", "+99.0", ("TMF",))
    found = alicat.judge({"pressure_bar_abs": float("nan"), "flow_sl_min": 99.0}, fields, flags)
    assert (found["pressure_bar_abs"].value, found["pressure_bar_abs"].quality) == (None, Quality.EXCEPTION)
    assert (found["flow_sl_min"].value, found["flow_sl_min"].quality) == (99.0, Quality.OK)


def test_an_over_range_alicat_value_is_kept_as_a_limit():
    found = alicat.judge({"flow_sl_min": 99.0}, {"flow_sl_min": "+099.00"}, ["MOV"])["flow_sl_min"]
    assert (found.value, found.censored) == (99.0, 1)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("B +1.0 +1.0", "not from unit A"),
        ("A +1.0", "has 1 fields"),
        ("A +1.0 +1.0 +2.0", "'+2.0' is no flag"),
        ("A +1.0 --.--", "'--.--' stands where the layout has setpoint"),
        ("A +1.0 Air", "'Air' stands where the layout has setpoint"),
        ("", "not from unit A"),
    ],
)
def test_what_is_no_alicat_frame_is_damaged(text, words):
    with pytest.raises(BadReplyError, match=re.escape(words)):
        alicat.decode(text, "A", ["pressure_bar_abs", "setpoint"])


def test_an_alicat_question_mark_is_a_refusal():
    with pytest.raises(BadReplyError, match="unit A refuses") as refused:
        alicat.decode("A ?", "A", ["pressure_bar_abs"])
    assert refused.value.quality is Quality.EXCEPTION


@pytest.mark.parametrize(
    ("bits", "flags"),
    [
        (0, []),
        (1 << 6, ["POV"]),
        (1 << 4 | 1 << 5, ["MOV"]),
        (1 << 9 | 1 << 8, ["HLD", "ADC"]),
        (1 << 11 | 1 << 12, ["OPL", "TMF"]),
        (1 << 13, ["measurement aborted"]),
        (1 << 20, ["status bit 20"]),
    ],
)
def test_alicat_status_bits_have_the_flags_names(bits, flags):
    assert alicat_modbus.flags_of(bits) == flags


@pytest.mark.parametrize(("bits", "quality"), [(1 << 11 | 1 << 12, Quality.OK), (1 << 13, Quality.EXCEPTION)])
def test_a_pressure_limit_and_a_lost_total_cost_no_reading_and_an_aborted_measurement_does(bits, quality):
    words = (0, bits, *words_of(2.0, "f32"), *[0] * 6)
    found = alicat_modbus.decode(words, read_instrument("alicat_pc_modbus").channels)["pressure_bar_abs"]
    assert found.quality is quality


@pytest.mark.parametrize(
    ("word", "is_flag"), [("VALVE", True), ("1ST", True), ("P2O", True), ("Air", False), ("12", False)]
)
def test_a_word_of_capitals_after_the_numbers_is_a_flag_known_or_not(word, is_flag):
    text = f"A +1.0 +2.0 {word}"
    if is_flag:
        assert alicat.decode(text, "A", ["pressure_bar_abs", "setpoint"])[1] == (word,)
    else:
        with pytest.raises(BadReplyError, match="is no flag; is the layout the device's own"):
            alicat.decode(text, "A", ["pressure_bar_abs", "setpoint"])


@pytest.mark.parametrize(("gas", "taken"), [("User_1", True), ("N2/O2-20%", True), ("H2*", True), ("0001.23", False)])
def test_a_gas_may_have_any_name_that_is_no_number(gas, taken):
    if taken:
        assert alicat.decode(f"A +1.0 {gas}", "A", ["pressure_bar_abs", "gas"])[0]["gas"] == gas
    else:
        with pytest.raises(BadReplyError, match="stands where the layout has gas"):
            alicat.decode(f"A +1.0 {gas}", "A", ["pressure_bar_abs", "gas"])


def test_an_alicat_status_bit_that_nobody_knows_is_a_fault():
    settings = read_instrument("alicat_pc_modbus")
    words = (1 << 4, 0, *words_of(2.0, "f32"), *[0] * 6)  # bit 20
    found = alicat_modbus.decode(words, settings.channels)["pressure_bar_abs"]
    assert (found.value, found.quality, found.detail) == (None, Quality.EXCEPTION, "status bit 20")


@given(st.text(st.characters(max_codepoint=255), max_size=60))
def test_no_text_does_more_to_the_alicat_codec_than_be_refused(text):
    try:
        fields, _ = alicat.decode(text, "A", ["pressure_bar_abs", "setpoint"])
    except BadReplyError:
        return
    assert all(math.isfinite(float(field)) for field in fields.values())


def test_the_coils_of_the_modbus_specification_s_example():
    request = wire.Request(0x11, wire.READ_COILS, 0x13, 0x13)
    assert wire.encode(request, "rtu", 0) == rtu(bytes.fromhex("11 01 00 13 00 13"))
    found = wire.decode(request, "rtu", 0, rtu(bytes.fromhex("11 01 03 CD 6B 05")))
    assert "".join(map(str, found)) == "1011001111010110101"  # 27 to 20 are CD, the first coil its lowest bit


@pytest.mark.parametrize(
    ("code", "words"), [(6, "wait until it has started"), (10, "the gateway"), (11, "the gateway")]
)
def test_what_to_do_about_a_busy_device_depends_on_who_says_so(code, words):
    request = wire.Request(1, wire.READ_HOLDING, 0)
    with pytest.raises(wire.RefusedError) as refused:
        wire.decode(request, "rtu", 0, rtu(bytes([1, 0x83, code])))
    assert refused.value.is_busy
    assert words in refused.value.while_busy


# Generic text.


def text_file(**changes):
    data = {"format": "instrument/1", "family": "ascii", "title": "t", "source": "s", "trust": "documented"}
    data |= {
        "query": "?\r",
        "pattern": r"(?P<speed_rpm>[+-]? {0,4}\S{1,12}) rpm",
        "channels": {"speed_rpm": {"unit": "rpm"}},
    }
    return ascii.Settings.model_validate(data | changes)


def decode_text(line, **channel):
    settings = text_file(channels={"speed_rpm": {"unit": "rpm", **channel}})
    return ascii.decode(line, re.compile(settings.pattern), settings.channels)["speed_rpm"]


def test_a_named_group_is_a_channel():
    assert decode_text(b"394.8 rpm") == Value(394.8, raw="394.8")


@pytest.mark.parametrize(
    "line", [b"394.8 rpm ", b"x394.8 rp", b"", b"\xff\xfe rpm", b"3,9 rpm", b"nan rpm", b"0x10 rpm"]
)
def test_a_line_of_another_form_is_damaged(line):
    with pytest.raises(BadReplyError):
        decode_text(line)


def test_a_word_may_stand_for_over_range():
    assert decode_text(b"OL rpm", over_range=["OL"]).value == math.inf


def test_a_word_may_stand_for_under_range_or_a_fault():
    marks = {"under_range": ["UR"], "invalid": ["Err"]}
    assert decode_text(b"UR rpm", **marks).value == -math.inf
    assert decode_text(b"UR rpm", **marks, scale=-1.0).value == math.inf
    fault = decode_text(b"Err rpm", **marks)
    assert (fault.value, fault.quality, fault.detail) == (None, Quality.EXCEPTION, "the device reports a fault: 'Err'")


@pytest.mark.parametrize(("number", "quality"), [("9.9E37", Quality.OVER_RANGE), ("-9.9e+37", Quality.OVER_RANGE)])
def test_scpi_s_overload_is_over_range_without_a_highest(number, quality):
    found = bounded(decode_text(f"{number} rpm".encode()), ChannelFile(unit="rpm"))
    assert (found.value, found.quality, found.censored) == (None, quality, -1 if number.startswith("-") else 1)


@pytest.mark.parametrize("number", ["9.91E37", "9.91e+37", "+9.91E37"])
def test_scpi_s_not_a_number_is_a_fault(number):
    found = bounded(decode_text(f"{number} rpm".encode()), ChannelFile(unit="rpm"))
    assert (found.value, found.quality) == (None, Quality.EXCEPTION)


def test_a_sign_may_stand_apart_from_its_number():
    assert decode_text(b"-   12.34 rpm", scale=2.0).value == pytest.approx(-24.68)


def test_an_exponent_may_have_three_digits():
    assert decode_text(b"-1.234E+002 rpm").value == pytest.approx(-123.4)


@pytest.mark.parametrize("place", [0, 2])
@pytest.mark.parametrize("bit", range(8))
def test_a_digit_at_either_end_that_lost_a_bit_is_never_left_out(place, bit):
    damaged = bytearray(b"313\r")
    damaged[place] ^= 1 << bit
    channels = {"speed_rpm": ascii.TextChannel(unit="rpm")}
    try:
        value = ascii.decode(bytes(damaged), re.compile(r"(?P<speed_rpm>[+-]?\d{1,7})"), channels)["speed_rpm"].value
    except BadReplyError:
        return
    assert value >= 100.0


GAUGE_AND_METER = {"pressure_kpa": ascii.TextChannel(unit="kPa"), "flow_l_min": ascii.TextChannel(unit="L/min")}


@pytest.mark.parametrize(
    ("pattern", "line", "decimal"),
    [
        (r"(?P<pressure_kpa>\S+) (?P<flow_l_min>\S+)", "--.-- 72.5", "."),
        (r"p=(?P<pressure_kpa>[+-]?\d{3}\.\d) q=(?P<flow_l_min>[+-]?\d+\.\d)", "p=+---.- q=72.5\0", "."),
        (r"(?P<flow_l_min>\d+\.\d) (?P<pressure_kpa>[+-]\d+\.\d)", "\x0272.5 ---.-\x03\r", "."),
        (r"(?P<flow_l_min>\d+,\d);(?P<pressure_kpa>\d+,\d+)", "72,5;---,--", ","),
    ],
)
def test_dashes_in_a_number_s_place_cost_that_channel_and_no_other(pattern, line, decimal):
    found = ascii.decode(line.encode(), re.compile(pattern), GAUGE_AND_METER, decimal)
    assert found["flow_l_min"] == Value(72.5, raw=line[line.index("72") :][:4])
    shown = found["pressure_kpa"]
    assert (shown.value, shown.quality, shown.detail) == (None, Quality.EXCEPTION, "the device shows no number")


def test_a_word_that_the_file_does_not_know_costs_its_channel_and_no_other():
    pattern = re.compile(r"(?P<pressure_kpa>\S+) (?P<flow_l_min>\S+)")
    found = ascii.decode(b"OPEN 72.5", pattern, GAUGE_AND_METER)
    assert found["flow_l_min"].value == 72.5
    shown = found["pressure_kpa"]
    assert (shown.value, shown.quality, shown.raw) == (None, Quality.EXCEPTION, "OPEN")
    assert shown.detail == "the device shows 'OPEN' in place of a number"
    with pytest.raises(BadReplyError, match="'OPEN ERR' has no number, nor a word that the file knows"):
        ascii.decode(b"OPEN ERR", pattern, GAUGE_AND_METER)
    with pytest.raises(BadReplyError, match="'1;3' in the reply is not a number"):
        ascii.decode(b"1;3 72.5", pattern, GAUGE_AND_METER)


@pytest.mark.parametrize(
    ("number", "value"), [("101,325", 101.325), ("-1,5E-1", -0.15), ("+ 7", 7.0), ("12", 12.0), (",5", 0.5)]
)
def test_decimals_after_a_comma_are_read_where_the_file_says_so(number, value):
    pattern = re.compile(r"(?P<p>.+) kPa")
    found = ascii.decode(f"{number} kPa".encode(), pattern, {"p": ascii.TextChannel(unit="kPa")}, ",")
    assert found["p"].value == pytest.approx(value)


@pytest.mark.parametrize("pattern", [r"(?P<p>.+) kPa", r"(?P<p>\d+{mark}\d+) kPa"])
@pytest.mark.parametrize(("decimal", "other", "word"), [(".", ",", "comma"), (",", ".", "point")])
def test_the_other_decimal_mark_is_refused_with_the_key_that_takes_it(pattern, decimal, other, word):
    mark = re.escape(decimal)
    with pytest.raises(ascii.DecimalMarkError, match=rf'has a {word} where .* write decimal = "\{other}" in the'):
        ascii.decode(
            f"101{other}3 kPa".encode(),
            re.compile(pattern.replace("{mark}", mark)),
            {"p": ascii.TextChannel(unit="kPa")},
            decimal,
        )


@pytest.mark.parametrize("number", ["1.234,5", "1,234.5", "1,234,567", "1..2", ",", "."])
@pytest.mark.parametrize("decimal", [".", ","])
def test_thousands_that_are_marked_off_are_no_number(number, decimal):
    with pytest.raises(BadReplyError, match="is not a number") as refused:
        ascii.decode(
            f"{number} kPa".encode(), re.compile(r"(?P<p>.+) kPa"), {"p": ascii.TextChannel(unit="kPa")}, decimal
        )
    assert not isinstance(refused.value, ascii.DecimalMarkError)


@given(st.binary(max_size=80))
def test_no_bytes_do_more_to_the_text_codec_than_be_refused(line):
    try:
        value = decode_text(line)
    except BadReplyError:
        return
    assert math.isfinite(value.value)


@pytest.mark.parametrize(
    ("pattern", "words"),
    [
        (r"(?P<speed_rpm>\d+", "not a regular expression"),
        (r"(?P<speed_rpm>(\d+)+)", "could take forever"),
        (r"(?P<speed_rpm>.*.*.*.*.*)", "could take forever"),
        (r"(?P<speed_rpm>(a|a){2,90})(?P=speed_rpm)", "could take forever"),
        (r"(?P<flow>\d+)", "its named groups are"),
    ],
)
def test_a_pattern_that_cannot_be_used_is_refused(pattern, words):
    with pytest.raises(ValueError, match=words):
        text_file(pattern=pattern)


@pytest.mark.parametrize(
    "pattern", [r"(?P<speed_rpm>[+-]?\d{1,9}(\.\d*)?) *\w+", r"(?P<speed_rpm>\S++) .*+.*+.*+.*+.*+"]
)
def test_a_pattern_that_ends_soon_is_taken(pattern):
    assert text_file(pattern=pattern).pattern == pattern


# Lutron.


@given(
    st.sampled_from("1234"),
    st.from_regex(r"[0-9]{2}", fullmatch=True),
    st.integers(0, 99_999_999),
    st.booleans(),
    st.integers(0, 3),
)
def test_a_lutron_frame_survives(display, unit_code, digits, negative, decimals):
    frame = lutron.Frame(display, unit_code, digits / 10**decimals * (-1 if negative else 1))
    assert lutron.decode(lutron_bytes(frame, decimals)) == frame


@given(st.binary(max_size=40), st.binary(max_size=15))
def test_a_lutron_frame_is_found_in_noise(before, after):
    frame = lutron_bytes(lutron.Frame("1", "08", 431.0), 1)
    frames, rest = lutron.cut(before.replace(b"\x02", b"") + frame + after.replace(b"\x02", b""))
    assert (frames, rest) == ([frame], b"")


@given(st.binary(max_size=100))
def test_any_bytes_may_come_to_the_lutron_codec(noise):
    frames, rest = lutron.cut(noise)
    assert all(math.isfinite(lutron.decode(frame).value) for frame in frames)
    assert len(rest) < lutron.FRAME_BYTES


@pytest.mark.parametrize("place", [0, 1, 5, 6, 10, 15])
def test_a_damaged_lutron_byte_is_no_frame(place):
    frame = bytearray(lutron_bytes(lutron.Frame("1", "08", 431.0), 1))
    frame[place] ^= 0x40
    assert lutron.cut(bytes(frame))[0] == []


# Analogue output.


def test_counts_and_set_point_span_the_range():
    output = adam_4024.Range(code=0x32, name="0-10 V", low_counts=2048, high_counts=4095)
    assert [adam_4024.counts_of(value, (0.0, 5.0), output) for value in (0.0, 2.5, 5.0)] == [2048, 3072, 4095]
    assert adam_4024.value_of(4095, (0.0, 5.0), output) == 5.0


@given(st.floats(0.0, 5.0))
def test_a_set_point_survives_its_counts_within_half_a_count(value):
    output = adam_4024.Range(code=0x31, name="4-20 mA", low_counts=0, high_counts=4095)
    held = adam_4024.value_of(adam_4024.counts_of(value, (0.0, 5.0), output), (0.0, 5.0), output)
    assert abs(held - value) <= 0.5001 * 5.0 / 4095


# Edge frames.

FRAMES = st.builds(
    edge_frames.Frame,
    st.sampled_from([edge_frames.EDGE, edge_frames.HEARTBEAT]),
    st.integers(0, 255),
    st.integers(0, 7),
    st.integers(0, 2**32 - 1),
    st.integers(0, 255),
)


def test_the_check_value_of_the_crc_is_the_catalogue_s():
    assert edge_frames.crc8(b"123456789") == 0xF4


@given(st.lists(FRAMES, max_size=5), st.binary(max_size=9))
def test_edge_frames_survive_and_what_is_half_there_waits(frames, tail):
    tail = tail.replace(b"\xa5", b"\x00")[:9]
    found, rest, skipped = edge_frames.cut(b"".join(map(edge_bytes, frames)) + tail)
    assert (found, rest, skipped) == (frames, tail, 0)


@given(FRAMES, st.integers(0, 79))
def test_one_wrong_bit_is_no_edge_frame(frame, bit):
    data = bytearray(edge_bytes(frame))
    data[bit // 8] ^= 1 << bit % 8
    assert edge_frames.cut(bytes(data))[0] == []


@given(FRAMES, st.integers(1, 0xFFFFFFFF), st.integers(0, 255))
def test_ticks_and_edges_are_carried_on_over_their_wraps(frame, ticks, steps):
    counting = edge_frames.Counting()
    counting.take(frame)
    total = 0
    for step in range(1, steps % 5 + 1):
        total += ticks % (1 << 20)
        mark = counting.take(
            edge_frames.Frame(
                edge_frames.EDGE,
                (frame.sequence + step) & 0xFF,
                0,
                (frame.ticks + total) & 0xFFFFFFFF,
                (frame.edges + step) & 0xFF,
            )
        )
        assert (mark.ticks, mark.edges, mark.fault) == (total, step, "")


# Entries by hand.

COLUMNS = {
    "pressure_bar_abs": ChannelFile(unit="bar", lowest=0.0, highest=6.0),
    "flow_l_min": ChannelFile(unit="L/min", lowest=10.0, highest=100.0),
    "speed_rpm": ChannelFile(unit="rpm"),
}


def test_an_entry_is_one_line():
    found = manual.decode_entry("  2.00 72\t394 \n", COLUMNS)
    assert [value.value for value in found.values()] == [2.0, 72.0, 394.0]
    assert {value.quality for value in found.values()} == {Quality.MANUAL}
    assert found["pressure_bar_abs"].raw == "2.00"


@pytest.mark.parametrize(("word", "value", "side"), [("<10", 10.0, -1), (">100", 100.0, 1)])
def test_off_the_scale_is_a_limit(word, value, side):
    found = manual.decode_entry(f"2.00 {word} 394", COLUMNS)["flow_l_min"]
    assert (found.value, found.censored, found.quality) == (value, side, Quality.MANUAL)


FACES = {
    "pressure_bar_gauge": ChannelFile(unit="kPa", lowest=0.0, highest=600.0),
    "flow_l_min": ChannelFile(unit="m3/h", lowest=0.6, highest=6.0),
}


def test_a_person_is_asked_for_what_stands_on_the_faces_and_it_becomes_the_columns_unit():
    assert manual.example(FACES) == "pressure [kPa gauge], flow [m3/h], separated by spaces"
    pressure, flow = manual.decode_entry("180 <0.6", FACES).values()
    assert (pressure.value, pressure.raw, pressure.detail) == (pytest.approx(1.8), "180", "typed in kPa")
    assert (flow.value, flow.censored) == (pytest.approx(10.0), -1)
    with pytest.raises(manual.EntryError, match="601 kPa is above the scale; type >600"):
        manual.decode_entry("601 3", FACES)


def test_a_dash_is_a_gap():
    assert manual.decode_entry("2.00 - 394", COLUMNS)["flow_l_min"].value is None


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("2,00 72 394", "pressure_bar_abs: '2,00' has a comma; write the decimals after a dot"),
        ("2.00 72", "2 entries where there are 3 columns"),
        ("2.00 72 394 1", "4 entries"),
        ("2.00bar 72 394", "not a number alone; the unit is bar"),
        ("2.00 5 394", "below the scale; type <10 if it reads less"),
        ("2.00 101 394", "above the scale; type >100"),
        ("2.00 72 1e3", "not a number alone"),
        ("2.00 72 nan", "not a number alone"),
        ("2.00 72 ٣", r"not a number alone"),
        ("", "0 entries"),
        ("1 " * 150, "300 characters"),
    ],
)
def test_an_entry_in_doubt_is_refused_with_what_to_type(line, words):
    with pytest.raises(manual.EntryError, match=re.escape(words)):
        manual.decode_entry(line, COLUMNS)


@given(st.text(max_size=60))
def test_no_line_does_more_to_the_entry_codec_than_be_refused(line):
    try:
        found = manual.decode_entry(line, COLUMNS)
    except manual.EntryError:
        return
    assert all(value.value is None or math.isfinite(value.value) for value in found.values())


# Files.


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("keller_30x_abs", ("[channels.temperature_c]", "[channels.temp]"), "channels.temp: a Keller 30X has"),
        ("edge_counter_20", ("teeth = 20", "teeth = 0"), "'teeth'"),
        ("adam_4024_regulator", ("code = 0x30", "code = 0x31"), "the same code stands twice"),
        ("adam_4024_regulator", ("low_counts = ", "low_counts = 10000\n#"), "low_counts lies below high_counts"),
        (
            "alicat_pc_modbus",
            ("[channels.pressure_bar_abs]", "[channels.speed_hz]"),
            "channels.speed_hz: the names begin",
        ),
        ("alicat_pc_ascii", ('"setpoint"]', '"-"]'), "layout: it holds pressure_bar_abs where"),
        ("alicat_pc_modbus", ('numbering = "from 1"\n', ""), "the key 'numbering' is missing"),
        ("manual_bench", ('"speed_rpm"]', '"speed"]'), "columns: "),
        ("siargo_mf5700", ("address = 0x003A", "register = 0x003A"), "unknown key 'channels.flow_sl_min.register'"),
        ("lutron_tachometer", ('display = "1"', 'display = "12"'), "display"),
        ("alicat_pc_ascii", ("scale = 1.0 ", "scale = 0.0 "), "a channel's scale is 0"),
        ("monarch_act3x", ("resolution = 0.1", "scale = 0.0"), "a channel's scale is 0"),
        ("monarch_act3x", ("resolution = 0.1", 'over_range = ["OL"]\ninvalid = ["OL"]'), "OL stands in two of them"),
        ("lutron_tachometer", ('display = "1"', 'display = "1"\nscale = 0'), "a channel's scale is 0"),
        ("siargo_mf5700", ("pressure_bar_abs = 1.01325", "pressure_bar_abs = 101325"), "101325 Pa is 1.01325 bar"),
        ("siargo_mf5700", ("temperature_c = 20.0", "temperature_c = 273.15"), "273.15 K is 0 degC"),
        ("alicat_pc_ascii", ("lowest = 0.0\nhighest = 7.0\n", "lowest = 7.0\nhighest = 7.0\n"), "highest"),
        ("monarch_act3x", ("(?P<speed_rpm>", "(?P<speed>"), "its named groups are ['speed']"),
        ("monarch_act3x", ('refusals = ["ERR"]', 'identity_query = "@PI"'), "identity_query and identity_pattern"),
        (
            "monarch_act3x",
            ('refusals = ["ERR"]', "identity_query = '@PI'\nidentity_pattern = '(?P<maker>\\w{1,9})'"),
            "the one named group it may have is 'serial'",
        ),
        (
            "keller_30x_abs",
            ("[channels.temperature_c]", '[channels.pressure_bar_gauge]\nunit = "bar"\n[channels.temperature_c]'),
            "P1 is either absolute or gauge, not both",
        ),
        (
            "lutron_tachometer",
            ("[channels.speed_rpm]", "[channels.temperature_c]\nunit = 'degC'\ndisplay = '1'\n[channels.speed_rpm]"),
            "two of them name the same display",
        ),
    ],
)
def test_a_mistake_in_an_instrument_s_file_is_told_in_a_line(name, change, words):
    text = (FOLDER / f"{name}.toml").read_text(encoding="utf-8")
    assert change[0] in text
    with pytest.raises(ConfigError, match=re.escape(words)):
        instrument_of(text.replace(*change).encode(), name)
