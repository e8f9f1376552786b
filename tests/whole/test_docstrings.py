"""The house rule for docstrings: everything public has one; what a section says, the signature does not."""

import importlib
import inspect
import pkgutil
import re
from pathlib import Path

import numba

ROOT = Path(__file__).resolve().parents[2]

ROOMS = ("model", "calibration", "rig", "configs", "spinbench")
SECTION = re.compile(r"^Parameters\n-{10}\n(.*?)(?=^\S[^\n]*\n-{3,}$|\Z)", re.MULTILINE | re.DOTALL)
ENTRY = re.compile(r"^(?P<names>\*{0,2}\w+(?:, \*{0,2}\w+)*)(?: : (?P<kind>.+))?$")
LINE = re.compile(r"^(?P<names>`\w+`(?:, `\w+`)*)(?:, (?P<shape>(?:shapes?|array) [^:]+))?: (?P<text>.*)$")
UNIT = re.compile(r"\[[^\]]+\]|own unit")


def module_names():
    """Every public module of the rooms, found by walking them."""
    for room in ROOMS:
        package = importlib.import_module(room)
        yield room
        found = (module.name for module in pkgutil.walk_packages(package.__path__, f"{room}."))
        yield from (name for name in found if not any(part.startswith("_") for part in name.split(".")))


def plain(thing):
    """The Python function behind a compiled one."""
    return getattr(thing, "py_func", thing)


def is_callable_of(thing, module):
    compiled = isinstance(thing, numba.core.dispatcher.Dispatcher)
    return (compiled or inspect.isfunction(thing) or inspect.isclass(thing)) and thing.__module__ == module


def public_things():
    """Name and object of every public function, class and method that is defined in the rooms."""
    for name in module_names():
        module = importlib.import_module(name)
        for key, thing in vars(module).items():
            if key.startswith("_") or not is_callable_of(thing, name):
                continue
            yield f"{name}.{key}", thing
            if inspect.isclass(thing):
                for method_name, method in vars(thing).items():
                    inner = getattr(method, "__func__", method)
                    if not method_name.startswith("_") and inspect.isfunction(inner):
                        yield f"{name}.{key}.{method_name}", inner


THINGS = dict(public_things())
FUNCTIONS = {name: plain(thing) for name, thing in THINGS.items() if not inspect.isclass(thing)}


def signature_names(function):
    return [name for name in inspect.signature(function).parameters if name not in ("self", "cls")]


def entries(thing):
    """What it says of its parameters, in lines or in a Parameters section: names, kind and text of each entry."""
    told = inspect.getdoc(thing) or ""
    section = SECTION.search(told)
    found = []
    if section is None:
        is_entry = False
        for line in told.splitlines():
            if entry := LINE.match(line):
                found.append([re.findall(r"\w+", entry["names"]), entry["shape"] or "", entry["text"]])
            elif is_entry and line.startswith("    "):
                found[-1][2] += f" {line.strip()}"
            is_entry = bool(found) and (entry is not None or (is_entry and line.startswith("    ")))
        return found
    for line in section.group(1).splitlines():
        if line and not line.startswith(" "):
            entry = ENTRY.match(line)
            assert entry, f"{thing.__name__}: not numpydoc: {line!r}"
            names = [name.strip(" *") for name in entry["names"].split(",")]
            found.append([names, entry["kind"] or "", ""])
        elif line:
            found[-1][2] += f" {line.strip()}"
    return found


def documented(thing):
    """Names that it says something of."""
    return [name for names, _, _ in entries(thing) for name in names]


def rooms_of(module):
    """A module and the packages that it lies in."""
    parts = module.split(".")
    return [importlib.import_module(".".join(parts[:depth])) for depth in range(len(parts), 0, -1)]


def test_the_rooms_are_found():
    assert {"model.solvers.steady", "model.solvers.transient", "configs"} <= set(module_names())
    assert {"model.geometry.place", "model.solvers.transient.Transient.mean_speed_rad_s", "configs.Strict"} <= set(
        THINGS
    )


def test_every_module_says_what_it_is():
    def is_empty_package(name, module):
        return hasattr(module, "__path__") and not any(is_callable_of(v, name) for v in vars(module).values())

    modules = {name: importlib.import_module(name) for name in module_names()}
    assert [name for name, one in modules.items() if not one.__doc__ and not is_empty_package(name, one)] == []


def test_everything_public_has_a_docstring():
    assert [name for name, thing in THINGS.items() if not plain(thing).__doc__] == []


def test_the_docstring_s_parameters_are_those_of_the_signature_in_its_order():
    wrong = {}
    for name, function in FUNCTIONS.items():
        told, theirs = documented(function), signature_names(function)
        if told != [one for one in theirs if one in told]:
            wrong[name] = told
    assert wrong == {}


def test_no_entry_repeats_its_own_name():
    """An entry is there for what name and type do not say; the model's functions explain each of their parameters."""
    wrong = []
    for name, function in FUNCTIONS.items():
        if name.startswith("model."):
            continue
        for names, kind, text in entries(function):
            said = set(re.findall(r"[a-z]+", text.lower())) - {"the", "a", "an", "of", "its", "s"}
            known = set(re.findall(r"[a-z]+", " ".join([*names, kind]).lower()))
            if said and said <= known and not UNIT.search(text) and "shape" not in kind:
                wrong.append((name, names, text))
    assert wrong == []


def test_each_of_several_parameters_in_the_model_is_explained_by_the_function_or_at_the_top_of_its_room():
    unexplained = {}
    for name, function in FUNCTIONS.items():
        theirs = signature_names(function)
        if name.startswith("model.") and len(theirs) > 1:
            told = {one for place in (function, *rooms_of(function.__module__)) for one in documented(place)}
            if not told >= set(theirs):
                unexplained[name] = sorted(set(theirs) - told)
    assert unexplained == {}


def annotations_below(room):
    """How parameters of each name are annotated, in a function, or in those of a module or a package."""
    found = {}
    for name, function in FUNCTIONS.items():
        if name == room or name.startswith(f"{room}."):
            for key, parameter in inspect.signature(function).parameters.items():
                found.setdefault(key, set()).add(str(parameter.annotation))
    return found


def test_every_quantity_of_the_model_has_a_unit_or_a_shape():
    bare, seen = [], 0
    places = FUNCTIONS | {name: importlib.import_module(name) for name in module_names()}
    for name, place in places.items():
        if name.split(".")[0] != "model" or not entries(place):
            continue
        annotated = annotations_below(name)
        for names, shape, text in entries(place):
            kinds = {kind for one in names for kind in annotated.get(one, ())}
            if any(re.match(r"(float|np\.ndarray)\b", kind) for kind in kinds):
                seen += 1
                if not (UNIT.search(text) or re.search(r"shapes? \(", shape) or "as in `" in text):
                    bare.append((name, names))
    assert bare == []
    assert seen > 200


def test_the_model_tells_a_parameter_in_a_line():
    things = THINGS | {name: importlib.import_module(name) for name in module_names()}
    sections = re.compile(r"^(Parameters|Attributes|Returns|Raises|Notes)\n-{3,}$", re.MULTILINE)
    told = {name: inspect.getdoc(plain(thing)) or "" for name, thing in things.items()}
    wrong = [name for name, words in told.items() if name.split(".")[0] == "model" and sections.search(words)]
    headings = (ROOT / "docs" / "python-reference.md").read_text(encoding="utf-8")
    shown = {name for name in wrong if any(f"\n### {part}\n" in headings for part in name.split("."))}
    assert set(wrong) == shown, "in numpydoc is what the Python reference shows, and nothing else of the model"
