"""Verification: sound located with the calibrated array, against where the camera saw it come from."""
