"""The configuration files, and the strict reader that every room opens them with.

TOML is read strictly: a misspelt key is refused with the nearest one suggested, a value of the wrong kind is refused
with its place, and all the mistakes of a file are reported at once. Nothing is converted silently.

units     of the files' figures
sources   which of the project's files import which
compiled  functions that numba compiles, and when they are made anew
"""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypeVar

import pydantic
from pydantic.fields import FieldInfo

from configs.units import as_in_another_unit

FOLDER = Path(__file__).resolve().parent
MAX_TOML_BYTES = 1_000_000
PROJECT = "spinbench.toml"  # its folder is a project: it has folders of its own of what is kept here
CLOSE = 0.75  # how alike a misspelt name and the one meant are, from 0 to 1
_NAME = re.compile(r"[A-Za-z0-9_.\-]{1,80}")

Schema = TypeVar("Schema", bound=pydantic.BaseModel)
Location = tuple[int | str, ...]  # keys, and places in lists from 0


class ConfigError(ValueError):
    """A configuration file cannot be used. The text names the file, the place and what to do."""


class Strict(pydantic.BaseModel):
    """Base of every schema: no unknown keys, no silent conversion, no change after reading."""

    model_config = pydantic.ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)


def places(kind: str, near: Path | None = None) -> list[Path]:
    """Folders in which files of a kind are looked for, the first before the others.

    Beside the file or in the folder that names them, in the project that it is in, in the project that the program was
    started in, and here.

    `kind`: ``motors``, ``benches``, ``instruments`` or ``imports``.
    `near`: the folder of the file that names them.
    """
    beside = [] if near is None else [near, near / kind]
    projects = [project for start in (near, Path.cwd()) if start is not None and (project := project_of(start))]
    return list(dict.fromkeys([*beside, *(project / kind for project in projects), FOLDER / kind]))


def names(kind: str, near: Path | None = None) -> list[str]:
    """The names that there are of a kind, those of the project first; the arguments are those of `places`."""
    of_kind = [place for place in places(kind, near) if place != near]
    return list(dict.fromkeys(file.stem for place in of_kind for file in sorted(place.glob("*.toml"))))


class ProjectFile(Strict):
    """A spinbench.toml."""

    format: Literal["project/1"]
    title: str = ""


def project_of(folder: Path) -> Path | None:
    """The project that a folder is in: the nearest folder upwards with a spinbench.toml; None where there is none.

    Raises ConfigError for a spinbench.toml with mistakes.
    """
    there = folder.absolute()
    found = next((one for one in (there, *there.parents) if (one / PROJECT).is_file()), None)
    if found is not None:
        validate(ProjectFile, read_toml(found / PROJECT), str(found / PROJECT))
    return found


def find(kind: str, name: str, near: Path | None = None) -> Path | None:
    """The file that a name stands for, or a path that is relative to `near`; None where there is none.

    A file beside what names it counts where it is of that kind. Links are passed over.
    """
    if name.endswith(".toml") or "/" in name:
        path = (near or Path.cwd()) / name
        return path if path.is_file() else None
    if not _NAME.fullmatch(name):
        return None
    candidates = (place / f"{name}.toml" for place in places(kind, near))
    return next((one for one in candidates if one.is_file() and not one.is_symlink() and _is_of(kind, one)), None)


