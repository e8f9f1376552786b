"""The house rule for docstrings: everything public has one; what a section says, the signature does not."""

import importlib
import inspect
import pkgutil
import re

import numba

ROOMS = ("model", "calibration", "rig", "configs", "spinbench")
SECTION = re.compile(r"^Parameters\n-{10}\n(.*?)(?=^\S[^\n]*\n-{3,}$|\Z)", re.MULTILINE | re.DOTALL)
ENTRY = re.compile(r"^(?P<names>\*{0,2}\w+(?:, \*{0,2}\w+)*)(?: : (?P<kind>.+))?$")
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
    """What its Parameters section says: names, kind and text of each entry; None without a section."""
    section = SECTION.search(inspect.getdoc(thing) or "")
    if section is None:
        return None
    found = []
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
    """Names in its Parameters section."""
    return [name for names, _, _ in entries(thing) or [] for name in names]


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
        told = documented(function)
        if told != [one for one in signature_names(function) if one in told]:
            wrong[name] = told
    assert wrong == {}


def test_no_entry_repeats_its_own_name():
    """An entry is there for what name and type do not say; the model's functions explain each of their parameters."""
    wrong = []
    for name, function in FUNCTIONS.items():
        if name.startswith("model."):
            continue
        for names, kind, text in entries(function) or []:
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


def test_every_quantity_of_the_model_has_a_unit_or_a_shape():
    places = FUNCTIONS | {name: importlib.import_module(name) for name in module_names()}
    bare = [
        (name, names)
        for name, place in places.items()
        if name.split(".")[0] == "model"
        for names, kind, text in entries(place) or []
        if re.match(r"(float|ndarray|array)", kind) and not (UNIT.search(text) or re.search(r"shapes? \(", kind))
    ]
    assert bare == []
