"""Angles become twist, rates and torque, and columns of a regression. Pure: the floor of identify and track."""
