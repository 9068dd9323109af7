"""Campaigns: axes of scenarios in, one labelled dataset of measures out, every scenario replayable."""
