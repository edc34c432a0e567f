"""Every threshold by which an explanation is accepted, in one table: what it guards, and what stands behind its value.

`tools/calibrate_thresholds.py` derives those again that were measured.
"""

from __future__ import annotations

from typing import NamedTuple

from edge_daemon.identify.firm_spring import SPRING_SHARE

GUESS = "guess"
SEEN = "seen"
MEASURED = "measured"


class Threshold(NamedTuple):
    """One row of the table."""

    name: str
    value: float
    unit: str
    guards: str
    """what would be said wrongly without it"""
    kind: str
    """`measured`: derived again by the tool; `seen`: set between what was right and what was wrong; `guess`"""
    behind: str
    """where the value comes from"""


TABLE: list[Threshold] = []
"""The rows in the order of their definition."""


def _row(name: str, value: float, unit: str, guards: str, kind: str, behind: str) -> float:
    TABLE.append(Threshold(name, value, unit, guards, kind, behind))
    return value


# beliefs
TEMPER = _row(
    "TEMPER", 0.15, "1", "no cause is sure because a rival's search stopped short or its law is a little off", MEASURED,
    "logarithm of the odds that a standard deviation between two errors is worth")  # fmt: skip
NUMBER_PRICE = _row(
    "NUMBER_PRICE", 0.2, "1", "a law of many numbers does not win by them", MEASURED,
    "logarithm of the odds that a number costs")  # fmt: skip
NONE_ODDS = _row(
    "NONE_ODDS", 1.5, "1", "a gear with a law outside the catalogue does not get one of the catalogue's", MEASURED,
    "odds of none of them over the power of the error that is left, as it was and in noise floors, at 1; simulated "
    "gears fit 0.5 to 3 nearly alike, and one real joint chose among these")  # fmt: skip
POOR_ODDS = _row(
    "POOR_ODDS", 0.13, "1", "one tone ties causes that other motions part", MEASURED,
    "odds of none of them after a motion of fewer than two tones, whatever is left")  # fmt: skip
FAR_ODDS = _row(
    "FAR_ODDS", 0.12, "1", "a law that is nearly the gear's, and leaves floors above the noise, is no certainty", SEEN,
    "odds of none of them at `EXPLAINED_FLOORS`, growing with the fourth power: right causes left 2.1 floors at the "
    "most but for dry friction of the output, which left 4.7")  # fmt: skip
FAR_SHARE = _row(
    "FAR_SHARE", 0.065, "error over error", "a law that takes nearly all of a large error is not doubted for floors",
    SEEN, "share that is left at which those odds are one however many floors it is: friction as machines have it "
    "leaves 0.01 to 0.06 beside a simpler form of it, and what was named wrongly left a tenth or more")  # fmt: skip
FAR_POWER = _row(
    "FAR_POWER", 4.0, "1", "the same, between what a form of the law leaves and what another law does", GUESS,
    "power of that share by which they grow")  # fmt: skip
STEP_TEMPER = _row(
    "STEP_TEMPER", 0.4, "1", "no step of one encoder's story is sure by few samples", MEASURED,
    "as TEMPER with one encoder, of rivals and of nothing at all")  # fmt: skip
STEP_ODDS = _row(
    "STEP_ODDS", 0.085, "1", "no story of one encoder goes on to names that nobody believes", MEASURED,
    "odds that a step is none, over the error's power that is left over what is gone; simulated joints and pieces of "
    "real ones, each left out once, fit 0.07 to 0.1")  # fmt: skip
STEP_POWER = _row(
    "STEP_POWER", 1.5, "1", "a step that takes most of the error is not doubted for the rest", MEASURED,
    "power of the same")  # fmt: skip
TOLD_ODDS = _row(
    "TOLD_ODDS", 0.05, "1", "an offset beside another law of one encoder is told as far as it is believed", GUESS,
    "odds that it is none, up to which it is told with that law: of simulated logs, what was none had 0.09 and more; "
    "on real joints finer friction stood in for the plain one at as little"
)  # fmt: skip
LEAST_ODDS = _row(
    "LEAST_ODDS", 0.005, "1", "nothing is ever certain", GUESS, "odds of none of them where all is explained"
)
SHY = _row(
    "SHY", 0.25, "1", "a refinement needs data that insist to share its simpler form's belief", GUESS,
    "its weight")  # fmt: skip
IDLE = _row(
    "IDLE", 0.05, "1", "a refinement that gains nothing is not believed beside its simpler form", GUESS, "its weight"
)
PROMISED = _row(
    "PROMISED", 0.1, "probability", "a promised error is one that `add` delivers", GUESS,
    "belief from which an explanation is fitted on to the end")  # fmt: skip
TOLD = _row(
    "TOLD", 0.005, "probability", "no rivals are told of a cause that nobody believes", GUESS, "what rounds to nothing"
)

# the verdict
EXPLAINED_FLOORS = _row(
    "EXPLAINED_FLOORS", 3.0, "noise floors", "nothing is called adequate that the data contradict", SEEN,
    "error of the model from which on it is never adequate: simulation and filters leave up to two")  # fmt: skip
UNDERCUT = _row(
    "UNDERCUT", 0.5, "noise floors", "no offset of the motor is lost below a floor that was taken too high", SEEN,
    "error of an effect with one encoder that denies the floor: jittered stamps at 100 Hz put it at three times the "
    "noise; a law in the loop beside a torque sensor, whose noise is known, left 0.24 of that and was none"
)  # fmt: skip
WORTH_SHARE = _row(
    "WORTH_SHARE", 0.7, "error over error", "near the floor the model's exactness is not taken for structure", GUESS,
    "an effect that is really missing takes more of the error")  # fmt: skip
