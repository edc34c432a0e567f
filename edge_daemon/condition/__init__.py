"""Readings become blocks: calibrated, judged for validity, aligned on one time base. Pure."""
