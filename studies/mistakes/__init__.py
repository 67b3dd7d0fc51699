"""Mistakes that are made with files of tracks, and what must happen to each: none in silence."""
