"""The channels a drive can have: one row each. Recordings, blocks and settings use these names."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Channel:
    name: str
    unit: str
    meaning: str
    angle: bool = False
    """multi-turn angle: unwrapped, and expected to run past one turn"""


CHANNELS: dict[str, Channel] = {
    row.name: row
    for row in (
        Channel("theta_in_rad", "rad", "motor (wave generator) angle", angle=True),
        Channel("theta_out_rad", "rad", "output angle", angle=True),
        Channel("velocity_in_rad_s", "rad/s", "motor speed as the drive reports it"),
        Channel("velocity_out_rad_s", "rad/s", "output speed as the drive reports it"),
        Channel("torque_out_Nm", "N m", "torque on the output side"),
        Channel("torque_in_Nm", "N m", "torque of the motor, in the direction of its own angle"),
        Channel("torque_model_Nm", "N m", "torque that the controller's own model asks of this joint, output side"),
        Channel("current_in_A", "A", "motor current that makes torque, in the direction of the motor's own angle"),
        Channel("temperature_degC", "degC", "temperature of the gear housing"),
        Channel("temperature_ambient_degC", "degC", "temperature of the air"),
        Channel("pressure_Pa", "Pa", "pressure in the gear housing"),
        Channel("force_axial_N", "N", "axial force on the output bearing"),
        Channel("force_radial_N", "N", "radial force on the output bearing"),
        Channel("strain_flexspline", "1", "strain of the flexspline's wall"),
        Channel("sound_rms", "Pa", "level of the acoustic sensor, as it reports it"),
        Channel("profile_phase", "1", "which part of a test profile runs; 0 = none"),
    )
}

MOTOR_TORQUES = ("torque_in_Nm", "current_in_A")
"""What tells the torque of a motor, the surer first."""
MOTOR_ORDERS = (1, 2, 4)
"""Orders per wave generator turn that every gear shows: the two lobes (2), their harmonic (4), eccentricity (1)."""
