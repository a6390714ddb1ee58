"""defplan: motion planning for soft robots, hosted by MuJoCo."""

__version__ = "0.1.0"
