"""The robot paper's experiment on simulated recordings: `neurosym experiment` and its page."""
