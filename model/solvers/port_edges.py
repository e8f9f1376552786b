"""At an edge: where the next one is, and what a cylinder takes over from its port there."""

from __future__ import annotations

import math

import numpy as np

from configs.compiled import njit
from model import geometry
from model import layout as at
from model.gas.cylinder import CLOSED, INLET, open_port, port_at
from model.solvers.crank_angle import (
    H_IN,
    H_OUT,
    M_IN,
    M_OUT,
    OMEGA,
    P0,
    THETA,
    runge_kutta,
)

ON_EDGE = 1e-12  # rad: an edge is met when the angle is this near, and then taken exactly
ON_THE_WAY, AT_EDGE, STOPPED = 0, 1, 2


# Numba takes arrays one by one; in one piece, its parts share their running values: `model.solvers`.
@njit(error_model="numpy", cache=True)
def locate(
    y: np.ndarray,
    h: float,
    h_most: float,
    target: float,
    work: np.ndarray,
    port: np.ndarray,
    sense: float,
    T_port: np.ndarray,
    parameters: np.ndarray,
    c: np.ndarray,
    gas: np.ndarray,
    readings: np.ndarray,
) -> tuple[float, int]:
    """Step until the angle ``target``, the time ``h_most`` or standstill, whichever comes first.

    `h`, `h_most`: first guess of the step and its upper limit [s].
    `target`: angle ahead at which the step has to end [rad].
    Returns `h`: the step taken [s]; `event`: ON_THE_WAY (time is up), AT_EDGE or STOPPED.
    """
    low, high = 0.0, math.inf
    event = ON_THE_WAY
    for _ in range(60):
        runge_kutta(y, h, work, port, sense, T_port, parameters, c, gas, readings)
        omega = sense * work[4, OMEGA]
        beyond = sense * (work[4, THETA] - target)
        if not math.isfinite(omega):
            break
        if abs(omega) < 1e-12 and event == STOPPED:
            break
        if omega < 0.0:
            high, event = h, STOPPED
        elif beyond > ON_EDGE:
            high, event = h, AT_EDGE
        elif beyond >= -ON_EDGE:
            event = AT_EDGE
            break
        elif event == ON_THE_WAY and h >= h_most:
            break
        else:
            low = h
        if high - low <= 1e-16:
            break
        if event == STOPPED:
            guess = h - work[4, OMEGA] / work[3, OMEGA]
        else:  # Newton, with the acceleration's share
            late = beyond / max(omega, 1e-30)
            guess = h - late - 0.5 * sense * work[3, OMEGA] * late * late / max(omega, 1e-30)
        if high == math.inf:
            h = min(guess, h_most)
        elif low < guess < high:
            h = guess
        else:
            h = 0.5 * (low + high)
    return h, event


@njit(error_model="numpy", cache=True)
def take_port(
    y: np.ndarray, i: int, which: int, P_p: float, T_p: float, n: int, c: np.ndarray, gas: np.ndarray
) -> None:
    """Cylinder ``i`` takes the pressure of a port at once; the exchange is booked.

    `y`, shape (9 + 2 n,): state [SI], changed.
    `i`, `which`: cylinder, and OUTLET or INLET.
    `P_p`, `T_p`: pressure [Pa] and temperature [K] behind the port.
    `n`: cylinders [-].
    """
    P, T = P0 + i, P0 + n + i
    psi = (y[THETA] + i * c[at.PITCH]) % c[at.LOBE_ANGLE]
    L4, _, _, _ = geometry.place(psi, c)
    V = geometry.volume(L4, c[at.A_P], c[at.V_OFFSET])
    R, cp = gas[at.GAS_R], gas[at.GAS_CP]
    U = (cp - R) / R * y[P] * V
    y[T], dm = open_port(y[P], y[T], V, P_p, T_p, gas)
    y[P] = P_p
    dU = (cp - R) / R * P_p * V - U
    if which == INLET:
        y[M_IN] += dm
        y[H_IN] += dU
    else:
        y[M_OUT] -= dm
        y[H_OUT] -= dU


@njit(error_model="numpy", cache=True)
def set_ports(
    y: np.ndarray,
    port: np.ndarray,
    mid: float,
    P_port: np.ndarray,
    T_port: np.ndarray,
    lap: float,
    c: np.ndarray,
    gas: np.ndarray,
) -> None:
    """See which port each cylinder has around the angle ``mid``; those that open take its pressure.

    `y`, shape (9 + 2 n,): state [SI], changed.
    `port`, shape (n,): ports, changed.
    `mid`: an angle inside the interval that begins [rad].
    `P_port`, `T_port`, shape (2,): pressure [Pa] and temperature [K] behind outlet and inlet.
    `lap`: port lap [rad].
    """
    lobe = c[at.LOBE_ANGLE]
    for i in range(port.size):
        port[i] = port_at((mid + i * c[at.PITCH]) % lobe, lap, lobe)
        if port[i] != CLOSED and y[P0 + i] != P_port[port[i]]:
            take_port(y, i, port[i], P_port[port[i]], T_port[port[i]], port.size, c, gas)
