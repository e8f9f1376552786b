"""Other makers' Modbus clients read and write our virtual devices; `make conformance` has more, and libmodbus."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import pytest

from tests.conformance.cases import CLIENT_CASES, Result, of_client

SUITES = [
    ("pymodbus", "rtu"),
    ("pymodbus", "tcp"),
    ("modbus-tk", "rtu"),
    ("modbus-tk", "tcp"),
    ("minimalmodbus", "rtu"),
]


VALUES = [case for case, (_, wanted) in CLIENT_CASES.items() if isinstance(wanted, list)]


def differing(cases):
    with ThreadPoolExecutor(len(SUITES)) as pool:
        suites = list(pool.map(lambda suite: of_client(*suite, cases), SUITES))
    assert [len(results) for results in suites] == [len(cases)] * len(SUITES)
    return [result for results in suites for result in results if not result.is_as_it_should_be]


@pytest.mark.slow
def test_other_makers_clients_read_and_write_the_values_that_our_virtual_devices_hold():
    assert differing(VALUES) == []


@pytest.mark.long
def test_other_makers_clients_get_the_exceptions_and_the_silence_that_the_standard_says():
    assert differing(list(CLIENT_CASES)) == []


def test_a_result_that_is_another_than_wanted_differs():
    assert not Result("a", "rtu", "b", wanted="[1, 2]", got="[2, 1]").is_as_it_should_be
