"""The levels of a sweep in their order."""

from __future__ import annotations

import math
import random
from collections.abc import Collection, Sequence
from dataclasses import dataclass

UP, DOWN = "up", "down"
SAME_BAR = 1e-6  # levels closer than this are the same
STONE_GRID_BAR = 0.01
LEAST_STONE_BAR = 0.02  # above what was taken: less teaches the guard nothing


class SweepError(ValueError):
    """A sweep cannot be run as it was asked for. The text says why and what to change."""


@dataclass(frozen=True)
class Step:
    """One plateau to be taken.

    `direction`: ``up`` or ``down``: from which side the level is approached, or for the first of a falling leg, the
        leg.
    `by_way_of_bar_abs`: a higher pressure to go to first [bar]: a level of a falling leg is never approached from
        below, also where the levels above it are left out.
    """

    level_bar_abs: float
    direction: str
    repeat: int
    by_way_of_bar_abs: float | None = None

    @property
    def key(self) -> tuple[float, str, int]:
        """What makes it the same step in another run of the same sweep."""
        return (round(self.level_bar_abs / SAME_BAR) * SAME_BAR, self.direction, self.repeat)


def plan(
    levels_bar_abs: Sequence[float],
    order: str = "up-down",
    repeats: int = 1,
    seed: int = 1,
    finished: Collection[Step] = (),
) -> list[Step]:
    """The steps of a sweep.

    `levels_bar_abs`: absolute pressures [bar], in any order; a level that stands twice is taken once.
    `order`: ``up``, ``down``, ``up-down`` (the top level is the last of the rising leg and the first of the falling
        one), ``down-up`` (likewise with the lowest), or ``random``: each repeat in its own order.
    `finished`: what an earlier run of this sweep has taken; left out here.
    They are in order. Raises SweepError when there is no level, or an order of another name.
    """
    rising = sorted({round(level, 9) for level in levels_bar_abs})
    if not rising:
        raise SweepError("a sweep needs at least one level: give levels_bar_abs in [sweep]")
    generator = random.Random(seed)
    steps: list[Step] = []
    for repeat in range(1, repeats + 1):
        if order == "random":
            steps += _shuffled(rising, repeat, generator, steps)
        else:
            steps += [step for leg in _legs(order) for step in _leg(rising, leg, repeat)]
    return _left(steps, finished, order)


def stepping_stone(level_bar_abs: float, highest_bar_abs: float, taken_bar_abs: Sequence[float]) -> float | None:
    """A level to take before one that the guard refuses: from there it sees farther.

    `level_bar_abs`: refused [bar].
    `highest_bar_abs`: the highest that would be allowed now [bar].
    `taken_bar_abs`: levels of the plateaus so far, or the room's pressure [bar].
    In hundredths of a bar; None where it would be no step worth the time.
    """
    stone = math.floor(highest_bar_abs / STONE_GRID_BAR + 1e-6) * STONE_GRID_BAR
    if stone >= level_bar_abs or stone < max(taken_bar_abs) + LEAST_STONE_BAR:
        return None
    return round(stone, 9)


def _legs(order: str) -> tuple[str, ...]:
    if order not in ("up", "down", "up-down", "down-up"):
        raise SweepError(f"the order '{order}' is not one of up, down, up-down, down-up, random")
    return tuple(order.split("-"))


def _leg(rising: list[float], direction: str, repeat: int) -> list[Step]:
    levels = rising if direction == UP else rising[::-1]
    return [Step(level, direction, repeat) for level in levels]


def _shuffled(rising: list[float], repeat: int, generator: random.Random, before: list[Step]) -> list[Step]:
    levels = rising.copy()
    generator.shuffle(levels)
    last = before[-1].level_bar_abs if before else 0.0
    steps = []
    for level in levels:
        steps.append(Step(level, UP if level >= last else DOWN, repeat))
        last = level
    return steps


def _left(steps: list[Step], finished: Collection[Step], order: str) -> list[Step]:
    """The steps that are not finished, each approached from the side that it says."""
    if order == "random":  # the side depends on the neighbour; a level is done when its repeat is
        done = {(step.key[0], step.repeat) for step in finished}
        left = [step for step in steps if (step.key[0], step.repeat) not in done]
    else:
        taken = {step.key for step in finished}
        left = [step for step in steps if step.key not in taken]
    return [_from_its_side(step, left[index - 1] if index else None, steps) for index, step in enumerate(left)]


def _from_its_side(step: Step, before: Step | None, steps: list[Step]) -> Step:
    start = before.level_bar_abs if before else 0.0
    if step.direction == UP or start >= step.level_bar_abs:
        return step
    above = [other.level_bar_abs for other in steps if other.level_bar_abs > step.level_bar_abs]
    return Step(step.level_bar_abs, step.direction, step.repeat, min(above)) if above else step
