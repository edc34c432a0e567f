"""The profile objects that a drive or an encoder maps into its process data: one row each."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ProfileObject:
    name: str
    index: int
    bits: int
    signed: bool
    meaning: str
    source: str
    sub: int = 0


OBJECTS: dict[str, ProfileObject] = {
    row.name: row
    for row in (
        ProfileObject("statusword", 0x6041, 16, False, "state of the drive, bit by bit", "CiA 402-2, statusword"),
        ProfileObject("modes_display", 0x6061, 8, True, "mode of operation in force", "CiA 402-2, modes of operation"),
        ProfileObject("position_actual", 0x6064, 32, True, "position in encoder increments", "CiA 402-2, position"),
        ProfileObject("velocity_actual", 0x606C, 32, True, "velocity in the drive's unit", "CiA 402-2, velocity"),
        ProfileObject("torque_actual", 0x6077, 16, True, "per mille of the rated torque", "CiA 402-2, torque"),
        ProfileObject("current_actual", 0x6078, 16, True, "per mille of the rated current", "CiA 402-2, torque"),
        ProfileObject("dc_link_voltage", 0x6079, 32, False, "mV", "CiA 402-2, torque"),
        ProfileObject("following_error", 0x60F4, 32, True, "position demand minus actual", "CiA 402-2, position"),
        ProfileObject("position_value", 0x6004, 32, False, "position in counts", "CiA 406, linear and rotary encoders"),
        ProfileObject("speed_value", 0x6030, 16, True, "counts per the device's interval", "CiA 406, speed", sub=1),
        ProfileObject("padding_8", 0x0005, 8, False, "dummy of one byte", "CiA 301, static data types"),
        ProfileObject("padding_16", 0x0006, 16, False, "dummy of two bytes", "CiA 301, static data types"),
        ProfileObject("padding_32", 0x0007, 32, False, "dummy of four bytes", "CiA 301, static data types"),
    )
}

SYNC_ID = 0x080
"""CiA 301: default identifier of the synchronisation object"""
EMERGENCY_ID = 0x080
"""CiA 301: plus the node, default identifier of the emergency object"""
EXTENDED = 0x8000_0000
"""This bit marks a 29-bit identifier, as Linux does (CAN_EFF_FLAG)."""