def _is_of(kind: str, path: Path) -> bool:
    """Whether a file is of a kind; one that cannot be read is told of by who reads it."""
    try:
        said = str(read_toml(path).get("format", ""))
    except ConfigError:
        return True
    return path.parent.name == kind or said.startswith({"benches": "bench/"}.get(kind, f"{kind.removesuffix('s')}/"))


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises ConfigError when the file is missing, too large to be a configuration, not UTF-8 or not TOML (a duplicate key
    included).
    """
    return parse_toml(read_source(path), str(path))


def read_source(path: Path) -> bytes:
    """Read a configuration file as it stands.

    Raises ConfigError when the file is missing, cannot be read, or is too large to be a configuration.
    """
    try:
        if path.stat().st_size > MAX_TOML_BYTES:
            raise ConfigError(f"{path}: larger than {MAX_TOML_BYTES} bytes; this is not a configuration file")
        return path.read_bytes()
    except FileNotFoundError:
        raise ConfigError(_no_such_file(path)) from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from None


def parse_toml(source: bytes, place: str) -> dict[str, Any]:
    """The tables of a TOML text. Raises ConfigError when it is not UTF-8 or not TOML (a duplicate key included)."""
    try:
        return tomllib.loads(source.decode("utf-8-sig").replace("\r\n", "\n"))  # sig: Windows editors write one
    except UnicodeDecodeError:
        raise ConfigError(f"{place}: not UTF-8 text; save it as UTF-8") from None
    except RecursionError:
        raise ConfigError(f"{place}: not TOML that can be read; it is nested too deeply") from None
    except tomllib.TOMLDecodeError as error:
        text = str(error).replace("Cannot overwrite a value", "the same key stands twice (or cannot be overwritten)")
        raise ConfigError(f"{place}: not valid TOML: {text}") from None


def validate(schema: type[Schema], data: dict[str, Any], place: str) -> Schema:
    """Check data against a schema and report every mistake at once.

    Raises ConfigError: one line a mistake: place, what is wrong, what was expected.
    """
    try:
        return schema.model_validate(data)
    except pydantic.ValidationError as error:
        mistakes = _sentences(schema, data, error.errors(include_url=False))
        raise ConfigError("\n".join(f"{place}: {mistake}" for mistake in mistakes)) from None


def _sentences(schema: type[pydantic.BaseModel], data: dict[str, Any], problems: Sequence[Any]) -> list[str]:
    """The mistakes that pydantic found, a line each; a check of the whole file may have found several."""
    at: dict[Location, list[Any]] = {}
    for problem in problems:
        at.setdefault(_path(data, problem), []).append(problem)
    lines = []
    for path, found in at.items():
        deeper = any(len(other) > len(path) and other[: len(path)] == path for other in at)
        if not path:
            lines += [line for problem in found for line in _said(problem).splitlines()]
        elif not (deeper and len(found[0]["loc"]) > len(path)):  # of the kinds that a value may be, one was meant
            lines.append(_sentence(schema, data, path, found))
    return lines


def _path(data: Any, problem: Any) -> Location:
    """Where a mistake is in the data: its location without what pydantic adds for the kinds that a value may be of."""
    path: list[int | str] = []
    for part in problem["loc"]:
        if part in data if isinstance(data, dict) else isinstance(data, list) and part in range(len(data)):
            path.append(part)
            data = data[part]
    return (*path, problem["loc"][-1]) if problem["type"] == "missing" else tuple(path)


def _sentence(schema: type[pydantic.BaseModel], data: dict[str, Any], path: Location, problems: Sequence[Any]) -> str:
    """One mistake in one line: the place as its writer knows it, what is wrong, and what would be right."""
    problem, name = problems[0], _name(data, path)
    if problem["type"] == "extra_forbidden":
        return f"unknown key {name}{_nearest(str(path[-1]), list(_fields(schema, path[:-1])))}"
    if problem["type"] == "missing":
        return f"the key {name} is missing"
    said = " or ".join(dict.fromkeys(_said(one) for one in problems)).replace(" or should be", " or")
    given = _value(data, path)
    shown = "" if isinstance(given, dict) or given is None else f" (given: {given!r:.60})"
    wrong = f"{name} {said}{shown}" if said.startswith("should be ") else f"{name}: {said}{shown}"
    return f"{wrong}{_meant(problem) or _left_out(_fields(schema, path[:-1]).get(str(path[-1])))}"


def _said(problem: Any) -> str:
    """What is wrong, in pydantic's words or in those of a check of ours."""
    said = problem["msg"].removeprefix("Value error, ").removeprefix("Input ").replace(" after validation", "")
    return re.sub("a valid dictionary( or instance of .*)?$", "a table", f"{said[:1].lower()}{said[1:]}")


