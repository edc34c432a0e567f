"""Whether the sensors can be what the settings say they are: findings that doubt the wiring, not the gear.

A ratio is made of teeth: it does not wear, and a gear whose encoders tell another one is read with wrong settings.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from edge_daemon.health.alarms import Finding
from edge_daemon.records import NE107, Estimate, Status

RATIO_OFF = 5e-3
"""Two ratios of one gear differ by at least this share: 160 and 161, by which spline is held."""
SURE = 6.0
"""A measured ratio this many standard deviations away is another one."""
ONE_TOOTH = 1.5
"""Ratios this close are those of one gear, mounted or counted in another way."""
NOTHING, LITTLE = 0.9, 0.7
"""Model error relative to the torque: from the first on none of it is explained, and from the second on too much is not
for this to be the cause (guess)."""
MORE = 1.3
"""A model that has learned nothing says zero, and errs by all of the torque; one that errs by more has learned wrongly,
as it does of a motion too small to feel (guess)."""
DELAY_S, SLOW_DELAY_S = 10.0, 60.0
"""A regression that begins anew may be far off for some seconds, a model for longer."""
SHIFT_DELAY_S = 1.0
"""Two solutions of the regression must agree on another ratio."""
LOST_DELAY_S = 2.0
"""An error of more than the whole torque never stands beside a drive that is well for longer than this."""


def doubts(estimates: Mapping[str, Estimate], ratio: float) -> Iterator[Finding]:
    """What speaks against the settings; `ratio` is the model's, with its sign."""
    seen, wrong = estimates.get("ratio"), False
    if seen is not None and seen.status is Status.VALID:  # a slope over a small motion is that of the waves on it
        off = abs(seen.value / ratio - 1)
        wrong = off > RATIO_OFF and off * abs(ratio) > SURE * seen.sd
        text = f"the encoders say {seen.value:.5g} to 1, the model {ratio:g}: {_guess(seen.value, ratio)}"
        yield Finding("ratio", NE107.FUNCTION_CHECK, wrong, wrong, text, delay_s=DELAY_S)
    error, floor = estimates.get("model_nrmse"), estimates.get("model_noise_floor")
    if error is not None and floor is not None and error.usable and floor.usable and floor.value < error.value / 2:
        nothing, all_of_it = error.value - error.sd > NOTHING, error.value - error.sd > 1.0
        worth = not wrong  # with a wrong ratio it is said already
        delay_s = LOST_DELAY_S if all_of_it else SLOW_DELAY_S
        little = error.value > LITTLE
        yield Finding(
            "model error", NE107.FUNCTION_CHECK, nothing and worth, little, _lost(error.value), delay_s=delay_s
        )


def _lost(error: float) -> str:
    """What a model error of about all of the torque, or of more, means."""
    if error < MORE:
        return (
            f"the model explains nothing of the torque (error {error:.0%}): check which encoder is theta_in_rad "
            "and which theta_out_rad, counts_per_turn and the signs, then run `edge-daemon compare`"
        )
    return (
        f"the model misses more than the whole torque (error {error:.0%}): what was learned does not hold for this "
        "motion; run `edge-daemon compare` if this lasts"
    )


def disputed(why: str) -> Finding:
    """What speaks against the readings at this moment; `why` is empty while nothing does."""
    text = f"readings contradict the gear: {why}; nothing is learned from them"
    return Finding("readings", NE107.FUNCTION_CHECK, bool(why), bool(why), text)


def shifted(share: float) -> Finding:
    """Teeth do not change; what looks like it is an encoder's, or a load's that follows the position."""
    text = (
        f"theta_in_rad and theta_out_rad turn in another ratio than before, by {share:+.2g}, as no teeth do: check "
        "both couplings, whether a disc is off its centre, and the load"
    )
    return Finding("ratio shift", NE107.FUNCTION_CHECK, share != 0.0, share != 0.0, text, delay_s=SHIFT_DELAY_S)


def _guess(seen: float, ratio: float) -> str:
    """What to do first."""
    if abs(abs(seen) - abs(ratio)) < ONE_TOOTH:
        turned = ", or `reverse = true` for the encoder that counts the other way" if seen * ratio < 0 else ""
        return f"set ratio = {seen:.0f} in the model{turned}"
    return (
        f"correct counts_per_turn (that of theta_in_rad is {abs(seen / ratio):.4g} times too small, or that of "
        "theta_out_rad as much too large), or exchange the two encoders"
    )
