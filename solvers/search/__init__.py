"""Planners that search with the surrogate, and what they remember of the way and of the laser."""
