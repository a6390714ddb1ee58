"""Shared by tests: bodies, scenes, gaits, logs, and independent truths."""