WORTH_EXCESS = _row(
    "WORTH_EXCESS", 0.45, "excess over excess", "an effect that takes all of the structure is named, however small",
    GUESS, "the model's inexactness is no effect's shape")  # fmt: skip

# what improves
LEAST_GAIN = _row(
    "LEAST_GAIN", 0.015, "error over error", "an effect that is not worth its name is not named", SEEN,
    "relative fall of the held-out error")  # fmt: skip
LITTLE_GAIN = _row(
    "LITTLE_GAIN", 0.97, "error over error", "no ripple of a fifth of the noise is called a missing effect", SEEN,
    "error that an effect near the noise leaves with one encoder: 0.971 and 0.98 of ripple that is none")  # fmt: skip
LEAST_T = _row(
    "LEAST_T", 4.0, "1", "no fall by chance is called an improvement", SEEN,
    "t of the fall over blocks: one in ten thousand, for some twenty candidates and their shapes")  # fmt: skip
LIKELY_T = _row(
    "LIKELY_T", 2.5, "1", "the same over few blocks, where the samples insist besides", SEEN,
    "t of the fall over blocks: seven files of a constant speed each, or reversals in a part of the blocks",
)  # fmt: skip
LIKELY_SD = _row(
    "LIKELY_SD", 8.0, "standard deviations", "no few blocks name an effect that their samples do not insist on", SEEN,
    "root of twice the log likelihood ratio over independent samples: 13 and 23 on real joints")  # fmt: skip
BELOW_SD = _row(
    "BELOW_SD", 12.0, "standard deviations", "nothing is named below the noise for what a spectrum of it shows", SEEN,
    "the same of a model that leaves noise alone: 19 and 22 on simulated joints, by chance up to 9")  # fmt: skip
LIKELY_GAIN = _row(
    "LIKELY_GAIN", 0.9, "error over error", "a law that is a little off gets no second name by its many samples", SEEN,
    "what was there on real joints took 14 and 17 %, what was not 2 to 7 %",
)  # fmt: skip
EXACT_FLOORS = _row(
    "EXACT_FLOORS", 1.5, "noise floors", "no form of load friction is named for a hundredth near the noise", SEEN,
    "error up to which a model of one encoder may be exact: 1.0 to 1.5 on simulated joints")  # fmt: skip
FLOOR_DOUBT = _row(
    "FLOOR_DOUBT", 0.1, "1", "an error a little above its floor is not taken for structure", SEEN,
    "relative variance to which the noise floor is known")  # fmt: skip

# what cannot be told apart
TIE = _row(
    "TIE", 1.12, "error over error", "of two explanations that do alike neither is preferred", SEEN,
    "errors of twins on simulated gears, which differ by what a search stopped at")  # fmt: skip
TIE_FLOORS = _row(
    "TIE_FLOORS", 0.25, "noise floors", "near the noise no difference of errors is taken for evidence", SEEN,
    "scatter of the error of exact models")  # fmt: skip
TWIN_TIE = _row(
    "TWIN_TIE", 1.3, "error over error", "what no motion tells apart is not told apart by a search that stopped short",
    GUESS, "errors of twins closer than this factor")  # fmt: skip
SUGGESTIVE = _row(
    "SUGGESTIVE", 0.95, "error over error", "a refinement that gains a little is told as a rival", GUESS,
    "error over that of its simpler form")  # fmt: skip
INSIST = _row(
    "INSIST", 1.5, "error over error", "a refinement takes the place of its simpler form only where data insist", SEEN,
    "error of the simpler form over that of its refinement")  # fmt: skip
INSIST_EXCESS = _row(
    "INSIST_EXCESS", 2.0, "excess over excess", "the same, of the error beyond the noise", SEEN,
    "where the fall is beyond chance besides")  # fmt: skip
PAIR_GAIN = _row(
    "PAIR_GAIN", 0.7, "error over error", "a second effect is not named for mending the first", SEEN,
    "error of a pair over that of the best single; a second law mends the first by a quarter")  # fmt: skip
LAW_GAIN = _row(
    "LAW_GAIN", 0.4, "error over error", "the same where a law is all but enough, or both are laws of the twist", SEEN,
    "a second law mends the first by half, a second effect takes nearly all")  # fmt: skip
LAW_SHARE = _row(
    "LAW_SHARE", 0.12, "error over error", "a law that is not quite the simulated one gets no second effect", GUESS,
    "real friction keeps its law to some per cent")  # fmt: skip

# what is no explanation at all
STIFFER = _row(
    "STIFFER", 1.6, "floor over floor", "more stiffness is no way to hide an error in the noise", SEEN,
    "largest floor of an explanation over that of the model")  # fmt: skip
HIDDEN = _row(
    "HIDDEN", 8.0, "floor over floor", "the same where an error of the angles had hidden the stiffness", SEEN,
    "a fit sees the stiffness times phi^2 / (phi^2 + e^2): a seventh at an error e of 2.5 times the twist phi",
)  # fmt: skip
_row(
    "SPRING_SHARE", SPRING_SHARE, "rms over rms", "no effect takes the place of the spring", SEEN,
    "stiffness times twist over torque: a loop that never slips, friction of nine tenths of the load")  # fmt: skip
WIDEST = _row(
    "WIDEST", 4.0, "width over rms twist", "no loop or gap is so wide that the motion never goes through it", SEEN,
    "it would act as a spring")  # fmt: skip
OPAQUE = _row(
    "OPAQUE", 0.3, "1", "nothing explains that would take up any torque", SEEN,
    "share of an unknown torque that must show in what is left")  # fmt: skip
