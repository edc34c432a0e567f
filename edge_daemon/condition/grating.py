"""A fibre Bragg grating: the wavelength that it reflects becomes strain, and warmth is taken off.

dlambda / lambda = (1 - p_e) strain + (alpha + xi) dT, after Kersey et al. (1997), J. Lightwave Technol. 15(8), eq. 1 to
3: a silica fibre that hangs free has p_e = 0.22, alpha = 0.55e-6 / K and xi = 8.6e-6 / K. One that is glued to a metal
follows its expansion as well, which `grating_per_K` then holds.
"""

from __future__ import annotations

from edge_daemon.config.settings import ChannelSettings
from edge_daemon.records import Array, Flags

STRAIN_SHARE = 0.78
"""The wavelength grows by this share of the strain, 1 - p_e: a silica fibre that is stretched refracts less."""
REFERENCE_DEGC = 25.0
"""The configured wavelength is that of the unstrained grating at this temperature."""


def strain_line(wavelength_nm: float) -> tuple[float, float]:
    """Gain [1/nm] and bias of the strain over the wavelength read [nm], before warmth is taken off."""
    return 1.0 / (STRAIN_SHARE * wavelength_nm), -1.0 / STRAIN_SHARE


def without_warmth(
    row: ChannelSettings, gain: float, strained: tuple[Array, Flags], heat: tuple[Array, Flags]
) -> tuple[Array, Flags]:
    """Values (n,) of a grating's channel, less what warmth does, and their flaws; `heat` [degC] with its own beside it.

    `gain`: the channel's value per nanometre. A sample whose temperature must not be used is flawed like that.
    """
    warmth = gain * (row.grating_nm or 0.0) * row.grating_per_K * (heat[0] - REFERENCE_DEGC)
    return strained[0] - warmth, strained[1] | heat[1]
