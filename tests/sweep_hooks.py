"""What a run is given, where a test gives none of it: a guard that refuses nothing, and nobody who watches."""

from configs.units import BAR
from rig.interlock.step import Verdict
from rig.sweep.hooks import Hooks, Silent


def hooks(**given):
    """The hooks of a run, with some of its own."""
    nothing = {
        "predict": lambda level_bar_abs, plateaus: Verdict(True, "no guard", level_bar_abs * BAR),
        "trip": lambda view, now_ns, pressurised: None,
        "stops": lambda: 0,
        "progress": Silent(),
        "person": Silent(),
        "on_plateau": lambda plateau: None,
        "expect": lambda bar_abs, plateaus: None,
    }
    return Hooks(**(nothing | given))
