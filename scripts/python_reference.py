"""Write docs/python-reference.md from the docstrings of what `import spinbench` offers.

The groups are the comments in ROOMS of spinbench/__init__.py.
"""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import itertools
import re
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import spinbench

PAGE = Path(__file__).resolve().parents[1] / "docs" / "python-reference.md"
HEAD = """\
# Every name of `import spinbench`

[From Python](python.md) shows them at work. This page is made from their docstrings; `make pages` writes it anew.

`Data` is a path, or what [`open`](#open) gives. `Values` maps names of a motor's parameters to values. `Tell` is called
with the progress. Quantities of the model are in SI units, unless their names end in another.
"""
GIVEN = (  # what the functions give, without a public name of its own
    "rig.recording:Recording",
    "rig.runlog:Run",
    "rig.runlog.listing:RunRow",
    "rig.exchange.export:Exported",
    "model.motor:Motor",
    "model.operation.performance:OperatingPoint",
    "model.operation.runs:Transient",
    "model.operation.sensitivity:Sensitivity",
    "calibration.fit.posterior:Posterior",
    "calibration.fit.posterior:FitQuality",
)
SECTION = re.compile(r"^(Parameters|Attributes|Returns|Raises)\n-+\n", re.MULTILINE)
ITEM = re.compile(r"`\w+`(?:, `\w+`)*(?:, shape [^:]+)?: |Returns |Raises ")
BREAK = re.compile(rf"\n\n|\n(?={ITEM.pattern})")
WIDTH = 110
LAST = "What they give"


def page() -> str:
    """The page's Markdown."""
    groups = {title: [(name, getattr(spinbench, name)) for name in names] for title, names in _groups().items()}
    given = [place.split(":") for place in GIVEN]
    groups[LAST] = [(name, getattr(importlib.import_module(module), name)) for module, name in given]
    known = {name for named in groups.values() for name, _ in named}
    parts = [HEAD]
    for title, named in groups.items():
        parts.append(f"\n## {title}\n")
        for name, thing in named:
            body = "\n".join(_class(thing) if inspect.isclass(thing) else _function(name, thing))
            body = body if title == LAST else _linked(body, known - {name})  # it may mean names of its own room
            parts.append(f"\n### {name}\n\n{body.strip()}\n")
    return "".join(parts)


def _groups() -> dict[str, list[str]]:
    source = inspect.getsource(spinbench).partition("ROOMS = {")[2].partition("}")[0]
    found: dict[str, list[str]] = {}
    for title, name in re.findall(r'^    (?:# (.+)|"(\w+)")', source, re.MULTILINE):
        if title:
            names = found.setdefault(title[0].upper() + title[1:], [])
        elif name != "main":
            names.append(name)
    return {title: names for title, names in found.items() if names}


def _linked(text: str, known: set[str]) -> str:
    def link(match: re.Match[str]) -> str:
        return f"[{match[0]}](#{match[1].lower()})" if match[1] in known else match[0]

    return re.sub(r"(?<![`\[])`(\w+)`(?!`)", link, text)


def _function(name: str, function: Any) -> list[str]:
    return ["```py", _signature(name, function), "```", "", *_told(inspect.getdoc(function) or "")]


def _signature(name: str, function: Any) -> str:
    signature = inspect.signature(function)
    starred, shown = False, []
    for one in signature.parameters.values():
        if one.name == "self":
            continue
        if one.kind is one.KEYWORD_ONLY and not starred:
            starred = True
            shown.append("*")
        default = "" if one.default is one.empty else f" = {'...' if callable(one.default) else repr(one.default)}"
        shown.append(f"{one.name}: {one.annotation}{default}".replace("'", '"'))
    end = f") -> {signature.return_annotation}"
    line = f"{name}({', '.join(shown)}{end}"
    return line if len(line) <= WIDTH else "\n".join([f"{name}(", *(f"    {one}," for one in shown), end])


def _class(kind: type) -> list[str]:
    text, sections = _sections(inspect.getdoc(kind) or "")
    entries = list(_entries(sections.get("Attributes", "")))
    named = {name for names, _, _ in entries for name in names}
    fields = {name: str(said) for name, said in inspect.get_annotations(kind).items() if name[0] != "_"}
    entries += [([name], said, "") for name, said in fields.items() if name not in named]
    order = [*fields, *vars(kind)]
    members = {name: one for name, one in vars(kind).items() if name[0] != "_" and name not in {*named, *fields}}
    read = {name: _getter(one) for name, one in members.items() if _getter(one)}
    lines = [text, ""]
    for names, said, told in sorted(entries, key=lambda entry: order.index(entry[0][0])):
        lines.append(_item(names, said + _defaults(kind, names), told))
    for name, getter in read.items():
        lines += _member(f"`{name}` ({getter.__annotations__.get('return', '')})", getter)
    for name, one in members.items():
        if inspect.isfunction(one) and one.__doc__:
            lines += _member(f"`{_signature(name, one)}`".replace("\n    ", "").replace("\n", ""), one)
    return lines


def _getter(member: Any) -> Any:
    return member.fget if isinstance(member, property) else member.func if isinstance(member, cached_property) else None


def _member(head: str, function: Any) -> list[str]:
    told = _told(inspect.getdoc(function) or "")
    first, *rest = "\n".join(told).split("\n")
    return [f"- {head}: {first}", *(f"  {line}".rstrip() for line in rest)]


def _defaults(kind: type, names: list[str]) -> str:
    """What fields are where nothing is given, of a class that can be made so."""
    fields = dataclasses.fields(kind) if dataclasses.is_dataclass(kind) else ()
    defaults = {one.name: one.default for one in fields}
    if not defaults or dataclasses.MISSING in defaults.values():
        return ""
    return f"; {', '.join(repr(defaults[name]) for name in names)} if left out"


def _told(docstring: str) -> list[str]:
    text, sections = _sections(docstring)
    lines = [text]
    for title, body in sections.items():
        items = [_item(names, said, told) for names, said, told in _entries(body)]
        lines += ["", f"{title}:", "", *items]
    return lines


def _sections(docstring: str) -> tuple[str, dict[str, str]]:
    text, *rest = SECTION.split(docstring)
    parts = (" ".join(one.split()) for one in re.split(BREAK, text.strip()))
    told = ""
    for is_item, group in itertools.groupby(parts, lambda one: bool(ITEM.match(one))):
        lines = [f"- {one}" if is_item else one for one in group]
        told += "\n\n" * bool(told) + ("\n" if is_item else "\n\n").join(lines)
    return told, dict(zip(rest[::2], rest[1::2], strict=True))


def _entries(section: str) -> Iterator[tuple[list[str], str, str]]:
    for entry in re.split(r"\n(?=\S)", section.strip()):
        head, _, told = entry.partition("\n")
        name, _, said = head.partition(" : ")
        if name:
            yield name.split(", "), said, " ".join(told.split())


def _item(names: list[str], said: str, told: str) -> str:
    head = ", ".join(f"`{name}`" for name in names)
    return f"- {head}{f' ({said})' if said else ''}{f': {told}' if told else ''}"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
