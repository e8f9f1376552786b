"""A filled-in sheet held to what a person at the prompt is held to, before anything is written."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from rig.bench.bench import Bench
from rig.by_hand import entry
from rig.by_hand.by_hand import faces_of, manual_device
from rig.by_hand.sheet_entry import SheetRow, plateau_of, refuse, rows_and_mistakes
from rig.instruments.codecs.values import Times, Value, reading_of
from rig.instruments.manual import decode_entry
from rig.plateaus.plateau import Plateau
from rig.readings import NS
from rig.sweep.ambient import Ambient
from rig.sweep.hooks import expecting, gauge_sd_of, guard_of

AS_READ = "if it was read so, enter the sheet with --as-read"


def checked_sheet(text: str, bench: Bench, ambient: Ambient, as_read: bool = False) -> list[SheetRow]:
    """Read a sheet, and hold every row against the bench's limits, its level and what the guard expects.

    `as_read`: what is improbable was read so, and is kept as the row's doubt; the impossible is refused even then.
    Raises SheetError: every mistake of the sheet, with row and column.
    """
    rows, mistakes = rows_and_mistakes(text, bench)
    check = _Check(bench, ambient)
    kept: list[SheetRow] = []
    for row in rows:
        impossible, doubts = check.faults(row)
        if impossible or (doubts and not as_read):
            asked = {column: f"{why}; {AS_READ}" for column, why in doubts.items() if column not in impossible}
            mistakes[row.number] = "; ".join(f"{column}: {why}" for column, why in (impossible | asked).items())
        else:
            kept.append(replace(row, doubt="; ".join(doubts.values())))
            check.take(row)
    refuse(mistakes)
    return kept


class _Check:
    """Holds the rows of a sheet, one after the other, against what is known by then."""

    def __init__(self, bench: Bench, ambient: Ambient) -> None:
        self._bench, self._ambient, self._device = bench, ambient, manual_device(bench)
        self._typed, self._faces = bench.build(self._device).channels, faces_of(bench)
        roles = bench.file.roles
        is_gauge = roles.pressure.endswith("_gauge")
        self._added_bar = ambient.pressure_bar_abs if is_gauge else 0.0
        self._expect = expecting(guard_of(bench, ambient), ambient.pressure_bar_abs, is_gauge)
        named = {role: (getattr(roles, role) or "").partition(".") for role in ("pressure", "speed")}
        self._roles = {role: name for role, (device, _, name) in named.items() if device == self._device}
        self._known: list[Plateau] = []

    def faults(self, row: SheetRow) -> tuple[dict[str, str], dict[str, str]]:
        """What cannot be in a row, and what is improbable, by column."""
        values = self._values(row.entry)
        impossible, doubts = self._of(values, row.level_bar_abs)
        if not row.after:
            return impossible, doubts
        pressure = self._roles["pressure"]
        first = values["pressure"]
        near = row.level_bar_abs if first.value is None else first.value + self._added_bar
        for_after = values | {"pressure": self._values(row.after)["pressure"]}
        for found, more in zip((impossible, doubts), self._of(for_after, near), strict=True):
            found |= {f"{pressure}_after": more[pressure]} if pressure in more else {}
        return impossible, doubts

    def take(self, row: SheetRow) -> None:
        """A row is a plateau of which the next ones are expected."""
        if row.level_bar_abs is None:
            return
        time_ns = round(row.time_s * NS)
        times = Times(time_ns, time_ns, time_ns)
        means = {}
        for role, value in self._values(row.entry).items():
            name = self._roles[role]
            means[role] = entry.mean_of_entries([reading_of(self._device, name, self._typed[name], value, times)])
        self._known.append(plateau_of(len(self._known) + 1, row, time_ns, means, self._bench, self._ambient))

    def _of(self, values: Mapping[str, Value], level_bar_abs: float | None) -> tuple[dict[str, str], dict[str, str]]:
        """`level_bar_abs`: None with the line vented."""
        safety, room = self._bench.file.safety, self._ambient.pressure_bar_abs

        def expect(bar_abs: float) -> tuple[float, float] | None:
            return (0.0, 0.0) if level_bar_abs is None else self._expect(bar_abs, self._known)

        near = room if level_bar_abs is None else level_bar_abs
        impossible = entry.impossible(values, self._added_bar, room, gauge_sd_of(self._bench), safety)
        doubts = entry.doubts(values, self._added_bar, near, safety, expect)
        if level_bar_abs is None:  # a rotor that turns at the zero is asked for, whatever the gauge shows
            impossible = {role: why for role, why in impossible.items() if role in doubts}
        return self._by_column(impossible), self._by_column(doubts)

    def _by_column(self, why: Mapping[str, str]) -> dict[str, str]:
        return {self._roles[role]: text for role, text in why.items()}

    def _values(self, text: str) -> dict[str, Value]:
        values = decode_entry(text, self._faces)
        return {role: values[name] for role, name in self._roles.items()}
