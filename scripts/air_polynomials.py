"""Generate model/gas/air_coefficients.py from CoolProp, or check that the committed file is what CoolProp gives.

    python scripts/air_polynomials.py            write the file
    python scripts/air_polynomials.py --check    compare it with a fresh generation; exit 1 on a difference

What is taken from where, all through CoolProp (a development dependency, never imported by the tool):

- dry air: cp0, B, C, viscosity and conductivity of Lemmon et al. 2000 and Lemmon and Jacobsen 2004;
- water: cp0, B, C of IAPWS-95, saturation of IAPWS-IF97, ice of IAPWS R14-08, dilute-gas viscosity and conductivity of
  IAPWS 2008 and 2011 (HAPropsSI takes both from saturated steam at the total pressure instead, at a temperature
  that is not the gas's: not used);
- air with water: cross virials and enhancement factor as in ASHRAE RP-1485 (Herrmann et al. 2009).
"""

from __future__ import annotations

import argparse
import ast
import sys
from collections.abc import Callable
from pathlib import Path

import CoolProp
import numpy as np
from CoolProp.HumidAirProp import HAProps_Aux, HAPropsSI
from numpy.typing import NDArray

Array = NDArray[np.float64]

TARGET = Path(__file__).resolve().parent.parent / "model" / "gas" / "air_coefficients.py"
T_REFERENCE = 300.0
T_TRIPLE = 273.16
T_RANGE = (230.0, 400.0)
T_TRANSPORT = (180.0, 400.0)
P_RANGE = (0.5e5, 8e5)
BAR = 1e5
FIGURES = 9
"""Decimals kept, counted from the largest value of the fitted quantity."""
SAME = 1e-8
"""Share of a value by which two generations may differ at a node (another BLAS, another CPU): no one coefficient of
several that can stand in for one another is as well determined as their sum."""

AIR = CoolProp.AbstractState("HEOS", "Air")
WATER = CoolProp.AbstractState("HEOS", "Water")


def dilute(fluid: CoolProp.AbstractState, name: str) -> Callable[[float], float]:
    """Property of a pure fluid as a function of T, in the limit of zero density."""

    def value(T: float) -> float:
        fluid.update(CoolProp.DmolarT_INPUTS, 1e-6, T)
        return float(getattr(fluid, name)())

    return value


def cross_virial(name: str) -> Callable[[float], float]:
    """Mixed virial coefficient of air and water; HAProps_Aux wants a pressure and a humidity and ignores both."""
    return lambda T: float(HAProps_Aux(name, T, 101.325, 0.0)[0])


def saturation_logarithm(T: float) -> float:
    """Natural logarithm of the saturation pressure in Pa, over ice below the triple point."""
    return float(np.log(HAProps_Aux("p_ws", T, 101.325, 0.0)[0]))


def dry_transport(name: str) -> Callable[[float, float], float]:
    """Viscosity or conductivity of dry air as a function of T and P."""

    def value(T: float, P: float) -> float:
        AIR.update(CoolProp.PT_INPUTS, P, T)
        return float(getattr(AIR, name)())

    return value


def enhancement_slope(T: float, P: float) -> float:
    """(f - 1)/(P - p_sv) in 1/bar: f is 1 where the gas is all water, so this stays finite up to there."""
    p_sv = float(np.exp(saturation_logarithm(T)))
    if p_sv > 0.8 * P:
        return float("nan")
    f = HAPropsSI("psi_w", "T", T, "P", P, "R", 1.0) * P / p_sv
    return float((f - 1.0) / ((P - p_sv) / BAR))


def nodes(low: float, high: float, count: int) -> Array:
    """Chebyshev points of an interval, ends included."""
    return 0.5 * (low + high) - 0.5 * (high - low) * np.cos(np.pi * np.arange(count) / (count - 1))


def pressure_powers(T: Array, P: Array) -> list[Array]:
    """The rows of viscosity and conductivity: powers of P in bar."""
    return [np.ones_like(T), P / BAR, (P / BAR) ** 2]


