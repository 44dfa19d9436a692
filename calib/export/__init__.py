"""Exports: the microphones in the words of other tools. `formats.py` lists them."""
