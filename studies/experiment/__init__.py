"""The robot paper's experiment on simulated recordings: `python -m studies.experiment`."""
