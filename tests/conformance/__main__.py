"""Other makers' clients against our virtual devices and our console, and libmodbus' device behind our drivers."""

from __future__ import annotations

import sys

from tests.conformance.cases import CLIENTS, TABLES, all_of


def main():
    """Run every case that this machine can, print each that differs and the counts; 1 where something differs."""
    results, missing = all_of()
    differ = [one for one in results if not one.is_as_it_should_be]
    for one in differ:
        print(f"{one.who} over {one.line}: {one.case}: {one.got}, not {one.wanted}")
    for name in missing:
        print(f"skipped, not on this machine or not made for this line: {name}")
    suites = len(TABLES) * (len(CLIENTS) + 1) + 1
    print(f"{len(results)} cases, {len(differ)} differ, {len(missing)} of {suites} suites skipped")
    return min(len(differ), 1)


if __name__ == "__main__":
    sys.exit(main())
