"""The reduced step in C: sources, the layout of a body for it, and its library."""
