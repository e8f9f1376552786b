"""What is wrong with a bench file beyond single keys: lines, addresses and roles that cannot be.

Each gives the mistakes as lines of text, without the file's name. `now` is asked of a file that is about to be used: a
run that was recorded with such a bench is still read.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from configs import ConfigError, close_to, names

if TYPE_CHECKING:
    from rig.bench.bench import Bench, BenchFile

ENDS_OF_ROLES = {
    "pressure": ("_bar_abs", "_bar_gauge"),
    "speed": ("_rpm",),
    "flow": ("l_min",),
    "temperature": ("_c",),
}
LEAST_READINGS = 5  # in the window, to judge whether a level has settled
FILLED = 0.8  # of the window that has to lie between the first and the last of them
LOWEST_ROOM_BAR = 0.5  # bar abs, of [ambient]
VIRTUAL, DERIVED = "virtual", "derived"  # a port of the virtual bench; what the log calls channels that are computed


def meant(name: str, kind: str) -> str:
    """Which file of the project, or that is shipped, a name may be meant for, or which there are."""
    known = names(kind)
    close = close_to(name, known)
    return f"; did you mean '{close}'?" if close else f"; known here: {', '.join(known)}"


def no_instrument(name: str, folder: Path) -> str:
    """That there is no instrument file of a name, in the folder of the shipped ones or elsewhere."""
    if name.endswith(".toml") or "/" in name:
        shipped = Path(name).name.removesuffix(".toml")
        is_shipped = (folder / f"{shipped}.toml").is_file()
        also = f"; the shipped one is '{shipped}', without folder and ending" if is_shipped else ""
        return f"there is no file '{name}', counted from the bench file's folder{also}"
    return (
        f"there is no '{name}' in configs/instruments, nor '{name}.toml' beside the bench file or in the project"
        f"{meant(name, folder.name)}"
    )


def now(bench: Bench) -> list[str]:
    """What a bench is not used with."""
    return [
        *_other_quantities(bench),
        *_unreferenced_flow(bench),
        *_shared_ports(bench.file),
        *_no_vent(bench),
        *_nobody_asked(bench.file),
        *_times(bench.file),
    ]


def _times(file: BenchFile) -> list[str]:
    """Times that go together with no plateau that settles."""
    sweep, mistakes = file.sweep, []
    if any(line.kind == "keyboard" for line in file.lines.values()):
        return []  # a person's readings come when they come
    if FILLED * sweep.window_s > sweep.settle_timeout_s:
        mistakes.append(
            f"sweep.window_s = {sweep.window_s:g} and sweep.settle_timeout_s = {sweep.settle_timeout_s:g}: no level "
            "could settle before it is given up; make the window shorter, or the other longer"
        )
    for device in dict.fromkeys(name.partition(".")[0] for name in (file.roles.pressure, file.roles.speed)):
        table = file.devices.get(device)
        if table is not None and (LEAST_READINGS - 1) * table.period_s > sweep.window_s:
            mistakes.append(
                f"devices.{device}.period_s = {table.period_s:g} and sweep.window_s = {sweep.window_s:g}: "
                f"{LEAST_READINGS} readings are needed in the window, to see that a level has settled, and they cannot "
                "come; make the period shorter, or the window longer"
            )
    return mistakes


def _no_vent(bench: Bench) -> list[str]:
    """A regulator that cannot be ordered to give no pressure, or of which that is not known."""
    device = bench.file.roles.regulator
    if device is None:
        return []
    driver = bench.regulator(device)
    most = {"bar gauge": 0.0, "bar abs": LOWEST_ROOM_BAR}.get(driver.unit)
    if most is None:
        return [
            f"roles.regulator: the set-point of '{device}' is in '{driver.unit}'; a sweep needs bar gauge or bar abs: "
            "scale the numbers, and write one of them as its unit"
        ]
    if driver.lowest <= most:
        return []
    return [
        f"roles.regulator: '{device}' takes no less than {driver.lowest:g} {driver.unit}, so that it cannot be ordered "
        f"to give no pressure; its lowest is {most:g} or less"
    ]


def _nobody_asked(file: BenchFile) -> list[str]:
    """What a person would read while a regulator makes the run: such a run asks nobody."""
    if file.roles.regulator is None:
        return []
    return [
        f"roles.{role}: a person reads '{name}', and nobody is asked while a regulator makes the run; name an "
        "instrument that reads itself, or take roles.regulator out, and the person sets the pressure too"
        for role, name in file.roles
        if name is not None and file.lines[file.devices[name.partition(".")[0]].line].kind == "keyboard"
    ]


def _shared_ports(file: BenchFile) -> list[str]:
    """Two lines of one serial port: one of them would not open."""
    mistakes = []
    seen: dict[str, str] = {}
    for name, line in file.lines.items():
        if line.kind != "serial" or line.port == VIRTUAL:
            continue
        other = seen.setdefault(os.path.realpath(line.port), name)
        if other != name:
            mistakes.append(
                f"lines.{name}.port: is that of line '{other}'; devices of one cable are on one line, all with its "
                "baud rate and parity"
            )
    return mistakes


def _other_quantities(bench: Bench) -> list[str]:
    """Roles whose channel is of another quantity."""
    return [
        f"roles.{role}: '{name}' is no {role}; its name would end with {' or '.join(ends)}"
        for role, ends in ENDS_OF_ROLES.items()
        if (name := getattr(bench.file.roles, role)) is not None and not name.endswith(ends)
    ]


def _unreferenced_flow(bench: Bench) -> list[str]:
    """A meter of standard litres of which nothing says the state."""
    name = bench.file.roles.flow
    channel = (name or "").partition(".")[2]
    if channel.startswith("flow_") and channel != "flow_l_min" and bench.channel("flow")[1].reference is None:
        return [
            f"roles.flow: '{name}' is no flow at the inlet's state, and has no reference by which it is brought there; "
            f"state channels.{channel}.reference in the instrument file"
        ]
    return []


def of_lines(file: BenchFile) -> list[str]:
    """Lines that lack a key, or have two that do not go together."""
    mistakes = []
    for name, line in file.lines.items():
        if line.kind == "serial" and not line.port:
            mistakes.append(f"lines.{name}: a serial line needs its port")
        if line.kind == "tcp" and not line.host:
            mistakes.append(f"lines.{name}: a tcp line needs its host")
        if "/" in line.host or line.host.count(":") == 1 or line.host.split() not in ([], [line.host]):
            mistakes.append(
                f"lines.{name}.host: '{line.host}' is more than a name or an address; tcp_port has the port"
            )
        framing = line.framing or ("tcp" if line.kind == "tcp" else "rtu")
        if line.transaction_numbers == "any" and (line.kind, framing) != ("tcp", "tcp"):
            mistakes.append(f"lines.{name}: transaction_numbers is of Modbus TCP, and this line has none; take it out")
        if line.slowest_reply_s < line.timeout_s:
            mistakes.append(f"lines.{name}: slowest_reply_s is shorter than timeout_s; it is at least as long")
        if VIRTUAL in (line.port, line.host) and file.virtual is None:
            mistakes.append(f"lines.{name}: the port is virtual, and the file has no [virtual] table")
    return mistakes


def of_addresses(file: BenchFile) -> list[str]:
    """Two entries of one line that answer to the same name, without saying that they are one device."""
    mistakes = []
    seen: dict[tuple[str, int | str], str] = {}
    for name, table in file.devices.items():
        if "." in name or not name.isprintable() or not name:
            mistakes.append(f"devices.{name!a}: a device's name has no dot and no control character, and is not empty")
        if name == DERIVED:
            mistakes.append(f"devices.{name}: the log calls channels so that are computed; give it another name")
        same = table.same_device_as
        if same:
            mistakes += _same_device_mistakes(file, name, same)
        for address in (table.unit_id, table.address or None):
            if address is None:
                continue
            other = seen.setdefault((table.line, address), name)
            if not _entries_of(file, name) & _entries_of(file, other):
                mistakes.append(
                    f"devices.{name}: answers to {address!r} on line '{table.line}' as '{other}' does; if the two are "
                    f'one device, of which two instrument files tell, write same_device_as = "{other}" here'
                )
    return mistakes


def _same_device_mistakes(file: BenchFile, name: str, same: str) -> list[str]:
    table, other = file.devices[name], file.devices.get(same)
    key = f"devices.{name}.same_device_as"
    if other is None or same == name:
        others = ", ".join(device for device in file.devices if device != name)
        return [f"{key}: there is no other device '{same}' ({others})"]
    if (table.line, table.unit_id, table.address) != (other.line, other.unit_id, other.address):
        return [f"{key}: '{same}' has another line, unit_id or address; one device has one of each"]
    return []


def _entries_of(file: BenchFile, name: str) -> set[str]:
    """An entry, and those that it is said to be the same as, through others too."""
    found: set[str] = set()
    while name in file.devices and name not in found:
        found.add(name)
        name = file.devices[name].same_device_as
    return found


def of_roles(bench: Bench) -> list[str]:
    """Roles of channels that are not there, and waivers of what is no regulator."""
    mistakes = []
    drivers: dict[str, Any] = {}
    for device in bench.file.devices:
        try:
            drivers[device] = bench.build(device)
        except ConfigError as error:
            mistakes += str(error).splitlines()
    for role, name in bench.file.roles:
        if name is None:
            continue
        device, _, channel = name.partition(".")
        if device not in bench.file.devices:
            mistakes.append(f"roles.{role}: there is no device '{device}' ({', '.join(bench.file.devices)})")
            continue
        if device not in drivers:
            continue
        driver = drivers[device]
        if role == "regulator":
            if not hasattr(driver, "write"):
                mistakes.append(f"roles.regulator: '{device}' takes no set-point")
        elif channel not in driver.channels:
            mistakes.append(f"roles.{role}: '{device}' has no channel '{channel}' ({', '.join(driver.channels)})")
    setting = [device for device, driver in drivers.items() if hasattr(driver, "write")]
    mistakes += [
        f"safety.waive_failsafe: '{name}' is no regulator of this bench ({', '.join(setting) or 'it has none'})"
        for name in bench.file.safety.waive_failsafe
        if name not in setting and (name in drivers or name not in bench.file.devices)
    ]
    return mistakes
