"""Zenoh, Modbus registers and metrics. The asynchronous edge on the reader's side."""
