"""The search for a formula: products one at a time, each settled beside all before, with a price for every number."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from edge_daemon.discover.factors import CLOCK, KINDS, ONE_WAY, PLACE, Factor, Product
from edge_daemon.discover.leftover import Leftover
from edge_daemon.discover.memory import moved, roughly_timed, timed, with_beginning
from edge_daemon.discover.past_axes import LATE_AXIS, LATER, allowed, family, late_axes, reads, row_of
from edge_daemon.discover.refining import ROUNDS, Formula, leaps, settled
from edge_daemon.discover.screening import Library, Promise, Screening
from edge_daemon.effects.effect import Balance
from edge_daemon.search.hypotheses import LEAST_FLOOR, Progress

PRICE = 0.01
"""Relative error that a number must remove to be worth having."""
WORTH = 0.8
"""Error of a longer formula over that of the shorter one below which it is believed (guess)."""
REACHED_FLOORS, NO_NOISE_FLOORS = 1.15, 0.9
"""Error over the noise floor at which nothing is left to explain, and below which that floor is too high (guess)."""
EXACT_FLOORS, EXACT_SHARE = 1.6, 0.01
"""Error over the noise floor, and over that before, below which a law is found: right ones leave up to 1.3 floors, one
of a wrong shape 2.6, and what a further product mends is what the measured motion does not carry."""
NEAR_FLOORS, NEAR_SHARE = 3.0, 0.05
"""Error over the noise floor, and over that before, below which a law that turns round is all but found: more mends its
roughness. A smooth one is measured as it is, and what it leaves is its own error."""
SHARP_SHARE = 0.03
"""Error over that before, below which the same is taken for granted at any noise: a measured rate carries the reversal
of dry friction no better (2.4 to 5 % with the exact law)."""
SINGLES = 15
"""Promises of one factor, which are settled in any case: the simplest is worth a look."""
SETTLED_WHOLE, SETTLED_FURTHER = 8, 3
"""Promises of one list that are settled on all rows: alone, and beside what was found."""
AROUND = 9
"""The same around a product that is known."""
FIRST_ROUNDS, GONE_ON = 3, 3
"""Steps on few rows after which the better go on, and how many of those for each that is settled on all."""
WHOLE_ROUNDS = 6
"""Steps there: few rows have led near."""
ROUGHLY = 2.5
"""Error on few rows over the least there up to which all rows decide."""
FIRST, MULTIPLIED, NEXT = 52, 32, 26
"""Promises that are settled: of one product, of one more factor, of a further product."""
LEVELLED = 24
"""Products of two factors that are tried beside one of these alone."""
LEVELS = ("step", "sine", "bump", "spot", "exponential")
"""Kinds along which a law often has a part that stays."""
EXCHANGED = 8
"""Promises that are settled in the place of one factor."""
EXCHANGE_SHARE = 0.99
"""Error over that before, up to which an exchange of factors has led on (guess)."""
BEAM = 2
"""Formulas that are gone on with."""
ROUGHLY_TIMED, TIMED = 8, 3
"""Formulas whose times are made to fit after each stage, on few rows and on all."""
BRANCHES, ALIKE = 4, 2
"""Products that are multiplied by one more factor, and how many of them may hold the same axes."""
ENTRANCES = 8
"""Products of one factor that are modulated (a quarter of a second each, guess)."""
MOST_PRODUCTS = 3
"""Summands of a formula: with more it is a curve, no law."""
MOST_FACTORS = 3
"""Factors of a product: an entrance, and a law of two axes."""
MOST_OF_CLOCK = 1
"""Events and, in a drive balance, waves of the clock that a formula may tell: what was switched on once is a law, and
so is a hum, but no more."""
ONCE_S, ONCE_SHARE = 1.0, 0.9
"""A product of whose square so much lies in so short a stretch speaks of what happened once, and is no law (guess)."""
FORMS = 2
"""Formulas of what comes late whose other kinds are tried."""
PROMISED_LATE = 2
"""Promises of each channel that are tried late."""
TAKEN_OVER = 16
"""Formulas of a search that are tried as what an encoder misreads (guess)."""
FAR_BEHIND, FAR_FLOORS = 3.0, 4.0
"""Error of the best product over what the catalogue comes to, and over the noise floor, beyond which no formula is
looked for (guesses): a bare model of a machine lacks several laws, which a sum of products retells at length. Those
that were told beside a cause, of 70 laws, left less than it did from their first product on."""
LEFT_BEHIND, LEFT_FLOORS = 1.05, 2.0
"""Error of the best product, its factors chosen anew, over what the catalogue comes to, and over the noise floor,
beyond which no second one is looked for: in 18 searches for a law beside a rival it left 0.03 to 1.02 of that; near the
noise two laws, each of a floor or two, may be one formula (guess)."""
HOPELESS = 1.5
"""Error over the least so far above which a promise is given up after some steps."""


def _about_any_angle(promises: Sequence[Promise]) -> list[Promise]:
    """What goes with the output's angle, from one on that nobody knows: a hose pulls to where it was cut to length."""
    line, angle = Product((Factor(KINDS["affine"], PLACE),)), Product((Factor(KINDS["power_1"], PLACE),))
    return [replace(row, product=line) for row in promises if row.product == angle]


