"""Planning with gaits: robot, scenes, sensors, surrogate, observation, what a planner is, collision check."""
