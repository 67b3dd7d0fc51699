"""Does symbolic weighting help? `docs/weighting.md` and what it rests on."""
