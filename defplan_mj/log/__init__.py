"""Logs of episodes as MCAP files: recording, reading, replay, comparison with the surrogate."""
