"""The report: a result for people, in one self-contained file."""
