"""Angles become twist, rates and torque; encoder zeros, ratio and skew. Pure: the floor of identify and track."""
