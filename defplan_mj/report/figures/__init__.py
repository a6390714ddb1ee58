"""The pictures of a report as Matplotlib figures, and the views that they are drawn from."""
