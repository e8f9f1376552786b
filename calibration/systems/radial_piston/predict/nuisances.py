"""The nuisances of a recording of the motor, and where the value of each goes."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from calibration.data.blocks import Blocks
from calibration.systems.radial_piston.predict import wheel
from calibration.systems.radial_piston.predict.in_time import BEGUN, BEHIND
from calibration.systems.radial_piston.predict.supply import line_unknowns
from calibration.unknowns.priors import Error, OfInstrument, OfRun, Unknown, unknown_of_run, unknowns
from model.motor import QUANTITIES, Motor
from rig.recording import Recording
from rig.recording.columns import OF_CHANNEL

TURN_SD = 2.0 * math.pi / math.sqrt(12.0)  # of an angle that may be anywhere in a turn [rad]
BEGUN_SD = 0.1  # share by which a start from rest may be off where it is compared from: how it broke away nobody knows
VENTED = "vented_span_share"  # of a gauge's span error that shows at ambient pressure
TURN = "turn"  # of a run
MOTOR = "motor"

# The motor's parameters, each channel's offset and scale, and by file what is a run's own.
Split = tuple[np.ndarray, dict[str, tuple[float, float]], dict[str, dict[str, float]]]


class Destination(NamedTuple):
    """Where a nuisance's value goes: into the motor's parameters, a channel's errors or what a run has of its own.

    `place`: its index there, or of a run's own what it is. `to_si`: what it is multiplied by [-].
    """

    of: str
    place: Any
    to_si: float


def destination(unknown: Unknown) -> Destination:
    """Where a nuisance's value goes."""
    match unknown.of:
        case OfInstrument(channel, Error.SCALE):
            return Destination(channel, 1, 1.0)
        case OfInstrument(channel):
            return Destination(channel, 0, OF_CHANNEL[channel].to_si)
        case OfRun(file, what):
            return Destination(file, what, 1.0)
    if unknown.name == VENTED:
        return Destination(VENTED, 0, 1.0)
    return Destination(MOTOR, list(QUANTITIES).index(unknown.name), QUANTITIES[unknown.name].to_si)


def nuisances_of(motor: Motor, recording: Recording, blocks: Blocks, any_turn: bool) -> list[Unknown]:
    """The nuisances: of motor and instruments, of each run in time, of the gauge.

    `any_turn`: whether how the shaft stood is not known of any run.
    """
    everything = unknowns(motor, recording)
    found = [u for u in everything if not (isinstance(u.of, OfInstrument) and u.of.error is Error.NOISE)]
    for run in blocks.runs:
        found += line_unknowns(run, recording.supply) + wheel.wheel_unknowns(run, recording)
        if run.from_rest:
            sd = math.hypot(BEGUN_SD, run.stood)  # once caught, it may have broken away at any time since
            found.append(unknown_of_run(run.file, BEGUN, "-", "normal", 0.0, sd, "nobody set it"))
            if recording.channels["speed_rpm"].lag_s:
                found.append(unknown_of_run(run.file, BEHIND, "-", "normal", 0.0, sd, "nor how suddenly"))
    # A torque that follows the shaft is told from where that stood in the first run.
    for run in blocks.runs[0 if any_turn else 1 :]:
        found.append(unknown_of_run(run.file, TURN, "rad", "normal", 0.0, TURN_SD, "nobody noted it"))
    if blocks.vented.pressure.size:
        found.append(Unknown(VENTED, "-", "normal", 0.5, 0.5, "where a gauge's span begins is not stated"))
    return found