class FormulaSearch:
    """One search under way; `floor` is the rms that sensor noise leaves, `rival` what the catalogue comes to, `most`
    the products that are worth telling beside it, `far` what the best one may leave to be gone on with."""

    def __init__(
        self,
        leftover: Leftover,
        floor: float,
        progress: Progress,
        rival: float = math.inf,
        most: int = MOST_PRODUCTS,
        far: float | None = None,
    ) -> None:
        self.leftover, self.floor, self.progress = leftover, floor, progress
        self.rival, self.most = rival, most
        self.far = max(FAR_BEHIND * rival, FAR_FLOORS * floor) if far is None else far
        self.first = math.inf
        """rms that the best product left"""
        self.found: list[Formula] = []
        self.promises: list[Promise] = []
        self.at_their_times: set[tuple[Product, ...]] = set()

    @cached_property
    def screening(self) -> Screening:
        """Of all that is left."""
        return Screening(self.library, self.leftover.left)

    @cached_property
    def library(self) -> Library:
        """What every screening tries."""
        return Library(self.leftover)

    def begin(self) -> None:
        """The best product of all."""
        promises = self.promises = self.screening.promises()
        alone = [row for row in promises if len(row.product.factors) == 1][:SINGLES]
        self._settle([], [*alone, *_about_any_angle(alone)], 0.0)
        self._modulate(self._entrances(), 0.05)
        singles = {row.product for row in promises if len(row.product.factors) == 1}
        self._settle([], [row for row in promises[:FIRST] if row.product not in singles], 0.1)
        self.first = self.least * self.floor

    def run(self) -> list[Formula]:
        """Everything that was settled, best first; nothing where no product comes near the rival."""
        if not self.promises:
            self.begin()
        if self.first > self.far:
            return []
        self._time()
        if not self.reached and self.most > 1:
            self._level(self.promises, 0.2)
        if not self.reached:
            for product in self._leading():
                further = self.screening.multiplied(product)
                self._settle([], further[:MULTIPLIED], 0.3)
        if not self.reached:
            self._modulate(self._leading(), 0.4)
        self._exchanged(0.45)
        if self.most > 1 and self.least > max(LEFT_BEHIND * self.rival / self.floor, LEFT_FLOORS):
            return []
        self._come_late()
        self._time()
        for count in range(1, self.most):
            if self.reached:
                break
            for formula in self._beams(count):
                further = Screening(self.library, formula.left).promises()
                self._settle(formula.products, further[:NEXT], 0.3 + 0.2 * count)
            self._time()
            self._exchange_beside()
        if self.reached:  # what leaves noise alone may hold a factor that only looks right where the gear was
            self._exchange_on()
        return self.best(len(self.found))

    def _beams(self, count: int) -> list[Formula]:
        """The best formulas of so many products, also where longer ones do better; beside one of long products, which
        may hold two laws in one, the best of shorter ones; and the best that tells of no channel of the first: another
        law may be there beside the one that those imitate."""
        found = [f for f in self.best(len(self.found)) if len(f.products) == count]
        near = ([f for f in self.best(2 * BEAM) if len(f.products) == count] or found)[:BEAM]
        short = next((f for f in found if all(len(row.factors) < MOST_FACTORS for row in f.products)), None)
        other = next((f for f in found if channels_of(f.products).isdisjoint(channels_of(found[0].products))), None)
        rows = {f.products: f for f in (*near[:1], short, *near[1:]) if f is not None}
        return list({f.products: f for f in (*list(rows.values())[:BEAM], other) if f is not None}.values())

    def taken_over(self, every: Sequence[Formula]) -> list[Formula]:
        """The best formulas of another search as they are here, and with one factor or the other in place of theirs;
        best first."""
        self._on_few_then_all([f.products for f in every[:TAKEN_OVER]], SETTLED_WHOLE)
        self._exchange(0.9)
        self._exchange_beside()
        return self.best(len(self.found))

    def around(self, product: Product) -> list[Formula]:
        """A friction that is known to be there, alone, times one further factor, and beside that; best first. It never
        is negative, as a wave alone would be."""
        self._on_few_then_all([[product]], 1)
        screening = Screening(self.library, self.found[0].left)
        further = [row.product for row in screening.multiplied(product)][:MULTIPLIED]
        alone = ([row] for row in further if not row.waves)
        self._on_few_then_all([*([product, row] for row in further), *alone], AROUND)
        return self.best(len(self.found))

    def _come_late(self) -> None:
        """What a sensor beside the joint told before in the place of what it tells: where it sits, all may come later
        than in the teeth, or earlier. Then any kind that a law holds of it there."""
        late = [] if self.reached else self._late()
        tries = [list(f.products) for f in late]
        for formula in late:
            tries += self._in_other_forms(formula.products)
        self._on_few_then_all(tries, SETTLED_FURTHER)
        self._on_few_then_all(self._in_the_other_way(), SETTLED_FURTHER)

    def _in_the_other_way(self) -> list[list[Product]]:
        """The best formula of a channel as it was, delayed where it followed that, or the other way round: which of the
        two it is shows only beside the right kind."""
        for products in (f.products for f in self.best(TIMED)):
            late = {f.axis: LATE_AXIS.fullmatch(f.axis) for product in products for f in product.factors}
            for axis, read in late.items():
                if read is not None and self.leftover.beside & {read[2]}:
                    others = [other for word in LATER if word != read[1] for other in late_axes(word, read[2])]
                    return [list(moved(products, axis, other)) for other in others]
        return []

    def _late(self) -> list[Formula]:
        """The best formulas that tell channels beside the joint as they were, and the best of those of which every time
        was tried: of each the best at the times that were looked at first, and the shortest."""
        rough, fine = [], []
        for channel in sorted(self.leftover.beside):
            told = self._telling(channel)
            for word in LATER:
                axes = late_axes(word, channel)
                for axis in axes:
                    self.leftover.make(axis)
                every = (self._roughly([moved(row, channel, axis) for axis in axes], FIRST_ROUNDS)[:1] for row in told)
                best = sorted(itertools.chain(*every), key=lambda f: f.square)
                rough += best
                few = [*best[:1], *sorted(best[1:], key=lambda f: f.price)[:1]]
                whole = (settled(self.leftover, f.products, FIRST_ROUNDS) for f in few)
                fine += [self._timed(f) for f in whole if f is not None]
        self.found += [f for f in fine if not self._strained(f)]
        best = sorted(rough, key=lambda f: f.square)[:FORMS]
        return [*best, *sorted(fine, key=lambda f: f.square)[:FORMS]]

    def _telling(self, channel: str) -> list[tuple[Product, ...]]:
        """The best formulas that tell of a channel, at any rate without the clock, which imitates what comes late."""
        every = [f.products for f in self.best(len(self.found))]
        told = [(products, {f.axis for product in products for f in product.factors}) for products in every]
        found = [products for products, axes in told[:TIMED] if channel in axes]
        found += [products for products, axes in told if channel in axes and CLOCK not in axes][:1]
        promised = [(row.product, {f.axis for f in row.product.factors}) for row in self.promises]
        found += [(product,) for product, axes in promised if channel in axes and CLOCK not in axes][:PROMISED_LATE]
        return list(dict.fromkeys(found))

    def _in_other_forms(self, products: Sequence[Product]) -> list[list[Product]]:
        """The formula with each factor of what was as every kind that a law holds of it."""
        out = []
        for i, product in enumerate(products):
            for j, factor in enumerate(product.factors):
                kinds = allowed(factor.axis) if row_of(factor.axis) else ()
                others = [Factor(KINDS[name], factor.axis, numbers) for name in kinds or ()
                          for numbers in KINDS[name].grid(self.leftover.spans[factor.axis])]  # fmt: skip
                for other in others:
                    changed = Product((*product.factors[:j], other, *product.factors[j + 1 :]))
                    out.append([*products[:i], changed, *products[i + 1 :]])
        return out

    def _timed(self, formula: Formula) -> Formula:
        """A formula at the times that leave least; as it is where none leave less."""
        rough = roughly_timed(self.leftover, formula) or formula
        found = timed(self.leftover, rough.products)
        return formula if found is None or found.square > formula.square else found

    def _time(self) -> None:
        """The best formulas that follow what was at the times with which they do, on few rows with other kinds and with
        what was before the recording beside, the best of those on all."""
        kinds = [f for f in self._following() if f.products not in self.at_their_times]
        self.at_their_times |= {formula.products for formula in kinds}
        rough = [f for f in (roughly_timed(self.leftover, formula) for formula in kinds) if f is not None]
        others = [forms for f in rough for forms in self._in_other_forms(f.products)]
        told = [*(f.products for f in rough), *map(tuple, others)]
        others += [list(with_beginning(self.leftover, products)) for products in told]
        rough += self._on_few(others, SETTLED_WHOLE)
        for formula in [f for f in sorted(rough, key=priced) if not self._strained(f)][:TIMED]:
            found = timed(self.leftover, formula.products)
            if found is not None and not self._strained(found):
                self.at_their_times.add(found.products)
                self.found.append(found)

    def _following(self) -> list[Formula]:
        """The best formulas that follow what was, each of other kinds or axes, the shortest, and all of one factor: the
        right kind may look worse than another at a wrong time."""
        best: dict[object, Formula] = {}
        for formula in self.best(len(self.found)):
            factors = [factor for product in formula.products for factor in product.factors]
            if any(row_of(factor.axis) is not None for factor in factors):
                best.setdefault(frozenset((factor.kind.name, family(factor.axis)) for factor in factors), formula)
        rows = list(best.values())
        rest = sorted(rows[ROUGHLY_TIMED:], key=lambda f: f.price)
        single = (f for f in rest[1:] if len(f.products) == 1 and len(f.products[0].factors) == 1)
        return [*rows[:ROUGHLY_TIMED], *rest[:1], *single]

    def _level(self, promises: Sequence[Promise], share: float) -> None:
        """Products of two factors beside one of these alone: a law that is never zero along an axis is often one plus a
        wave, a step or what fades."""
        self.progress("formulas", share)
        found = [f.products[0] for f in self.best(len(self.found)) if len(f.products) == 1]
        pairs = [product for product in (*found, *(row.product for row in promises)) if len(product.factors) == 2]
        sides = ((pair, pair.factors[i], pair.factors[1 - i]) for pair in pairs for i in (0, 1))
        tries = [[pair, Product((other,))] for pair, factor, other in sides if factor.kind.name in LEVELS]
        self._on_few_then_all(tries[:LEVELLED], SETTLED_FURTHER)

    def _modulate(self, products: Sequence[Product], share: float) -> None:
        """A product beside itself times one more factor: what two or three things make together is seldom zero along
        any. What acts in one direction alone is so by itself."""
        self.progress("formulas", share)
        left = {f.products: f.left for f in self.found}
        for product in products:
            further = Screening(self.library, left[(product,)]).multiplied(product)
            tries = [[product, row.product] for row in further[:MULTIPLIED] if self.most > 1]
            tries += [[row.product] for row in further if row.product.factors[-1].kind.name in ONE_WAY]
            self._on_few_then_all(tries, SETTLED_FURTHER)

    def _exchanged(self, share: float) -> None:
        """One factor after the other, as long as that leads on."""
        before = math.inf
        for _ in range(MOST_FACTORS):
            least = self.least
            if self.reached or least > WORTH * before:
                break
            before = least
            self._exchange(share)

    def _exchange(self, share: float) -> None:
        """One factor of a product for another: what was chosen while the rest was wrong is often of a wrong kind."""
        self.progress("formulas", share)
        tries = []
        alone = [f.products[0] for f in self.best(len(self.found)) if len(f.products) == 1]
        for product in alone[:BEAM]:
            tries += self._with_another_factor(product, self.screening)
        self._on_few_then_all(tries, SETTLED_FURTHER)

    def _exchange_beside(self) -> None:
        """The same of each product of the best formula beside the others of it."""
        if not self.reached and any(len(formula.products) > 1 for formula in self.best(1)):
            self._exchange_on()

    def _exchange_on(self) -> None:
        """One factor of the best formula for another, as long as that leaves less."""
        before = math.inf
        for _ in range(MOST_FACTORS):
            least = self.least
            if least > EXCHANGE_SHARE * before:
                break
            before = least
            self._exchange_each(self.best(1)[0])

    def _exchange_each(self, formula: Formula) -> None:
        """One factor of a formula after the other for another, beside the rest."""
        products, tries = formula.products, []
        for i, product in enumerate(products):
            beside = [other for j, other in enumerate(products) if j != i]
            own = self.leftover.without_known(self.leftover.columns(product, mixes=[formula.amplitudes[i]]))[:, 0]
            tries += self._with_another_factor(product, Screening(self.library, formula.left + own), beside)
        self._on_few_then_all(tries, SETTLED_WHOLE)  # where noise is all that is left, few rows hardly tell

    def _with_another_factor(
        self, product: Product, screening: Screening, beside: Sequence[Product] = ()
    ) -> list[list[Product]]:
        """A product with each of its factors for others that the screening promises, beside the rest of a formula."""
        tries = []
        for factor in product.factors if len(product.factors) > 1 else ():
            rest = Product(tuple(row for row in product.factors if row is not factor))
            tries += [[*beside, row.product] for row in screening.multiplied(rest)[:EXCHANGED]]
        return tries

    def _entrances(self) -> list[Product]:
        """The best products of one factor: beside those of two, that of a law of two axes may look poor."""
        return self._few_alike(1)[:ENTRANCES]

    def _leading(self) -> list[Product]:
        """The best products that may have a further factor."""
        return self._few_alike(MOST_FACTORS - 1)[:BRANCHES]

    def _few_alike(self, most_factors: int) -> list[Product]:
        """The best products by themselves, few of the same axes."""
        count: dict[object, int] = {}
        out = []
        for formula in self.best(len(self.found)):
            product = formula.products[0]
            axes = frozenset(family(factor.axis) for factor in product.factors)
            if len(formula.products) == 1 and len(product.factors) <= most_factors and count.get(axes, 0) < ALIKE:
                count[axes] = count.get(axes, 0) + 1
                out.append(product)
        return out

    def _settle(self, onto: Sequence[Product], promises: Sequence[Promise], share: float) -> None:
        """Each promise beside what it is added to: on few rows, the best of them then on all."""
        self.progress("formulas", share)
        tries = [[*onto, promise.product] for promise in promises]
        self._on_few_then_all(tries, SETTLED_WHOLE if not onto else SETTLED_FURTHER)

    def _on_few_then_all(self, tries: Sequence[Sequence[Product]], most: int) -> None:
        sorted_out, least = self._on_few(tries, most), math.inf
        for formula in sorted_out[:most]:
            if formula.square > ROUGHLY**2 * sorted_out[0].square:
                break
            found = settled(self.leftover, formula.products, WHOLE_ROUNDS, HOPELESS**2 * least)
            if found is not None and not self._strained(found):
                least = min(least, found.square)
                self.found.append(found)

    def _on_few(self, tries: Sequence[Sequence[Product]], most: int) -> list[Formula]:
        """On few rows, best first: after some rounds all but the best of them are given up."""
        begun = self._roughly(tries, FIRST_ROUNDS)[: GONE_ON * most]
        return each_once(self._roughly([f.products for f in begun], ROUNDS))

    def _roughly(self, tries: Sequence[Sequence[Product]], rounds: int) -> list[Formula]:
        """On few rows, best first."""
        rough = [settled(self.leftover.thin, products, rounds) for products in tries]
        fine = (f for f in rough if f is not None and not self._strained(f))
        return sorted(fine, key=priced)

    def _strained(self, formula: Formula) -> bool:
        products = formula.products
        if any(product.strained(self.leftover.spans) for product in products):
            return True
        if len(formula.left) == len(self.leftover.left) and happened_once(self.leftover, formula):
            return True
        return retells(products, self.leftover.model.balance, self.leftover.clocks)

    def best(self, count: int) -> list[Formula]:
        """By the error and its price, each signature once; a longer formula only where it is worth it."""
        noise = min(self.least, 1.0)
        return each_once(sorted(self.found, key=lambda formula: self.rank(formula, noise)))[:count]

    def rank(self, formula: Formula, noise: float) -> float:
        """Logarithm of the error over the noise floor, no better than the noise, with its price."""
        extra = -math.log(WORTH) * (len(formula.products) - 1)
        return math.log(max(self.level(formula), noise, LEAST_FLOOR)) + PRICE * (formula.price + formula.oddity) + extra

    def level(self, formula: Formula) -> float:
        """Error over the noise floor."""
        return math.sqrt(formula.square / len(formula.left)) / self.floor

    @property
    def least(self) -> float:
        """Error of the best over the noise floor."""
        return min((self.level(formula) for formula in self.found), default=math.inf)

    @property
    def reached(self) -> bool:
        """Whether a formula leaves noise only; one that leaves less says that the noise is not known."""
        base = math.sqrt(self.leftover.square / len(self.leftover.left)) / self.floor
        least = self.least
        if NO_NOISE_FLOORS < least < REACHED_FLOORS or (least < EXACT_FLOORS and least < EXACT_SHARE * base):
            return True
        sharp = min((self.level(formula) for formula in self.found if leaps(self.leftover, formula)), default=math.inf)
        return sharp < SHARP_SHARE * base or (sharp < NEAR_FLOORS and sharp < NEAR_SHARE * base)


