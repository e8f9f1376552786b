"""spinbench from Python: its names lead to functions of the rooms, and importing it costs nothing."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import spinbench


def test_importing_it_loads_nothing_slow():
    program = "import sys, spinbench; print([name for name in ('numpy', 'typer', 'rich') if name in sys.modules])"
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, text=True).stdout == "[]\n"


@pytest.mark.parametrize("name", spinbench.__all__)
def test_a_public_name_is_something_to_call_that_says_what_it_is(name):
    found = getattr(spinbench, name)
    assert callable(found)
    assert found.__doc__
    assert name in dir(spinbench)


def test_a_type_checker_is_told_of_the_same_names():
    tree = ast.parse(Path(spinbench.__file__).read_text(encoding="utf-8"))
    (told,) = [one for one in tree.body if isinstance(one, ast.If)]
    names = {alias.asname: line.module for line in told.body for alias in line.names}
    assert names == spinbench.ROOMS


def test_another_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'fitt'"):
        _ = spinbench.fitt


def test_the_published_sweep_is_read():
    assert spinbench.read_recording(spinbench.published_sweep()).files[0].rows == 7
