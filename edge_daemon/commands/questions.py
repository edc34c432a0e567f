"""The questions of `init`, in words: read by the command line without loading what answers them."""

WORDS: dict[str, tuple[str, str]] = {
    "name": ("NAME", "What is the drive called?"),
    "gear": ("SIZE", "Which gear size, or - if it is in no catalogue?"),
    "ratio": ("R", "Motor turns per output turn; negative if it turns against?"),
    "inertia": ("J", "Inertia of all that turns with the output [kg m^2]?"),
    "bus": ("KIND", "How do the encoders speak: canopen, dbc (any other CAN), simulated, -?"),
    "can": ("INTERFACE:CHANNEL", "Which CAN interface?"),
    "bitrate": ("RATE", "Its bit rate [1/s]?"),
    "motor-encoder": ("NODE:BITS", "Motor encoder (CiA 406), node and bits, or -?"),
    "output-encoder": ("NODE:BITS", "Output encoder (CiA 406), node and bits, or -?"),
    "servo": ("NODE:N_M[:COUNTS]", "Servo drive (CiA 402), node, rated torque and counts per turn, or -?"),
    "dbc": ("FILE", "Which DBC file?"),
    "motor-angle": ("SIGNAL", "Signal of the motor angle?"),
    "motor-counts": ("N", "Its counts per turn?"),
    "output-angle": ("SIGNAL", "Signal of the output angle?"),
    "output-counts": ("N", "Its counts per turn?"),
    "torque": ("SIGNAL", "Signal of the motor torque [N m], or -?"),
    "i2c": ("BUS:PART[:ADDRESS]", "I2C part on the housing, bus, part and address, or -?"),
    "modbus": ("PLACE@ID", "Modbus sensor, place and device id, or -?"),
    "read": ("CHANNEL:ADDRESS:TYPE:SCALE", "What does it measure: channel, address, type, scale?"),
}
"""Flag -> (what an answer looks like, the question)."""
