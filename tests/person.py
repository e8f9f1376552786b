"""A person who reads dials, scripted: what the tests of the manual bench type at the prompt."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from configs import FOLDER
from rig.bench.bench import Bench, read_bench


@dataclass(frozen=True)
class Dial:
    """A scale with a pointer, a float or digits.

    `lowest`, `highest`: ends of the scale; beyond them only that can be said [own unit].
    `division`: what a person reads to: a fifth of a mark, the last digit [own unit].
    `parallax_sd`: 1-sigma error of reading it from not quite the front [own unit].
    """

    lowest: float
    highest: float
    division: float
    parallax_sd: float = 0.0


# A dial gauge to 4 bar absolute with marks of 0.1, a glass rotameter to 100 L/min, a tachometer held by hand.
PRESSURE_BAR_ABS = Dial(0.0, 4.0, 0.02, 0.007)
FLOW_L_MIN = Dial(10.0, 100.0, 1.0, 0.4)
SPEED_RPM = Dial(5.0, 99_999.0, 1.0, 0.3)


def dial_in_kpa(folder: Path) -> Bench:
    """The manual bench with a dial in kPa above the room's pressure, in a folder of its own."""
    text = (FOLDER / "instruments" / "manual_bench_gauge.toml").read_text(encoding="utf-8")
    for ours, other in (('"bar"', '"kPa"'), ("highest = 6.0", "highest = 600.0"), ("= 0.0554", "= 5.54")):
        text = text.replace(ours, other, 1)
    (folder / "manual_bench.toml").write_text(text, encoding="utf-8")
    text = (FOLDER / "benches" / "manual.toml").read_text(encoding="utf-8")
    text = text.replace("person.pressure_bar_abs", "person.pressure_bar_gauge")
    (folder / "kpa.toml").write_text(text, encoding="utf-8")
    return read_bench(folder / "kpa.toml")


def read_dial(true: float, dial: Dial, chance: np.random.Generator | None = None) -> str:
    """What a person says a dial shows: a number, or ``<10`` or ``>100`` where the pointer is off the scale.

    `true`: where the pointer really is [own unit].
    `chance`: source of parallax; none when left out.
    """
    seen = true + (dial.parallax_sd * chance.standard_normal() if chance is not None else 0.0)
    decimals = max(0, math.ceil(-math.log10(dial.division) - 1e-9))
    if seen > dial.highest:
        return f">{dial.highest:.{decimals}f}"
    if seen < dial.lowest:
        return f"<{dial.lowest:.{decimals}f}"
    said = round(seen / dial.division) * dial.division + 0.0  # no -0
    return f"{said:.{decimals}f}"


def answer(
    pressure_bar: float,
    flow_l_min: float,
    speed_rpm: float,
    chance: np.random.Generator | None = None,
    dials: tuple[Dial, Dial, Dial] = (PRESSURE_BAR_ABS, FLOW_L_MIN, SPEED_RPM),
) -> str:
    """One line for one plateau, such as ``2.00 72 394``.

    `pressure_bar`: at the gauge, absolute or above ambient as its dial is [bar].
    `flow_l_min`: where the meter's float stands [L/min].
    `speed_rpm`: of the shaft [rpm].
    `chance`: source of parallax; none when left out.
    """
    pairs = zip((pressure_bar, flow_l_min, abs(speed_rpm)), dials, strict=True)
    return " ".join(read_dial(true, dial, chance) for true, dial in pairs)
