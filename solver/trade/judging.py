"""Whether a setting keeps the limits of a scene: on growing parts of its maneuver, on those that serve to choose, and elsewhere."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path

from solver.errors import MbdError
from solver.scene import Scene
from solver.trade.measurements import Measurements
from solver.trade.requirements import Bound
from solver.trade.runs import Going, Stopped, all_of
from solver.trade.setting import Setting
from solver.trade.variations import AS_GIVEN, Variation
from solver.trade.verdicts import Check, Verdict

MARGIN = 0.1  # of every limit that the error itself leaves free
PARTS = (0.25, 0.5, 1.0)  # of the maneuver, in the race


def largest_of(shares: dict[str, float]) -> tuple[str, float]:
    """The requirement whose share of its limit is largest, and that."""
    return max(shares.items(), key=lambda item: item[1])


class Judge(Measurements):
    """Measures, and judges by it."""

    def __init__(
        self, scene: Scene, *, workers: int | None, longest: float, progress: Callable[[str, float], None], keep_in: Path | None = None
    ) -> None:
        super().__init__(scene, workers=workers, longest=longest, progress=progress, keep_in=keep_in)
        self._lost: dict[Setting, tuple[str, float, float]] = {}  # settings that lost a race, and how

    def race(self, setting: Setting) -> tuple[str, float, float]:
        """(why a setting is out, '' if it is not; largest share of a limit; part) on growing parts of the scene's own maneuver.

        The largest error so far and the integral of its square only grow, so what is too large after a part stays so.
        """
        v = AS_GIVEN
        if setting in self._lost:
            return self._lost[setting]
        own, model = self.own_limit(v, setting), self.model_error(v, setting)
        known = self.known(v, setting)
        settled = self.known(v, dataclasses.replace(setting, iterations=None))
        if settled and not settled.failure and not known:
            step = self.part(settled, own)
            worst, used = largest_of(self.shares(v, {r: model[r] + step[r] for r in self.requirements}))
            if not used <= 1.0:
                return self._lost.setdefault(setting, (f'{worst}: {used:.2g} of its limit with any number of iterations', used, 1.0))
        going = None if known else Going(self.maneuver(v), setting, self.everything, stop=self.late)
        used, worst = math.inf, ''
        for part in PARTS if going else PARTS[-1:]:
            found = known or going.to(part * self.scene.duration)  # type: ignore[union-attr]
            if found.failure:
                return self._lost.setdefault(setting, (found.failure, math.inf, part))
            errors = self.part(found, own)
            grown = {'max': 1.0, 'rms': math.sqrt(part), 'delay': 1.0}  # what it has reached of the whole by then
            for r in self.requirements:
                if r.measure == 'delay' and part < 1.0:
                    errors[r] = 0.0  # it may shrink again, and may not be there yet: an infinite one is no reason either
            worst, used = largest_of(self.shares(v, {r: model[r] + grown[r.measure] * errors[r] for r in self.requirements}))
            if not used <= 1.0:
                return self._lost.setdefault(setting, (f'{worst}: {used:.2g} of its limit after {part:.0%} of the maneuver', used, part))
        self.keep(v, setting, found)
        return '', used, 1.0

    def judge(self, setting: Setting) -> Verdict:
        """Whether a setting keeps everything on the maneuvers that serve to choose."""
        expected = self.expected(setting)
        try:
            dropped, used, part = self.race(setting)
            if dropped:
                return Verdict(setting, used, expected, dropped.partition(':')[0], dropped, {}, part=part)
            expected = self.expected(setting, self.known(AS_GIVEN, setting))
            worst: dict[str, Bound] = {}
            largest = 0.0
            for v in self.seen:
                if v != AS_GIVEN:
                    settled = dataclasses.replace(setting, iterations=None)
                    work: list[Callable[[], object]] = [lambda: self.findings(v, setting), lambda: self.run(v, settled)]  # noqa: B023
                    all_of(lambda make: make(), work, self.workers)
                for bound in self.bounds(v, setting):
                    name = str(bound.requirement)
                    if name not in worst or bound.used > worst[name].used or math.isnan(bound.used):
                        worst[name] = bound
                used = max(b.used for b in worst.values())
                if not used <= 1.0:
                    name = max(worst, key=lambda n: worst[n].used)
                    return Verdict(setting, used, expected, name, f'{name}: {used:.2g} of its limit on {v}', worst)
                itself = self.check(setting, v)
                largest = max(largest, itself.used)
                if not largest <= 1.0 - MARGIN:
                    why = f'{itself.worst}: the error itself is {largest:.2g} of its limit on {v}, which leaves no margin'
                    return Verdict(setting, used, expected, itself.worst, why, worst, largest)
                broken = self.broken(v, setting)
                if broken:
                    return Verdict(setting, used, expected, itself.worst, f'{broken} ({v})', worst, largest, broken=broken)
        except Stopped:
            raise
        except MbdError as error:
            return Verdict(setting, math.inf, expected, '', str(error), {})
        name = max(worst, key=lambda n: worst[n].used)
        return Verdict(setting, used, expected, name, '', worst, largest)

    def check(self, setting: Setting, v: Variation) -> Check:
        """The error itself, with the band of the reference, on a maneuver."""
        try:
            truth, found = self.truth(v), self.run(v, setting)
        except Stopped:
            raise
        except MbdError as error:
            return Check(v, math.inf, '', f'the reference: {error}')
        if found.failure:
            return Check(v, math.inf, '', found.failure)
        worst, used = largest_of(self.shares(v, self.part(found, truth)))
        return Check(v, used, worst, '')

    def check_whole(self, setting: Setting, v: Variation) -> Check:
        """As check(), and whether the run, which serves for both, is sound."""
        broken, found = self.broken(v, setting), self.check(setting, v)
        return found._replace(failure=broken) if broken and found.passed else found
