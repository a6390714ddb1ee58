"""Planners that learn the value of each gait by deep Q-learning: ours and the paper's."""
