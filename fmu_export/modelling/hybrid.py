"""A model with events and sampling, run in numpy: for reference results, by the rules that FMUs follow."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from fmu_export.errors import ModelError
from fmu_export.modelling.functions import rk4_step
from fmu_export.modelling.model import Event, Model
from fmu_export.modelling.variables import Array

#: Rounds of events at one instant, and events without time between them, before they are taken for endless.
MOST = 20


class EndlessEvents(ModelError, ArithmeticError):
    """Events set each other off, or happen again and again, so that a run does not go on."""


@dataclass(frozen=True)
class HybridState:
    """States, discrete states, and what decides on the next events.

    `sides` and `indicators` are those of the events where the states have arrived last, `counts` the instants of each
    sampler that are over. Of a new state the indicators have no side yet.
    """

    x: Array
    z: Array
    counts: tuple[int, ...]
    sides: Array
    indicators: Array
    is_new: bool = False


class HybridRun:
    """Runs a model with constant inputs from one instant to another; `p` are its parameters (n_p,)."""

    def __init__(self, model: Model, p: Array, longest_step: float) -> None:
        self.model, self.p, self.longest_step = model, p, longest_step
        values = dict(zip(model.parameters.names, p, strict=True))
        self.times = [
            (float(values.get(s.period, s.period)), float(values.get(s.offset, s.offset)))  # type: ignore[arg-type]
            for s in model.sampled
        ]

    def start(self, t: float) -> HybridState:
        """The initial states; nothing has happened yet."""
        counts = tuple(max(0, math.ceil((t - _equal(t) - offset) / period)) for period, offset in self.times)
        z = np.asarray(self.model.initial_discrete_state(self.p), dtype=float)
        none = np.zeros(len(self.model.events))
        return HybridState(
            np.asarray(self.model.initial_state(self.p), dtype=float), z, counts, none, none, is_new=True
        )

    def outputs(self, t: float, s: HybridState, u: Array) -> Array:
        """Outputs (n_y,)."""
        values = self.model.output_values(*self.model.arguments(t, s.x, s.z, u, self.p))
        return np.asarray(values, dtype=float)[: len(self.model.outputs)]

    def settled(self, t: float, s: HybridState, u: Array) -> HybridState:
        """What happens at this instant: samplers whose instant it is, then events until there are no more.

        Raises
        ------
        EndlessEvents
            Events set each other off without end.
        """
        if s.is_new:
            g = self._indicators(t, s, u)
            sides = np.where(
                g != 0.0, np.sign(g), [-1.0 if e.direction == "rising" else 1.0 for e in self.model.events]
            )
            s = replace(s, sides=sides, indicators=g, is_new=False)
            zero = [i for i, v in enumerate(g) if v == 0.0 and not self._is_before(t, s, u, i)]
            s = replace(s, sides=np.array([-side if i in zero else side for i, side in enumerate(sides)]))
        s = self._sampled(t, s, u)
        for _ in range(MOST + 1):
            happened = False
            for i, event in enumerate(self.model.events):
                s, now = self._reacted(t, s, u, i, event)
                happened |= now
            if not happened:
                return s
        raise EndlessEvents(f"{self.model.name}: events set each other off without end at t = {t!r} s")

    def advanced(self, t: float, s: HybridState, u: Array, end: float) -> HybridState:
        """From a settled state at t to another time, where nothing has happened yet.

        Raises
        ------
        EndlessEvents
            Events follow each other without time between them.
        """
        at_once = 0
        while t < end - _equal(end):
            target = min(
                [end, *(offset + k * period for (period, offset), k in zip(self.times, s.counts, strict=True))]
            )
            whole = target - t
            h = whole / max(1, math.ceil(whole / self.longest_step - 1e-9))
            x = self._stepped(t, s, u, h)
            if self._crossed(t + h, replace(s, x=x), u):
                short, h = 0.0, h
                while h - short > 1e-13 * (1.0 + abs(t)):
                    middle = 0.5 * (short + h)
                    crossed = self._crossed(t + middle, replace(s, x=self._stepped(t, s, u, middle)), u)
                    short, h = (short, middle) if crossed else (middle, h)
                s = replace(s, x=self._stepped(t, s, u, h))
                at_once = at_once + 1 if h < 1e-10 else 0
                if at_once > MOST:
                    raise EndlessEvents(f"{self.model.name}: an event happens again and again at t = {t!r} s")
            else:
                s = self._arrived(t + h, replace(s, x=x), u)
            t = target if h == whole else t + h
            if t < end - _equal(end):
                s = self.settled(t, s, u)
        return s

    def _stepped(self, t: float, s: HybridState, u: Array, h: float) -> Array:
        arguments = self.model.arguments

        def derivatives(t: float, x: Array, u: Array, p: Array) -> Array:
            return self.model.derivatives(*arguments(t, x, s.z, u, p))

        return rk4_step(derivatives, t, s.x, u, self.p, h) if len(s.x) else s.x

    def _indicators(self, t: float, s: HybridState, u: Array) -> Array:
        arguments = self.model.arguments(t, s.x, s.z, u, self.p)
        return np.array([float(np.asarray(e.indicator(*arguments)).item()) for e in self.model.events])

    def _is_before(self, t: float, s: HybridState, u: Array, i: int) -> bool:
        """Whether an indicator that is zero counts as before its crossing: it leaves, or rests and is pulled across."""
        h, change = 1e-3 * self.longest_step, 0.0
        now = self._indicators(t, s, u)[i]
        for step in (1, 2):
            if len(s.x):
                arguments = self.model.arguments(t + (step - 1) * h, s.x, s.z, u, self.p)
                s = replace(s, x=s.x + h * np.asarray(self.model.derivatives(*arguments), dtype=float))
            change = s.sides[i] * (self._indicators(t + step * h, s, u)[i] - now)
            if step == 1 and change != 0.0:
                return bool(change > 0.0)
        return bool(change != 0.0)

    def _armed(self, s: HybridState) -> Array:
        directions = np.array([{"falling": 1.0, "rising": -1.0, "both": 0.0}[e.direction] for e in self.model.events])
        return directions != -s.sides

    def _crossed(self, t: float, s: HybridState, u: Array) -> bool:
        g, before = s.sides * self._indicators(t, s, u), s.sides * s.indicators
        return bool((self._armed(s) & (g <= 0.0) & (g < before)).any())

    def _arrived(self, t: float, s: HybridState, u: Array) -> HybridState:
        g = self._indicators(t, s, u)
        passed = (s.sides * g < 0.0) & ~self._armed(s)
        return replace(s, sides=np.where(passed, -s.sides, s.sides), indicators=g)

    def _sampled(self, t: float, s: HybridState, u: Array) -> HybridState:
        arguments = self.model.arguments(t, s.x, s.z, u, self.p)
        z, counts = s.z.copy(), list(s.counts)
        for i, ((period, offset), sampled) in enumerate(zip(self.times, self.model.sampled, strict=True)):
            if offset + counts[i] * period <= t + _equal(t):
                after = np.asarray(sampled.update(*arguments), dtype=float)
                z = np.where(after != s.z, after, z)
                counts[i] += 1
        return replace(s, z=z, counts=tuple(counts))

    def _reacted(self, t: float, s: HybridState, u: Array, i: int, event: Event) -> tuple[HybridState, bool]:
        """The state after an event, if it has happened, and whether it has."""
        side = s.sides[i]
        g = side * self._indicators(t, s, u)[i]
        happens = bool(self._armed(s)[i] and g <= 0.0 and g < side * s.indicators[i])
        leaves = g < 0.0 and not self._armed(s)[i]
        if happens:
            after = event.reset(*self.model.arguments(t, s.x, s.z, u, self.p))
            x, z = after if len(s.z) else (after, s.z)
            s = replace(s, x=np.asarray(x, dtype=float), z=np.asarray(z, dtype=float))
            late, g = g, side * self._indicators(t, s, u)[i]
            leaves = g < late or (g <= 0.0 and not self._is_before(t, s, u, i))
        sides, indicators = np.array(s.sides), np.array(s.indicators)
        sides[i], indicators[i] = (-side if leaves else side), side * g
        return replace(s, sides=sides, indicators=indicators), happens


def _equal(t: float) -> float:
    return 1e-12 * (1.0 + abs(t))