def enhancement_rows(T: Array, P: Array) -> list[Array]:
    """The rows of the enhancement factor: 1, p_sv/P (water meets water in the gas) and P in bar."""
    p_sv = np.exp([saturation_logarithm(t) for t in T])
    return [np.ones_like(T), p_sv / P, P / BAR]


def fit(
    function: Callable[..., float],
    degree: int,
    T_range: tuple[float, float],
    basis: Callable[[Array, Array], list[Array]] | None = None,
) -> tuple[Array, float, Array]:
    """Least-squares polynomial in s = 300 K/T - 1, one for each function of (T, P) in `basis`.

    Returns the rounded coefficients, shape (degree + 1,), or (rows of the basis, degree + 1), lowest order first, the
    largest error at the nodes relative to the value there, and what makes relative values at the nodes of coefficients.
    """
    T = nodes(*T_range, 61)
    if basis is not None:
        T, P = (grid.ravel() for grid in np.meshgrid(T, nodes(*P_RANGE, 13)))
        values = np.array([function(t, p) for t, p in zip(T, P, strict=True)])
        known = np.isfinite(values)
        T, P, values = T[known], P[known], values[known]
    else:
        values = np.array([function(t) for t in T])
    s = T_REFERENCE / T - 1.0
    rows_of_basis = [np.ones_like(T)] if basis is None else basis(T, P)
    terms = np.stack([row * s**i for row in rows_of_basis for i in range(degree + 1)], axis=1)
    size = np.maximum(np.abs(values), 0.02 * np.abs(values).max())
    column = np.abs(terms / size[:, None]).max(axis=0)
    solution = np.linalg.lstsq(terms / size[:, None] / column, values / size, rcond=None)[0] / column
    solution = np.round(solution, FIGURES - int(np.floor(np.log10(np.median(np.abs(values))))))
    error = float(np.max(np.abs(terms @ solution - values) / size))
    shaped = solution if basis is None else solution.reshape(len(rows_of_basis), degree + 1)
    return shaped, error, terms / size[:, None]


def generate() -> dict[str, tuple[Array, float, Array, str]]:
    """All coefficient blocks: name -> (coefficients, largest relative error, values of coefficients, meaning)."""
    above = (T_TRIPLE, T_RANGE[1])
    below = (T_RANGE[0], T_TRIPLE - 1e-9)
    return {
        "CP0_AIR": (*fit(dilute(AIR, "cp0molar"), 5, T_RANGE), "ideal-gas heat capacity of dry air, J/(mol K)"),
        "CP0_WATER": (*fit(dilute(WATER, "cp0molar"), 5, T_RANGE), "ideal-gas heat capacity of water, J/(mol K)"),
        "B_AA": (*fit(dilute(AIR, "Bvirial"), 6, T_RANGE), "second virial coefficient air-air, m3/mol"),
        "B_AW": (*fit(cross_virial("Baw"), 6, T_RANGE), "second virial coefficient air-water, m3/mol"),
        "B_WW": (*fit(dilute(WATER, "Bvirial"), 9, T_RANGE), "second virial coefficient water-water, m3/mol"),
        "C_AAA": (*fit(dilute(AIR, "Cvirial"), 6, T_RANGE), "third virial coefficient air-air-air, m6/mol2"),
        "C_AAW": (*fit(cross_virial("Caaw"), 6, T_RANGE), "third virial coefficient air-air-water, m6/mol2"),
        "C_AWW": (*fit(cross_virial("Caww"), 9, T_RANGE), "third virial coefficient air-water-water, m6/mol2"),
        "C_WWW": (*fit(dilute(WATER, "Cvirial"), 9, T_RANGE), "third virial coefficient water-water-water, m6/mol2"),
        "LOG_P_WATER": (*fit(saturation_logarithm, 6, above), "ln of saturation pressure over water, Pa"),
        "LOG_P_ICE": (*fit(saturation_logarithm, 4, below), "ln of saturation pressure over ice, Pa"),
        "ENHANCEMENT": (*fit(enhancement_slope, 7, T_RANGE, enhancement_rows), "(f - 1)/(P - p_sv), 1/bar"),
        "MU_AIR": (*fit(dry_transport("viscosity"), 6, T_TRANSPORT, pressure_powers), "viscosity of dry air, Pa s"),
        "K_AIR": (
            *fit(dry_transport("conductivity"), 6, T_TRANSPORT, pressure_powers),
            "conductivity of dry air, W/(m K)",
        ),
        "MU_WATER": (*fit(dilute(WATER, "viscosity"), 6, T_TRANSPORT), "dilute-gas viscosity of water, Pa s"),
        "K_WATER": (*fit(dilute(WATER, "conductivity"), 6, T_TRANSPORT), "dilute-gas conductivity of water, W/(m K)"),
    }


