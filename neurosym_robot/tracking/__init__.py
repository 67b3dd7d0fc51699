"""Whose observations are one person's: stitching of broken tracks, offline and live."""
