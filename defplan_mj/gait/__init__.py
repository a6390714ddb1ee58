"""Gaits: the DMP, the problem Eq. 1 and its objective, switching, mean cycles."""
