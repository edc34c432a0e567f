"""Bytes from CAN, I2C, Modbus and files become readings. The asynchronous edge on the sensor side."""
