"""Planning with gaits: surrogate, scenes, observation, planners' interface, collision check, evaluation."""
