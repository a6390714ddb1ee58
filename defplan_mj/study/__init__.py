"""A study: many runs by one file, their table, their statistics and their page."""
