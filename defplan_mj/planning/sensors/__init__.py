"""What a robot senses of its surroundings: one file a sensor, found by the name its task has for it."""
