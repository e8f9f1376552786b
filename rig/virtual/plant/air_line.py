"""The line between regulator and motor where it holds air: a volume that fills through the valve and empties through
the motor and the vent.

The regulator's pressure follows its set-point as a first-order lag, and falls with the flow (droop). A three-way valve
joins the line to the regulator or to the vent, and takes its time from the one to the other. Each way of it is an
orifice, choked or not (the ellipse of ISO 6358). The air is isothermal, as a line's is between two plateaus.
"""

from __future__ import annotations

import math

from configs.units import BAR

CRITICAL = 0.528  # pressure ratio below which an orifice's flow no longer grows
ORIFICE = 0.6847  # choked flow: ORIFICE A P / sqrt(R T)
STEP_S = 1e-3
LEAST_BAR = 1e-6
L, MM2 = 1e-3, 1e-6  # in a litre [m3], a square millimetre [m2]


class AirLine:
    """A line with a volume; `step` carries it on.

    `valve_time_s`: from shut to open, and back [s].
    `valve_area_mm2`: effective area of either way of the valve, fully open [mm2].
    `droop_bar_min_l`: what the regulator loses for each L/min that the motor takes at the line's state [bar min/L].
    `gas_j_kg`: gas constant times the line's temperature [J/kg].
    """

    def __init__(
        self,
        volume_l: float,
        valve_time_s: float,
        valve_area_mm2: float,
        regulator_lag_s: float,
        droop_bar_min_l: float,
        ambient_bar: float,
        gas_j_kg: float,
    ) -> None:
        self.ambient_bar, self.gas_j_kg = ambient_bar, gas_j_kg
        self.pressure_bar = self.regulated_bar = ambient_bar
        self.opened = 0.0  # share of the valve's way to the regulator
        self.entered_kg = 0.0  # through the regulator, since the start
        self._lag_s, self._droop = regulator_lag_s, droop_bar_min_l
        self._valve_time_s = valve_time_s
        self._stiffness_bar_kg = gas_j_kg / (volume_l * L) / BAR
        self._choked = ORIFICE * valve_area_mm2 * MM2 * BAR / math.sqrt(gas_j_kg)  # kg/s for each bar ahead

    def step(self, target_bar: float, is_open: bool, taken_kg_s: float, span_s: float) -> float:
        """Carry the line on, in small steps.

        `target_bar`: what the regulator is set to, absolute [bar].
        `taken_kg_s`: what the motor takes [kg/s].
        Returns mean pressure of the span, absolute [bar].
        """
        steps = max(1, math.ceil(span_s / STEP_S - 1e-9))
        dt_s = span_s / steps
        total = 0.0
        for _ in range(steps):
            before = self.pressure_bar
            self._valve(is_open, dt_s)
            if is_open or self.opened == 0.0:  # the valve is quicker to shut than the regulator to come down
                self._regulator(target_bar, taken_kg_s, dt_s)
            self._air(taken_kg_s, dt_s)
            total += 0.5 * (before + self.pressure_bar)
        return total / steps

    def _valve(self, is_open: bool, dt_s: float) -> None:
        way = 1.0 if is_open else 0.0
        share = dt_s / self._valve_time_s if self._valve_time_s > 0.0 else 1.0
        self.opened += min(share, max(-share, way - self.opened))

    def _regulator(self, target_bar: float, taken_kg_s: float, dt_s: float) -> None:
        flow_l_min = taken_kg_s * self.gas_j_kg / (self.pressure_bar * BAR) * 60e3
        wanted = max(self.ambient_bar, target_bar - self._droop * flow_l_min)
        self.regulated_bar += (wanted - self.regulated_bar) * -math.expm1(-dt_s / self._lag_s)

    def _air(self, taken_kg_s: float, dt_s: float) -> None:
        """The mass balance: what the motor took, then each way of the valve, backward Euler."""
        least = self.ambient_bar if taken_kg_s > 0.0 else 0.0  # a motor that runs on draws no vacuum
        self.pressure_bar = max(least, self.pressure_bar - dt_s * self._stiffness_bar_kg * taken_kg_s)
        before = self.pressure_bar
        self._through(self.opened, self.regulated_bar, dt_s)
        self.entered_kg += (self.pressure_bar - before) / self._stiffness_bar_kg
        self._through(1.0 - self.opened, self.ambient_bar, dt_s)

    def _through(self, share: float, far_bar: float, dt_s: float) -> None:
        """Let the line and what lies beyond an orifice come nearer to each other."""
        gap = far_bar - self.pressure_bar
        if share <= 0.0 or abs(gap) < LEAST_BAR:
            return
        high, ratio = max(far_bar, self.pressure_bar), min(far_bar, self.pressure_bar) / max(far_bar, self.pressure_bar)
        if ratio <= CRITICAL:
            root = high / math.sqrt(abs(gap))
        else:
            root = math.sqrt(high * (1.0 + ratio - 2.0 * CRITICAL)) / (1.0 - CRITICAL)
        rate = dt_s * self._stiffness_bar_kg * share * self._choked * root
        left = (0.5 * (math.sqrt(rate * rate + 4.0 * abs(gap)) - rate)) ** 2  # left + rate sqrt(left) = gap
        self.pressure_bar = far_bar - math.copysign(left, gap)
