"""Studies: methods tried on many simulated or measured repetitions, on one machine or a cluster."""