def channels_of(products: Sequence[Product]) -> frozenset[str]:
    """The channels that a formula reads, the clock only where it is a channel itself."""
    axes = {factor.axis for product in products for factor in product.factors}
    return frozenset(name for axis in axes for name in reads(axis) if name != CLOCK or axis == CLOCK)


def each_once(formulas: Iterable[Formula]) -> list[Formula]:
    """The first of each signature."""
    seen: dict[object, Formula] = {}
    for formula in formulas:
        seen.setdefault(tuple(sorted(product.alike for product in formula.products)), formula)
    return list(seen.values())


def priced(formula: Formula) -> float:
    """Squared error, dearer for each number."""
    return formula.square * (1 + PRICE) ** (2 * formula.price)


def happened_once(leftover: Leftover, formula: Formula) -> bool:
    """Whether a product acts in one short stretch only: what somebody held, or what struck once, is no law, in whatever
    place and at whatever speed it was. Those of the clock may, as what fades from the beginning does: see `retells`."""
    trial = leftover.problem.trials[0]
    count = math.ceil(ONCE_S * trial.motion.rate_hz / trial.step)
    for product, amplitudes in zip(formula.products, formula.amplitudes, strict=True):
        if any(factor.axis == CLOCK for factor in product.factors):
            continue
        acts = np.cumsum(leftover.columns(product, mixes=[amplitudes])[:, 0] ** 2)
        if np.max(acts[count:] - acts[:-count], initial=0.0) > ONCE_SHARE * acts[-1]:
            return True
    return False


def retells(products: Sequence[Product], balance: Balance, clocks: Collection[str] = (CLOCK,)) -> bool:
    """Whether a formula tells more of this recording's clock, or of what goes on as one, than a law does: by several
    events any torque could be retold, and in a drive balance by several waves, or one that moves with the joint, that
    of the other joints, which follow the same clock."""
    told = len(frozenset().union(*(product.events(clocks) for product in products)))
    if balance == "drive":
        told += sum(len(product.tones) for product in products)
        if any(product.tones and product.moves for product in products):
            return True
    return told > MOST_OF_CLOCK
