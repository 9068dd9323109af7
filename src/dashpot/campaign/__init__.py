"""Campaigns: axes of scenarios in, one labelled dataset of measures out, any scenario replayable by its index."""
