"""What an operating point amounts to: speed, flow, and where the power of the compressed air goes.

The motor runs without load, so its useful power is zero and an efficiency of the shaft would be too. The efficiency
here is the indicated one: power of the gas torque over the power of an isentropic expansion from the line to the
ambient. The published torque reading is not the gas's work (erratum 4); both figures are given, each by its name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from configs.units import BAR
from model import layout as at
from model.gas.air import RANGES
from model.motor import Motor
from model.solvers.steady import Steady, gas_table, steady

LOWEST_PA, HIGHEST_PA, _ = RANGES["P"]


class OperatingPointError(ValueError):
    """A pressure or a set of parameters that the model does not reach. The text says what to change."""


class NotSettledError(ArithmeticError):
    """No periodic state was found, although the motor does not stall. The text names the pressure."""


@dataclass(frozen=True)
class OperatingPoint:
    """One operating point without load; the names are the keys of simulation/1 and carry the units.

    Attributes
    ----------
    state : str
        ``running`` or ``stalled``; a stalled motor has zeros throughout and no efficiency.
    pressure_bar_abs, speed_rpm, flow_l_min, mass_flow_kg_s : float
        Inlet pressure, mean speed, mean flow at inlet pressure and temperature, and as mass.
    speed_ripple_rpm : float
        Peak to peak, within a pulse.
    torque_reading : str
        The reading of Eq. 25 that the torques and ``indicated_power_w`` are in.
    gas_torque_nm, roller_torque_nm, f_overall_torque_nm : float
        Cycle means: the gas's, and what roller friction and f_overall take of it.
    isentropic_power_w : float
        Mass flow times the isentropic enthalpy drop from P_in, T_in to P_a.
    inlet_drop_loss_w, outlet_drop_loss_w : float
        What the fixed pressure drops of the ports take of it: the isentropic drop with P_s for P_in, then with P_d for
        P_a too.
    blow_down_loss_w : float
        The rest down to the gas's work: expansion that ends above P_d, the filling of the clearance, and heat.
    gas_work_w : float
        Work of the gas on the pistons in time, from the virtual-work torque.
    torque_reading_surplus_w : float
        Indicated power less the gas's work: what the published arm adds; 0 in the virtual-work reading.
    indicated_power_w : float
        Gas torque times speed, in the torque reading in use.
    roller_loss_w, f_overall_loss_w : float
        Where it goes; the two sum to ``indicated_power_w``.
    isentropic_efficiency, isentropic_efficiency_virtual_work : float or None
        ``indicated_power_w`` and ``gas_work_w`` over ``isentropic_power_w`` [-].
    """

    state: str
    pressure_bar_abs: float
    speed_rpm: float
    flow_l_min: float
    mass_flow_kg_s: float
    speed_ripple_rpm: float
    torque_reading: str
    gas_torque_nm: float
    roller_torque_nm: float
    f_overall_torque_nm: float
    isentropic_power_w: float
    inlet_drop_loss_w: float
    outlet_drop_loss_w: float
    blow_down_loss_w: float
    gas_work_w: float
    torque_reading_surplus_w: float
    indicated_power_w: float
    roller_loss_w: float
    f_overall_loss_w: float
    isentropic_efficiency: float | None
    isentropic_efficiency_virtual_work: float | None


def check_pressures(motor: Motor, pressures: Sequence[float]) -> None:
    """Refuse pressures that the model does not reach.

    `motor`: for its ambient.
    Raises OperatingPointError: outside 0.5-8 bar, where the air properties end, or below the ambient.
    """
    P_a = motor.si("ambient_pressure")
    for P in pressures:
        if not LOWEST_PA <= P <= HIGHEST_PA:
            raise OperatingPointError(
                f"pressure {P / BAR:g} bar is outside {LOWEST_PA / BAR:g} to {HIGHEST_PA / BAR:g} bar; "
                "pressures are absolute, in bar"
            )
        if P_a > P:
            raise OperatingPointError(
                f"pressure {P / BAR:g} bar is below the ambient's {P_a / BAR:g} bar; pressures are absolute, not gauge"
            )


def operating_points(motor: Motor, pressures: Sequence[float]) -> list[OperatingPoint]:
    """Steady operating points.

    Returns a point for each pressure, in the order given. Raises OperatingPointError when a pressure or the gas is out
    of the model's reach, NotSettledError when no periodic state was found.
    """
    check_pressures(motor, pressures)
    try:
        found = steady(motor, pressures)
        work = steady(motor.with_readings(torque="virtual_work"), pressures)
        gas = gas_table(motor, pressures)
    except ValueError as error:
        raise OperatingPointError(f"motor {motor.name}: {error}; check the temperatures and the humidity") from error
    for P, running, speed in zip(pressures, found.running[0], found.speed_rad_s[0], strict=True):
        if speed > 0.0 and not running:
            raise NotSettledError(f"no periodic state was found at {P / BAR:g} bar; are the parameters physical?")
    return [_point(motor, float(P), found, work, gas[i], i) for i, P in enumerate(pressures)]


def isentropic_drop(P: float, P_end: float, T: float, gas: np.ndarray) -> float:
    """Enthalpy drop of an isentropic expansion of the ideal gas [J/kg].

    `P`, `P_end`: pressures before and after [Pa].
    `T`: temperature before [K].
    """
    return float(gas[at.GAS_CP] * T * (1.0 - (P_end / P) ** (gas[at.GAS_R] / gas[at.GAS_CP])))


def _point(motor: Motor, P: float, found: Steady, work: Steady, gas: np.ndarray, i: int) -> OperatingPoint:
    """One point out of the solved ones; ``work`` is solved in the virtual-work reading."""
    P_a, T_in = motor.si("ambient_pressure"), motor.si("inlet_temperature")
    P_s, P_d = P - motor.si("inlet_pressure_drop"), P_a + motor.si("outlet_pressure_drop")
    running = bool(found.running[0, i])
    speed, mass_flow = float(found.speed_rad_s[0, i]), float(found.mass_flow_kg_s[0, i])
    gas_torque, roller = float(found.gas_torque_nm[0, i]), float(found.roller_torque_nm[0, i])

    ideal = mass_flow * isentropic_drop(P, P_a, T_in, gas)
    after_inlet = mass_flow * isentropic_drop(P_s, P_a, T_in, gas)
    after_ports = mass_flow * isentropic_drop(P_s, P_d, T_in, gas)
    indicated = gas_torque * speed
    # Its own steady speed differs by 1 %; the torque that belongs to it does so by what heat changes, below 1e-4.
    gas_work = float(work.gas_torque_nm[0, i]) * speed if work.running[0, i] else 0.0
    return OperatingPoint(
        state="running" if running else "stalled",
        pressure_bar_abs=P / BAR,
        speed_rpm=speed * at.RPM,
        flow_l_min=float(found.flow_m3_s[0, i]) * at.L_MIN,
        mass_flow_kg_s=mass_flow,
        speed_ripple_rpm=float(found.ripple_rad_s[0, i]) * at.RPM,
        torque_reading=motor.readings.torque,
        gas_torque_nm=gas_torque,
        roller_torque_nm=roller,
        f_overall_torque_nm=gas_torque - roller,
        isentropic_power_w=ideal,
        inlet_drop_loss_w=ideal - after_inlet,
        outlet_drop_loss_w=after_inlet - after_ports,
        blow_down_loss_w=after_ports - gas_work,
        gas_work_w=gas_work,
        torque_reading_surplus_w=indicated - gas_work,
        indicated_power_w=indicated,
        roller_loss_w=roller * speed,
        f_overall_loss_w=(gas_torque - roller) * speed,
        isentropic_efficiency=indicated / ideal if running else None,
        isentropic_efficiency_virtual_work=gas_work / ideal if running else None,
    )
