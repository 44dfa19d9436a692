"""Devices in, session file out."""