def literal(value: float) -> str:
    """A coefficient as short as its rounding allows."""
    return repr(float(f"{value:.15g}"))


def rows(coefficients: Array) -> str:
    """Coefficients as the lines of a Python literal, one power of P a block."""
    if coefficients.ndim == 1:
        return "".join(f"        {literal(c)},\n" for c in coefficients)
    return "".join(
        "        [\n" + "".join(f"            {literal(c)},\n" for c in row) + "        ],\n" for row in coefficients
    )


def describe(T_range: tuple[float, float], P_range: tuple[float, float]) -> str:
    """A range in words."""
    return f"{T_range[0]:g}-{T_range[1]:g} K, {P_range[0] / BAR:g}-{P_range[1] / BAR:g} bar"


def render(blocks: dict[str, tuple[Array, float, Array, str]]) -> str:
    """The text of model/gas/air_coefficients.py."""
    text = f'''"""Polynomials of moist air, for model/gas/_air_equations.py.

Generated by scripts/air_polynomials.py from CoolProp {CoolProp.__version__}; do not edit.

Every polynomial is in s = 300 K/T - 1, lowest order first. Blocks of several rows: MU_AIR and K_AIR have one row for
each power of P in bar; ENHANCEMENT has rows for 1, p_sv/P and P in bar.
Range: {describe(T_RANGE, P_RANGE)}; MU_* and K_* {describe(T_TRANSPORT, P_RANGE)}.
The error given is the largest at the nodes, relative to the value there or, where it is larger, to 2 % of the peak.
"""

import numpy as np
'''
    for name, (coefficients, error, _, meaning) in blocks.items():
        text += f"\n# {meaning}; error {error:.1e}\n{name} = np.array(\n    [\n{rows(coefficients)}    ]\n)\n"
    return text


def committed() -> dict[str, Array]:
    """The blocks of the committed file, read without importing it."""
    found = {}
    for node in ast.parse(TARGET.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name) and isinstance(node.value, ast.Call):
            found[node.targets[0].id] = np.array(ast.literal_eval(node.value.args[0]), dtype=float)
    return found


def differences() -> list[str]:
    """What differs between the committed file and a fresh generation by more than rounding; empty when nothing does."""
    old, new = committed(), generate()
    found = [f"{name}: only in one of the two" for name in old.keys() ^ new.keys()]
    for name in old.keys() & new.keys():
        fresh = new[name][0]
        if old[name].shape != fresh.shape:
            found.append(f"{name}: shape {old[name].shape}, fresh {fresh.shape}")
            continue
        worst = float(np.max(np.abs(new[name][2] @ (old[name] - fresh).ravel())))
        if worst > SAME:
            found.append(f"{name}: values differ by up to {worst:.1e}")
    return found


def main() -> int:
    """Write the file, or with --check compare it; the exit status is 1 on a difference."""
    parser = argparse.ArgumentParser(description="Generate or check model/gas/air_coefficients.py")
    parser.add_argument("--check", action="store_true", help="compare only, write nothing")
    if not parser.parse_args().check:
        TARGET.write_text(render(generate()), encoding="utf-8")
        print(f"wrote {TARGET.name}")
        return 0
    found = differences()
    print("\n".join(found) if found else f"{TARGET.name} agrees with CoolProp {CoolProp.__version__}")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
