"""Recorded frames, played to a service or to a predictor of one's own, and what came of it as a recording again."""