def _name(data: Any, path: Location) -> str:
    """A place as its writer knows it: 'sweep.repeats'; 'kind' in [[files]] entry 2 (file = "run.csv")."""
    last = max((i for i, part in enumerate(path) if isinstance(part, int)), default=None)
    if last is None:
        return f"'{'.'.join(map(str, path))}'"
    number, entry, key = int(path[last]) + 1, _value(data, path[: last + 1]), path[last + 1 :]
    if not isinstance(entry, dict):
        return f"value {number} of {_name(data, path[:last])}"
    texts = ((k, v) for k, v in entry.items() if isinstance(v, str) and k.isidentifier() and k not in key)
    known_by = next((f" ({k:.60} = {v!r:.60})" for k, v in texts), "")
    table = ".".join(part for part in path[:last] if isinstance(part, str))
    where = f"[[{table}]] entry {number}{known_by}"
    return f"'{'.'.join(map(str, key))}' in {where}" if key else where


def _value(data: Any, path: Location) -> Any:
    for part in path:
        data = data[part]
    return data


def _meant(problem: Any) -> str:
    """What a number above its bound would be, if it was meant in another unit."""
    if problem["type"] != "less_than_equal" or not isinstance(problem["input"], int | float):
        return ""
    meant = as_in_another_unit(str(problem["loc"][-1]), problem["input"], problem["ctx"]["le"])
    return f"; {meant}" if meant else ""


def _left_out(field: FieldInfo | None) -> str:
    """That a key need not be there, and what is taken then."""
    if field is None or field.is_required():
        return ""
    taken = f": {field.default!r} is taken then" if isinstance(field.default, str | int | float) else ""
    return f"; or leave it out{taken}"


def _fields(schema: Any, location: Location) -> Mapping[str, FieldInfo]:
    """The keys that the schema knows at a place, as far as it can be followed."""
    for part in location:
        field = schema.model_fields.get(part) if _is_schema(schema) else None
        schema = field.annotation if field is not None else _value_schema(schema)
    schema = schema if _is_schema(schema) else _value_schema(schema)
    return schema.model_fields if _is_schema(schema) else {}


def _is_schema(candidate: Any) -> bool:
    return isinstance(candidate, type) and issubclass(candidate, pydantic.BaseModel)


def _value_schema(annotation: Any) -> Any:
    """The schema inside dict[str, Schema], list[Schema] or Schema | None."""
    return next((part for part in getattr(annotation, "__args__", ()) if _is_schema(part)), None)


def close_to(word: str, known: Iterable[str]) -> str:
    """The name that a misspelt one may be meant for: the only one that it begins, or begins with, or nearly the same.

    Empty where none is close.
    """
    names = list(known)
    near = difflib.get_close_matches(word, names, n=1, cutoff=CLOSE)
    begun = [
        name for name in names if min(len(name), len(word)) > 2 and (name.startswith(word) or word.startswith(name))
    ]
    return begun[0] if len(begun) == 1 else near[0] if near else ""


def _nearest(word: str, known: list[str]) -> str:
    """A suggestion for a misspelt word, or what would have been right."""
    close = close_to(word, known)
    if close:
        return f"; did you mean '{close}'?"
    return f"; known here: {', '.join(known)}" if known else ""


def _no_such_file(path: Path) -> str:
    """That a file is not there; of one that was looked for by its name, as the person's own."""
    kind, project = path.parent.name, project_of(Path.cwd())
    if path.parent != FOLDER / kind or project is None:
        return f"{path}: no such file{_nearest_file(path)}"
    own = project / kind / path.name
    return f"{own}: no such file, and the program comes with none of that name{_nearest(path.stem, names(kind))}"


def _nearest_file(path: Path) -> str:
    siblings = sorted(entry.stem for entry in path.parent.glob(f"*{path.suffix}")) if path.parent.is_dir() else []
    close = close_to(path.stem, siblings)  # without the ending, which all of them share
    if close:
        return f"; did you mean '{close}{path.suffix}'?"
    return f"; known here: {', '.join(f'{stem}{path.suffix}' for stem in siblings[:20])}" if siblings else ""
